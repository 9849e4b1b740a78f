"""Sojourns between a shortest and a longest one: a distribution conditioned on an interval."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from deadtime.base.errors import ArgumentError
from deadtime.switching.models.sojourns import Distribution, Fixed, describe, survival


@dataclass(frozen=True)
class Truncated:
    """A distribution of sojourns, given that they last between `low` and `high` seconds.

        P(S > t | low < S ≤ high) = (sf(t) − sf(high))/(sf(low) − sf(high))

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
    _ends: tuple[float, float] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        ends = survival(self.dist, self.low), survival(self.dist, self.high)
        object.__setattr__(self, "_ends", ends)

    def sf(self, t: ArrayLike) -> np.ndarray:
        """P(S > t)."""
        start, stop = self._ends
        inside = np.clip(np.asarray(t, dtype=np.float64), self.low, self.high)
        sf: Any = getattr(self.dist, "sf", None)
        values = sf(inside) if sf is not None else np.exp(self.dist.logsf(inside))  # pyright: ignore
        return np.clip((np.asarray(values) - stop) / (start - stop), 0.0, 1.0)

    def cdf(self, t: ArrayLike) -> np.ndarray:
        """P(S ≤ t)."""
        return 1.0 - self.sf(t)

    def logsf(self, t: ArrayLike) -> np.ndarray:
        """log P(S > t)."""
        with np.errstate(divide="ignore"):
            return np.log(self.sf(t))

    def mean(self) -> float:
        """E[S] = low + ∫ P(S > t) dt from low to high, seconds."""
        from scipy.integrate import quad

        return self.low + float(
            quad(lambda t: float(self.sf(t)), self.low, self.high, limit=200)[0]
        )

    def __repr__(self) -> str:
        return f"{describe(self.dist)} in [{self.low:g}, {self.high:g}] s"


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
    if not start > stop:
        raise _none(name, dist, low, high)
    return dist if start == 1.0 and stop == 0.0 else Truncated(dist, low, high)


def _none(name: str, dist: Distribution, low: float, high: float) -> ArgumentError:
    return ArgumentError(
        f"{name} = {describe(dist)} has no sojourn between dwell_time = {low:g} s and "
        f"maximum_dwell = {high:g} s: change one of them."
    )
