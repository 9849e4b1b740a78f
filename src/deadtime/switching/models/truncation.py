"""Sojourns between a shortest and a longest one: a distribution conditioned on an interval."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.errors import ArgumentError
from deadtime.switching.models.sojourns import Distribution, Fixed, describe, log_survival, survival

SHORTEST = 1e-9  # seconds: a dwell time of none, for a file, where they are positive
ROUND_OFF = 1e-12  # of a limit, by which a multiple of a period may miss it


@dataclass(frozen=True)
class Truncated:
    """A distribution of sojourns, given that they last between `low` and `high` seconds.

        P(S > t | low < S ≤ high) = P(t < S ≤ high)/P(low < S ≤ high)

    Both in logarithms: of sojourns that end soon after `low` little is left of either.

    Examples
    --------
    >>> from scipy.stats import expon
    >>> short = Truncated(expon(scale=0.5), 0.2, 1.0)
    >>> short.sf([0.1, 0.2, 1.0]).tolist(), short.cdf(0.1).item()
    ([1.0, 1.0, 0.0], 0.0)
    """

    dist: Distribution
    low: float
    high: float
    _mass: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        mass = log_between(self.dist, np.array(self.low), self.high)
        object.__setattr__(self, "_mass", float(mass))

    def sf(self, t: ArrayLike) -> np.ndarray:
        """P(S > t)."""
        return np.asarray(np.exp(self.logsf(t)))

    def cdf(self, t: ArrayLike) -> np.ndarray:
        """P(S ≤ t)."""
        return np.asarray(0.0 - np.expm1(self.logsf(t)))

    def logsf(self, t: ArrayLike) -> np.ndarray:
        """log P(S > t)."""
        t = np.asarray(t, dtype=np.float64)
        rest = log_between(self.dist, np.clip(t, self.low, self.high), self.high) - self._mass
        early, over = t <= self.low * (1.0 + ROUND_OFF), t >= self.high * (1.0 - ROUND_OFF)
        return np.where(early, 0.0, np.where(over, -np.inf, np.minimum(rest, 0.0)))

    def mean(self) -> float:
        """E[S] = low + ∫ P(S > t) dt from low to high, seconds."""
        from scipy.integrate import quad

        return self.low + float(
            quad(lambda t: float(self.sf(t)), self.low, self.high, limit=200)[0]
        )

    def __repr__(self) -> str:
        return f"{describe(self.dist)} in [{self.low:g}, {self.high:g}] s"


def log_between(
    dist: Distribution, low: Float[np.ndarray, ...], high: float
) -> Float[np.ndarray, ...]:
    """log P(low < S ≤ high), of the smaller of survival and distribution: neither cancels.

    Examples
    --------
    >>> from scipy.stats import expon
    >>> log_between(expon(scale=0.01), np.array([10.0, 20.0]), np.inf).round(6).tolist()
    [-1000.0, -2000.0]
    """
    if np.isinf(high):
        return log_survival(dist, low)
    with np.errstate(all="ignore"):
        below = float(dist.cdf(high)) < 0.5
        logs = _log_distribution if below else log_survival
        one, other = logs(dist, low), logs(dist, np.array(high))
        large, small = (other, one) if below else (one, other)
        return large + np.log(-np.expm1(np.minimum(small - large, 0.0)))


def _log_distribution(dist: Distribution, t: Float[np.ndarray, ...]) -> Float[np.ndarray, ...]:
    """log P(S ≤ t)."""
    logcdf: Any = getattr(dist, "logcdf", None)
    return np.asarray(np.log(dist.cdf(t)) if logcdf is None else logcdf(t), dtype=np.float64)


def truncate(name: str, dist: Distribution, low: float, high: float) -> Distribution:
    """The distribution itself where all of it lies in the interval, else what is left of it.

    Raises
    ------
    ArgumentError
        If no sojourn of it lies there.
    """
    if isinstance(dist, Fixed):
        if not low * (1.0 - 1e-9) <= dist.length <= high * (1.0 + 1e-9):
            raise _none(name, dist, low, high)
        return dist
    start = survival(dist, low)
    stop = 0.0 if np.isinf(high) else survival(dist, high)
    if not np.isfinite(log_between(dist, np.array(low), high)):
        raise _none(name, dist, low, high)
    return dist if start == 1.0 and stop == 0.0 else Truncated(dist, low, high)


def limits(dist: Distribution) -> tuple[float, float]:
    """The shortest and the longest sojourn that a problem file can state."""
    if isinstance(dist, Truncated):
        return max(dist.low, SHORTEST), dist.high
    return (dist.length, dist.length) if isinstance(dist, Fixed) else (SHORTEST, np.inf)


def _none(name: str, dist: Distribution, low: float, high: float) -> ArgumentError:
    return ArgumentError(
        f"{name} = {describe(dist)} has no sojourn between dwell_time = {low:g} s and "
        f"maximum_dwell = {high:g} s: change one of them."
    )
