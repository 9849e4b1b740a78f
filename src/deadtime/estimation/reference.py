"""References: a constant, a schedule, or a function of time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import as_floats, real_array, require_shape, require_unmasked
from deadtime.base.errors import ArgumentError
from deadtime.plant.steps import TOLERANCE


@dataclass(frozen=True, eq=False)
class Reference:
    """r(t), from a time in seconds to shape (size,)."""

    function: Callable[[float], Any]
    size: int

    def __call__(self, time: float) -> Float[np.ndarray, " size"]:
        return check_reference(self.function(time), self.size)

    @classmethod
    def of(cls, value: Any, size: int) -> Reference:
        """From what a user gives: a number, (size,), (times, values), or a function."""
        if isinstance(value, Reference):
            return value
        if callable(value):
            return cls(value, size)
        if isinstance(value, tuple) and len(value) == 2 and np.ndim(value[0]) == 1:
            return cls(_schedule(*value, size), size)
        constant = check_reference(value, size)
        return cls(lambda time: constant, size)


def check_reference(value: Any, size: int) -> Float[np.ndarray, " size"]:
    """A number for every output, or one for each."""
    given = require_unmasked("reference", value)
    whole = [given] * size if np.ndim(given) == 0 else given
    array = real_array("reference", whole, "(tracked,)", 1)
    return require_shape("reference", array, (size,), "(tracked,)")


def _schedule(times: Any, values: Any, size: int) -> Callable[[float], np.ndarray]:
    """Each value from its time on; the first from the start."""
    times = real_array("reference, times", times, "(T,)", 1)
    values = as_floats("reference, values", values, "(T,) or (T, tracked)")
    values = np.tile(values[:, None], size) if values.ndim == 1 else values
    values = real_array("reference, values", values, "(T,) or (T, tracked)", 2)
    require_shape("reference, values", values, (times.size, size), "(T, tracked)")
    if (np.diff(times) <= 0.0).any():
        raise ArgumentError(f"reference, times must increase, got {times.tolist()}.")
    slack = TOLERANCE * max(1.0, float(np.abs(times).max()))
    return lambda time: values[max(0, int(np.searchsorted(times, time + slack, "right")) - 1)]
