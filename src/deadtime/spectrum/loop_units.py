"""Units of a loop: the pace of its plant, and powers of two of its inputs."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from deadtime.plant import SwitchedSystem

_LEAST = 1e-7


def pace_of(plant: SwitchedSystem) -> float:
    """The slower of 1/D, D its longest delay, and its fastest mode's |λ|, 1/s.

    A unit of rates that goes with the unit of time: the same plant in milliseconds has a thousandth
    of it. Of integrators alone it is 1/D.

    Examples
    --------
    >>> import deadtime as dt
    >>> [pace_of(dt.SwitchedSystem([[[a]]], [[[1.0]]], 0.5)) for a in (-8.0, -0.25, 0.0)]
    [2.0, 0.25, 2.0]
    """
    slow = 1.0 / plant.longest_delay
    fast = float(np.abs(np.linalg.eigvals(plant.A)).max())
    return min(slow, fast) if fast > 0.0 else slow


def least_growth(plant: SwitchedSystem) -> float:
    """The growth rate, 1/s, up to which growth, or decay, is no answer: 1e-7 of the plant's pace.

    Examples
    --------
    >>> import deadtime as dt
    >>> least_growth(dt.SwitchedSystem([[[0.0]]], [[[1.0]]], delay=1.0))
    1e-07
    """
    return _LEAST * pace_of(plant)


_FAR = 50  # powers of two by which an input's effect may differ from 1


def units_of(effect: Float[np.ndarray, "row m"]) -> np.ndarray:
    """Powers of two, (m,), by which to count inputs so that they act neither much nor little.

    Of eigenvalues of a loop whose inputs act 1e100 times as much as they are large nothing would be
    left but round-off. 0 where an input acts as much as usual.
    """
    power = np.frexp(np.abs(effect).max(axis=0))[1]
    return np.where(np.abs(power) <= _FAR, 0, power)


def in_units(
    power: np.ndarray, effect: np.ndarray, F: np.ndarray, G: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The inputs' effect (…, m) and the row (F, G) that computes them, in other units."""
    column = power[:, None]
    return np.ldexp(effect, -power), np.ldexp(F, column), np.ldexp(G, column - power)
