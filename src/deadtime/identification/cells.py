"""Cells: between two whole numbers of periods the same samples of an input act."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int


def cell_of(delay: float, step: float, up: bool = False) -> int:
    """The N with D in [(N − 1) h, N h]; the larger one at a whole period where `up`.

    Examples
    --------
    >>> cell_of(0.312, 0.05), cell_of(0.3, 0.05), cell_of(0.3, 0.05, up=True)
    (7, 6, 7)
    """
    ratio = delay / step
    nearest = round(ratio)
    if abs(ratio - nearest) < 1e-9:
        return max(1, nearest + up)
    return max(1, int(np.ceil(ratio)))


def cells_of(delays: Float[np.ndarray, " delay"], step: float) -> Int[np.ndarray, " delay"]:
    """The cell of each delay."""
    return np.array([cell_of(float(delay), step) for delay in delays])
