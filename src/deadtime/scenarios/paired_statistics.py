"""Statistics of laws compared in pairs on the same signals: quotients, shares, and the best law.

Intervals hold at 95 %. Those of medians are order statistics and those of shares are Wilson's: they
assume no distribution. The interval of a geometric mean is Student's for the mean of the
logarithms, which needs some dozens of signals.

Laws are ranked by scores of which less is better: ∞ for a run that diverged, NaN for a law that
could not be built.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

SAME = 1e-6  # relative difference below which two runs count as equally good
MOST = 1e12  # largest quotient: a divergence counts as no worse
CONFIDENCE = 0.95

Cells = Float[np.ndarray, "*cell"]
Runs = Float[np.ndarray, "*cell law scenario"]


@dataclass(frozen=True)
class Proportion:
    """A count out of trials, with Wilson's 95 % interval.

    References
    ----------
    Wilson, "Probable inference, the law of succession, and statistical inference", JASA 1927.

    Examples
    --------
    >>> print(Proportion(984, 1000))
    98.4 % of 1,000 (97.4 to 99.0 %)
    """

    count: int
    trials: int

    @classmethod
    def of(cls, outcomes: np.ndarray) -> Proportion:
        """The share of true entries."""
        return cls(int(np.count_nonzero(outcomes)), outcomes.size)

    @property
    def fraction(self) -> float:
        """count / trials; 0 without any trial."""
        return self.count / self.trials if self.trials else 0.0

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % confidence interval; (0, 1) without any trial."""
        if not self.trials:
            return 0.0, 1.0
        from scipy.stats import binomtest

        interval = binomtest(self.count, self.trials).proportion_ci(method="wilson")
        return float(interval.low), float(interval.high)

    def __str__(self) -> str:
        low, high = self.interval
        return (
            f"{100 * self.fraction:.1f} % of {self.trials:,} "
            f"({100 * low:.1f} to {100 * high:.1f} %)"
        )


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
    """The share of ratios below 1 among those that differ from 1, with its interval."""
    return share_of(ratio[np.abs(ratio - 1.0) > SAME] < 1.0)


def share_of(outcomes: Bool[np.ndarray, " outcome"]) -> Float[np.ndarray, " three"]:
    """Share of true entries and its interval; one half when there are no entries."""
    found = Proportion.of(outcomes)
    return np.array([found.fraction if found.trials else 0.5, *found.interval])


class Ranking(NamedTuple):
    """Laws in the order of a mean, the best first, and how many of them could be built."""

    order: Int[np.ndarray, "*cell law"]
    built: Int[np.ndarray, "*cell"]

    def place(self, rank: int) -> Int[np.ndarray, "*cell"]:
        """The law of a rank in each cell, counted from 0; −1 if fewer laws could be built."""
        last = self.order.shape[-1] - 1
        return np.where(self.built > rank, self.order[..., min(rank, last)], -1)


class Winners(NamedTuple):
    """The best law of each cell.

    winner is its index, −1 where no law could be built; ratio the geometric mean of its score
    over the runner-up's, NaN where there is none; verdict as in `verdict_of`.
    """

    winner: Int[np.ndarray, "*cell"]
    ratio: Cells
    verdict: Cells


def ranking_of(means: Float[np.ndarray, "*cell law"]) -> Ranking:
    """The ranking of laws by their means, NaN for those that could not be built.

    Examples
    --------
    >>> found = ranking_of(np.array([[3.0, 1.0, np.nan]]))
    >>> [found.place(rank).tolist() for rank in range(3)]
    [[1], [0], [-1]]
    """
    missing = np.isnan(means)
    order = np.argsort(np.where(missing, np.inf, means), axis=-1, kind="stable")
    return Ranking(order, np.asarray((~missing).sum(axis=-1)))


def pick(runs: Runs, place: Int[np.ndarray, "*cell"]) -> Float[np.ndarray, "*cell scenario"]:
    """In every cell the scores of one law, NaN where its place is −1."""
    chosen = np.take_along_axis(runs, place[..., None, None], axis=-2)[..., 0, :]
    return np.where((place >= 0)[..., None], chosen, np.nan)


def verdict_of(low: Cells, high: Cells) -> Cells:
    """1 where the interval of a quotient lies below 1, −1 where above, 0 where it contains 1.

    NaN where the interval is NaN.
    """
    verdict = (high < 1.0 - SAME) * 1.0 - (low > 1.0 + SAME) * 1.0
    return np.where(np.isnan(low), np.nan, verdict)


def winners_of(runs: Runs) -> Winners:
    """The law of the least geometric mean of paired quotients, and the runner-up's distance.

    Quotients are taken to the least score of all laws on the same signal: any other common
    reference gives the same order.

    Examples
    --------
    >>> first, second = np.array([1.0, 4.0, 9.0]), np.array([1.1, 5.0, 20.0])
    >>> found = winners_of(np.array([second, first]))
    >>> int(found.winner), float(found.ratio.round(3)), float(found.verdict)
    (1, 0.689, 0.0)
    """
    least = np.fmin.reduce(runs, axis=-2, keepdims=True)
    ranking = ranking_of(mean_interval(quotient(runs, least))[0])
    first, second = (pick(runs, ranking.place(rank)) for rank in range(2))
    ratio, low, high = mean_interval(quotient(first, second))
    return Winners(ranking.place(0), ratio, verdict_of(low, high))
