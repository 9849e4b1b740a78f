"""Actuators: limits of the input and of its rate, and the step that applies them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from deadtime.base.checks import as_floats, bound, not_nan, read_only
from deadtime.base.errors import ArgumentError
from deadtime.imperfections.base import (
    ActuatorImperfection,
    Imperfection,
    Limiting,
    Limits,
    Sizes,
    per_signal,
)
from deadtime.numerics.kernels import kernel
from deadtime.numerics.numbers import where


@dataclass(frozen=True)
class Saturation(Limiting, ActuatorImperfection):
    """Inputs are clipped to [low, high].

    Parameters
    ----------
    low, high : array_like
        Scalars or shape (m,), low < high; infinite for no limit on a side.
    """

    low: ArrayLike
    high: ArrayLike

    def __post_init__(self) -> None:
        super().__post_init__()
        form = "one or (m,)"
        low = not_nan("Saturation.low", as_floats("Saturation.low", self.low, form))
        high = not_nan("Saturation.high", as_floats("Saturation.high", self.high, form))
        if low.ndim and high.ndim and low.shape != high.shape:
            raise ArgumentError(
                f"Saturation must have low and high of one length, got shapes {low.shape} and "
                f"{high.shape}."
            )
        if (low >= high).any():
            raise ArgumentError(
                f"Saturation must have low < high, got {low.tolist()} and {high.tolist()}."
            )

    def limits(self, sizes: Sizes) -> Limits:
        low = bound("Saturation.low", self.low, sizes.inputs)
        high = bound("Saturation.high", self.high, sizes.inputs)
        return Limits(low, high, False)


@dataclass(frozen=True)
class RateLimit(Limiting, ActuatorImperfection):
    """Inputs change by at most `rate`·step from one period to the next.

    Parameters
    ----------
    rate : array_like
        Units of the input per second, a scalar or shape (m,).
    """

    rate: ArrayLike

    def limits(self, sizes: Sizes) -> Limits:
        most = per_signal("RateLimit.rate", self.rate, sizes.inputs) * sizes.step
        if (most <= 0.0).any():
            raise ArgumentError(f"RateLimit.rate must be positive, got {self.rate}.")
        return Limits(-most, most, True)


class InputLimits(NamedTuple):
    """The limits of the inputs in their order.

    low, high : (count, m)
    relative : (count,), whether the bounds are of the change from the input applied before
    """

    low: Float[np.ndarray, "limit m"]
    high: Float[np.ndarray, "limit m"]
    relative: Bool[np.ndarray, " limit"]

    @classmethod
    def of(cls, imperfections: Sequence[Imperfection | Limiting], sizes: Sizes) -> InputLimits:
        """The limits among them."""
        limits = [each.limits(sizes) for each in imperfections if isinstance(each, Limiting)]
        shape = len(limits), sizes.inputs
        return cls(
            read_only(np.reshape([limit.low for limit in limits], shape)),
            read_only(np.reshape([limit.high for limit in limits], shape)),
            read_only(np.array([limit.relative for limit in limits], np.bool_)),
        )


# Arrays of their own and not a tuple of them: that would cost as much as 50 terms.
@kernel(nogil=True, forceinline=True, _nrt=False)
def limit_input(low, high, relative, i, u, before):
    """What limits leave of input i, u being asked for and `before` applied in the last period.

    Numbers are floats, or vectors of eight scenarios (`deadtime.numerics.numbers`).
    """
    for j in range(relative.size):
        base = where(relative[j], before, 0.0)
        u = min(max(u, base + low[j, i]), base + high[j, i])
    return u
