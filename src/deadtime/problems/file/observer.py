"""The [observer] of a problem file: every law on what is measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from pydantic import Field

from deadtime.base.errors import ArgumentError
from deadtime.base.wording import numbered
from deadtime.estimation import Observer, OutputFeedback, Servo, kalman, luenberger
from deadtime.feedback import Law
from deadtime.plant import SwitchedSystem
from deadtime.problems.file.servo import FileServo, watching
from deadtime.problems.toml import Shape
from deadtime.problems.toml.sections import (
    Matrices,
    Matrix,
    Poles,
    PolesPerMode,
    Section,
    Texts,
    Vector,
)


class _Measured(Section):
    """What is measured, y = C_σ x, and an observer to estimate the state; at the run's period."""

    C: Annotated[Matrix | Matrices, Shape("(p, n), or one for each mode", [[1.0, 0.0]])] = Field(
        description="p × n, or one such matrix per mode."
    )
    outputs: Annotated[Texts, Shape("a list of texts", ["position"])] = Field(
        [], description="Names of the outputs, for figures; that of the state where one is output."
    )
    estimate: Annotated[Vector | None, Shape("(n,)", [1.0, 0.0])] = Field(
        None, description="First estimate of the state; 0 by default."
    )
    covariance: Annotated[Matrix | None, Shape("(n, n)", [[0.1, 0.0], [0.0, 0.1]])] = Field(
        None, description="Covariance of the first estimate: every run draws its own."
    )
    model: Literal["modes", "mean"] | int = Field(
        "modes",
        description='What it predicts with: "modes" the measured mode; "mean" the mean of all, or '
        "a number that mode for ever, and then it reads no mode.",
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
    servos: Mapping[str, Servo],
    following: FileServo | None,
) -> dict[str, Law]:
    """The laws on the estimates of observers, each designed for its law's own model.

    A law that measures outputs by itself, on a belief, stays as it is. A law of a servo without an
    observer is told the whole state.
    """
    if section is None and not servos:
        return laws
    if step is None:
        raise ArgumentError(
            'an observer runs at samples: give [run] a step in seconds, not "ideal".'
        )
    found = {}
    for name, law in laws.items():
        if law.outputs is not None:
            found[name] = law
            continue
        servo, options = servos.get(name), {}
        if servo is not None and following is not None:
            options = {"servo": servo, "reference": following.reference}
        if section is None:
            assert servo is not None
            found[name] = OutputFeedback(law, watching(servo, step), **options)
            continue
        if servo is None:
            observer = observer_of(law.plant, section, step, numbers)
        else:
            observer = observer_of(servo.model, section, step, numbers, servo.C)
        first = {"estimate": section.estimate, "covariance": section.covariance}
        found[name] = OutputFeedback(law, observer, **first, **options)
    return found


def names_of(C: Float[np.ndarray, "mode p n"], states: Sequence[str]) -> tuple[str, ...]:
    """Names of outputs: that of a state where they are it in every mode, else numbered."""
    names = list(numbered("y", C.shape[1]))
    for i in range(len(names)):
        rows = np.unique(C[:, i], axis=0)
        if len(rows) == 1 and np.count_nonzero(rows) == 1 and rows.max() == 1.0:
            names[i] = states[int(np.argmax(rows[0]))]
    return tuple(names)


def observer_of(
    plant: SwitchedSystem,
    section: LuenbergerObserver | KalmanObserver,
    step: float,
    numbers: Callable[[list], list],
    C: ArrayLike | None = None,
) -> Observer:
    """The observer of a section, designed for a plant; with a C of its own where that is given."""
    C, model = section.C if C is None else C, section.model
    if isinstance(section, KalmanObserver):
        return kalman(plant, C, section.process, section.measurement, step, model=model)
    return luenberger(plant, C, numbers(section.poles), step, model=model)
