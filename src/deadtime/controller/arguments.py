"""Arguments of a controller."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.checks import real_array, shaped
from deadtime.errors import ArgumentError


def limits_of(
    limits: tuple[ArrayLike, ArrayLike] | None, m: int
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    if limits is None:
        return np.full(m, -math.inf), np.full(m, math.inf)
    try:
        low, high = limits
    except (TypeError, ValueError):
        raise ArgumentError(f"limits must be (low, high), got {limits!r}.") from None
    low, high = (_bound(name, value, m) for name, value in (("low", low), ("high", high)))
    if (low >= high).any():
        raise ArgumentError(f"limits must have low < high, got {low.tolist()} and {high.tolist()}.")
    return low, high


def _bound(name: str, value: ArrayLike, m: int) -> np.ndarray:
    given = np.asarray(value, dtype=float)
    whole = np.broadcast_to(given, (m,)) if given.ndim == 0 else given
    array = real_array(f"limits, {name}", whole, "(m,)", 1)
    return shaped(f"limits, {name}", array, (m,), "(m,)")


def vector(name: str, value: ArrayLike, size: int) -> np.ndarray:
    """A float vector of the right size; its entries need not be finite."""
    array = np.asarray(value, dtype=float)
    if array.shape != (size,):
        raise ArgumentError(f"{name} must have shape ({size},), got {array.shape}.")
    return array
