"""Actuators: limits of the input and of its rate."""

from __future__ import annotations

from dataclasses import dataclass

from numpy.typing import ArrayLike

from deadtime.base.checks import as_floats, bound, not_nan
from deadtime.base.errors import ArgumentError
from deadtime.imperfections.base import ActuatorImperfection, Limiting, Limits, Sizes, per_signal


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
