"""What `design` may be asked for."""

from __future__ import annotations

import inspect

import numpy as np

from deadtime.base.checks import instance, number, positive
from deadtime.base.errors import ArgumentError
from deadtime.feedback import Law
from deadtime.feedback.law import require_match
from deadtime.gains.pole_placement import unseen_pole
from deadtime.plant import SwitchedSystem
from deadtime.plant.weight import Weight, weight_matrix
from deadtime.synthesis.design_search import MakeLaw


def check_request(
    plant: SwitchedSystem,
    delay_margin: float | None,
    step: float,
    filtered: bool | None,
    longest_step: float | None,
    cost: str,
    dearest: float,
) -> float:
    """The margin asked for, 0 where none is, once the arguments make sense."""
    instance("plant", plant, SwitchedSystem)
    asked = 0.0 if delay_margin is None else number("delay_margin", delay_margin)
    if delay_margin is not None and not 0.0 < asked < 1.0:
        raise ArgumentError(
            f"delay_margin must be above 0 and below 1, relative to the delay, got {asked:g}: "
            "0.05 asks for ±5 %; leave it out to ask for none."
        )
    step = positive("step", step)
    if longest_step is not None and positive("longest_step", longest_step) < step:
        raise ArgumentError(
            f"longest_step must be at least the step, {step:g} s, got {longest_step:g}: leave it "
            "out to keep the step."
        )
    if not (filtered is None or isinstance(filtered, (bool, np.bool_))):
        raise ArgumentError(f"filtered must be True, False or None for both, got {filtered!r}.")
    if cost not in ("mean", "worst"):
        raise ArgumentError(f'cost must be "mean" or "worst" over the modes, got {cost!r}.')
    if number("dearest", dearest) <= 1.0:
        raise ArgumentError(f"dearest must be above 1, times the cheapest cost, got {dearest:g}.")
    return asked


def decay_asked(decay_rate: float) -> float:
    """The decay rate asked for, 1/s."""
    asked = number("decay_rate", decay_rate)
    if asked < 0.0:
        raise ArgumentError(
            f"decay_rate must be at least 0, in 1/s, got {asked:g}: it says how fast every "
            "constant mode must decay."
        )
    return asked


def require_seen(plant: SwitchedSystem, weight: Weight) -> None:
    """Refuse a weight under which a loop that grows may cost little."""
    weight_matrix("weight.R", weight.R, plant.inputs, "m", strict=True)
    for i, A in enumerate(plant.A):
        if (pole := unseen_pole(A, weight.Q)) is not None:
            raise ArgumentError(
                f"weight.Q must weigh what does not decay, but of mode {i} it does not see the "
                f"eigenvalue {pole:.4g} 1/s: give the other states a weight, too."
            )


def require_table(plant: SwitchedSystem, make: MakeLaw, gains: np.ndarray) -> Law:
    """The plain design's law, if the family's laws can be run."""
    if not callable(make):
        raise ArgumentError(f"law must be a function (plant, gains) -> law, got {make!r}.")
    _require_two_arguments(make)
    law = make(plant, gains)
    kind = type(law).__name__
    if not law.is_linear or law.observer is not None:
        raise ArgumentError(
            f"law must make laws that are tables, got {kind}: a delay margin is that of a linear "
            "loop."
        )
    if law.foresees:
        raise ArgumentError(
            f"law must make laws that can run, but {kind} foresees the signal: for a mode's "
            "own exact law give a plant of that mode alone."
        )
    require_match(plant, law)
    return law


def _require_two_arguments(make: MakeLaw) -> None:
    """Refuse a function that cannot be called with a plant and gains."""
    try:
        takes = inspect.signature(make)
    except (TypeError, ValueError):
        return  # compiled: it has none to be read
    try:
        takes.bind(None, None)
    except TypeError:
        raise ArgumentError(
            "law must be a function (plant, gains) -> law that takes these two by position, got "
            f"one that takes {takes}."
        ) from None
