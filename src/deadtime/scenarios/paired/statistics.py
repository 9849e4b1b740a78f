"""Statistics of paired runs: quotients, their geometric mean and median, and shares of signals.

Intervals hold at 95 %. Those of medians are made of order statistics and those of shares are
Wilson's: they assume no distribution. That of a geometric mean is Student's for the mean of the
logarithms, which asks for some dozens of signals.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from deadtime.scenarios.paired.proportion import Proportion

SAME = 1e-6  # relative difference below which two runs count as equally good
MOST = 1e12  # a quotient that counts as no worse than any larger one, such as that of a divergence
CONFIDENCE = 0.95

Cells = Float[np.ndarray, "*cell"]


def quotient(
    first: Float[np.ndarray, ...], second: Float[np.ndarray, ...]
) -> Float[np.ndarray, ...]:
    """First over second, at most `MOST` and at least 1/`MOST`; 1 where equal, even both infinite.

    Examples
    --------
    >>> quotient(np.array([3.0, np.inf, np.inf, np.nan]), np.array([2.0, 1.0, np.inf, 1.0]))
    array([1.5e+00, 1.0e+12, 1.0e+00,     nan])
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.clip(np.where(first == second, 1.0, first / second), 1.0 / MOST, MOST)


def mean_interval(values: Float[np.ndarray, "*cell scenario"]) -> tuple[Cells, Cells, Cells]:
    """Geometric mean along the last axis, and the interval of the true one.

    Examples
    --------
    >>> middle, low, high = mean_interval(np.array([0.5, 2.0] * 50))
    >>> float(middle), float(low.round(3)), float(high.round(3))
    (1.0, 0.871, 1.148)
    """
    from scipy.stats import t

    n = values.shape[-1]
    with np.errstate(invalid="ignore"):
        logs = np.log(values)
        middle = logs.mean(axis=-1)
        if n < 2:
            half = np.where(np.isnan(middle), np.nan, np.inf)
        else:
            quantile = float(t.ppf(0.5 + CONFIDENCE / 2.0, n - 1))
            half = quantile * logs.std(axis=-1, ddof=1) / np.sqrt(n)
    middle, low, high = (np.array(np.exp(part)) for part in (middle, middle - half, middle + half))
    return middle, low, high


def median_interval(values: Float[np.ndarray, "*cell scenario"]) -> tuple[Cells, Cells, Cells]:
    """Median along the last axis, and the order statistics between which the true one lies.

    With B of n independent draws below the median, B ~ Bin(n, ½): the k-th smallest and the
    k-th largest enclose it with probability 1 − 2 P(B < k) ≥ 95 % for the largest such k. With
    fewer than 6 draws there is no such k and the interval is (−∞, ∞).

    References
    ----------
    David and Nagaraja, Order Statistics, 3rd ed., Wiley 2003, section 7.1.

    Examples
    --------
    >>> median, low, high = median_interval(np.arange(1.0, 101.0))
    >>> float(median), float(low), float(high)
    (50.5, 40.0, 61.0)
    """
    from scipy.stats import binom

    n = values.shape[-1]
    k = int(binom.ppf((1.0 - CONFIDENCE) / 2.0, n, 0.5))
    ordered = np.sort(values, axis=-1)  # NaN last
    middle = 0.5 * (ordered[..., (n - 1) // 2] + ordered[..., n // 2])
    missing = np.isnan(values).any(axis=-1)
    low = ordered[..., k - 1] if k else np.full(middle.shape, -np.inf)
    high = ordered[..., n - k] if k else np.full(middle.shape, np.inf)
    middle, low, high = (np.where(missing, np.nan, part) for part in (middle, low, high))
    return middle, low, high


def share_below(ratio: Float[np.ndarray, " scenario"]) -> Float[np.ndarray, " three"]:
    """How often a ratio is below 1, of the times that it differs from it."""
    return share_of(ratio[np.abs(ratio - 1.0) > SAME] < 1.0)


def share_of(outcomes: Bool[np.ndarray, " outcome"]) -> Float[np.ndarray, " three"]:
    """Share of true entries and its interval; one half when there is none to go by."""
    found = Proportion.of(outcomes)
    return np.array([found.fraction if found.trials else 0.5, *found.interval])
