"""The [observer] of a problem file: every law on what is measured."""

from __future__ import annotations

from collections.abc import Callable

from deadtime.errors import ArgumentError
from deadtime.laws import Law
from deadtime.observers import Observer, kalman, luenberger
from deadtime.output_feedback import OutputFeedback
from deadtime.plant import SwitchedSystem
from deadtime.problem_file import schema


def observed(
    laws: dict[str, Law],
    section: schema.LuenbergerObserver | schema.KalmanObserver | None,
    step: float | None,
    numbers: Callable[[list], list],
) -> dict[str, Law]:
    """The laws on the estimates of observers, each designed for its law's own model."""
    if section is None:
        return laws
    if step is None:
        raise ArgumentError(
            'an observer runs at samples: give [run] a step in seconds, not "ideal".'
        )
    return {
        name: OutputFeedback(
            law, _observer(law.plant, section, step, numbers), estimate=section.estimate
        )
        for name, law in laws.items()
    }


def _observer(
    plant: SwitchedSystem,
    section: schema.LuenbergerObserver | schema.KalmanObserver,
    step: float,
    numbers: Callable[[list], list],
) -> Observer:
    if isinstance(section, schema.KalmanObserver):
        return kalman(plant, section.C, section.process, section.measurement, step)
    return luenberger(plant, section.C, numbers(section.poles), step)
