"""Actuators: limits of the input and of its rate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from numpy.typing import ArrayLike

from deadtime.checks import bound
from deadtime.errors import ArgumentError
from deadtime.imperfections.base import ActuatorImperfection, Limiting, Limits, Sizes, per_signal


@dataclass(frozen=True)
class Saturation(Limiting, ActuatorImperfection):
    """Inputs are clipped to [low, high].

    Parameters
    ----------
    low, high : array_like
        Scalars or shape (m,), low < high; infinite for no limit on a side.
    """

    kind: ClassVar[int] = 6
    low: ArrayLike
    high: ArrayLike

    def limits(self, sizes: Sizes) -> Limits:
        low = bound("Saturation.low", self.low, sizes.inputs)
        high = bound("Saturation.high", self.high, sizes.inputs)
        if (low >= high).any():
            raise ArgumentError(
                f"Saturation must have low < high, got {low.tolist()} and {high.tolist()}."
            )
        return Limits(low, high, False)


@dataclass(frozen=True)
class RateLimit(Limiting, ActuatorImperfection):
    """Inputs change by at most `rate`·step from one period to the next.

    Parameters
    ----------
    rate : array_like
        Units of the input per second, a scalar or shape (m,).
    """

    kind: ClassVar[int] = 7
    rate: ArrayLike

    def limits(self, sizes: Sizes) -> Limits:
        most = per_signal("RateLimit.rate", self.rate, sizes.inputs) * sizes.step
        if (most <= 0.0).any():
            raise ArgumentError(f"RateLimit.rate must be positive, got {self.rate}.")
        return Limits(-most, most, True)
