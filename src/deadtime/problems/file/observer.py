"""The [observer] of a problem file: every law on what is measured."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Literal

from pydantic import Field

from deadtime.base.errors import ArgumentError
from deadtime.estimation import Observer, OutputFeedback, kalman, luenberger
from deadtime.feedback import Law
from deadtime.plant import SwitchedSystem
from deadtime.problems.toml import Shape
from deadtime.problems.toml.table import Matrices, Matrix, Poles, PolesPerMode, Section, Vector


class _Measured(Section):
    """What is measured, y = C_σ x, and an observer to estimate the state; at the run's period."""

    C: Annotated[Matrix | Matrices, Shape("(p, n), or one for each mode", [[1.0, 0.0]])] = Field(
        description="p × n, or one such matrix per mode."
    )
    estimate: Annotated[Vector | None, Shape("(n,)", [1.0, 0.0])] = Field(
        None, description="First estimate of the state; 0 by default."
    )


class LuenbergerObserver(_Measured):
    """An observer by pole placement."""

    kind: Literal["luenberger"]
    poles: Annotated[
        Poles | PolesPerMode, Shape("a list of poles, or one for each mode", [-4.0, -5.0])
    ] = Field(description="Poles of the error for all modes, or a list per mode, 1/s.")


class KalmanObserver(_Measured):
    """The steady-state Kalman filter of every mode."""

    kind: Literal["kalman"]
    process: Annotated[Matrix, Shape("(n, n)", [[1.0, 0.0], [0.0, 1.0]])] = Field(
        description="Intensity of the white process noise, n × n."
    )
    measurement: Annotated[Matrix, Shape("(p, p)", [[0.01]])] = Field(
        description="Covariance of the noise of a sample, p × p."
    )


ObserverSection = Annotated[LuenbergerObserver | KalmanObserver, Field(discriminator="kind")]


def add_observers(
    laws: dict[str, Law],
    section: LuenbergerObserver | KalmanObserver | None,
    step: float | None,
    numbers: Callable[[list], list],
) -> dict[str, Law]:
    """The laws on the estimates of observers, each designed for its law's own model.

    A law that measures outputs by itself, on a belief, stays as it is.
    """
    if section is None:
        return laws
    if step is None:
        raise ArgumentError(
            'an observer runs at samples: give [run] a step in seconds, not "ideal".'
        )
    return {
        name: law if law.outputs is not None else _on_estimates(law, section, step, numbers)
        for name, law in laws.items()
    }


def _on_estimates(
    law: Law,
    section: LuenbergerObserver | KalmanObserver,
    step: float,
    numbers: Callable[[list], list],
) -> OutputFeedback:
    observer = observer_of(law.plant, section, step, numbers)
    return OutputFeedback(law, observer, estimate=section.estimate)


def observer_of(
    plant: SwitchedSystem,
    section: LuenbergerObserver | KalmanObserver,
    step: float,
    numbers: Callable[[list], list],
) -> Observer:
    """The observer of a section, designed for a plant."""
    if isinstance(section, KalmanObserver):
        return kalman(plant, section.C, section.process, section.measurement, step)
    return luenberger(plant, section.C, numbers(section.poles), step)
