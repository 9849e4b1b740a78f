"""Checks of what `design` is asked for, and hints at units that were mixed up.

A delay in milliseconds beside matrices in 1/s, gains per degree beside states in radians: nothing
in the arithmetic fails, and the answer is about another plant. What can be seen are ratios that no
plant is likely to have.
"""

from __future__ import annotations

import inspect
import math

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import instance, number, positive
from deadtime.base.errors import ArgumentError
from deadtime.base.wording import amount
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


_GROWTH = 10.0  # of e^{pD}, in the exponent: 22,000 times within the delay
_SCALES = 1e6  # between the states of a balanced mode


def unit_hints(
    plant: SwitchedSystem, gains: Float[np.ndarray, "mode m n"], step: float
) -> tuple[str, ...]:
    """Sentences about ratios that mixed units are the likeliest reason of; none for most plants.

    Parameters
    ----------
    plant : SwitchedSystem
    gains : (modes, m, n)
        The plain design's.
    step : float
        Sampling period h, s.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[1.0]]], [[[1.0]]], delay=250.0)     # meant: 250 ms
    >>> for hint in unit_hints(plant, dt.place(plant, [-1.0]), 0.01):
    ...     print(hint)
    An unstable pole at 1 /s grows 3.7 × 10¹⁰⁸ times within the delay of 250 s, which no gains \
make up for: is the delay in seconds?
    """
    found = [_growth(plant), _step(plant, gains, step), _scales(plant)]
    return tuple(hint for hint in found if hint)


def _growth(plant: SwitchedSystem) -> str:
    pole = float(np.linalg.eigvals(plant.A).real.max())
    delay = plant.longest_delay
    if pole * delay <= _GROWTH:
        return ""
    times = amount(math.exp(pole * delay)) if pole * delay < 700.0 else "beyond all numbers"
    within = f"{times} times" if pole * delay < 700.0 else times
    return (
        f"An unstable pole at {pole:.3g} /s grows {within} within the delay of {delay:g} s, which "
        "no gains make up for: is the delay in seconds?"
    )


def _step(plant: SwitchedSystem, gains: np.ndarray, step: float) -> str:
    closed = np.linalg.eigvals(plant.A + plant.B @ gains)
    fastest = float(np.abs(closed).max())
    if step * fastest <= 1.0:
        return ""
    return (
        f"The step of {step:g} s is longer than the loop's fastest motion, 1/|p| = "
        f"{1.0 / fastest:.3g} s: is the step in seconds, and are poles in 1/s?"
    )


def _scales(plant: SwitchedSystem) -> str:
    """How far a change of the states' units alone would bring a mode's entries together."""
    from scipy.linalg import matrix_balance

    for mode, A in enumerate(plant.A):
        _, (scale, _) = matrix_balance(A, permute=False, separate=True)
        most, least = int(scale.argmax()), int(scale.argmin())
        ratio = float(scale[most] / scale[least])
        if ratio > _SCALES:
            return (
                f"Of mode {mode} the states {least} and {most} are {amount(ratio)} times apart in "
                "scale: do all modes and rows have the same units (m or mm, rad or degrees)?"
            )
    return ""
