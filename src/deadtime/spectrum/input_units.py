"""Units of inputs in which a loop can be computed: a change of units moves no root."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

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
