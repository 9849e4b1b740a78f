"""What numbers of a plant look like when units were mixed up: hints, never refusals.

A delay in milliseconds beside matrices in 1/s, gains per degree beside states in radians: nothing
in the arithmetic fails, and the answer is about another plant. What can be seen are ratios that no
plant is likely to have.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from deadtime.base.wording import amount
from deadtime.plant import SwitchedSystem

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
