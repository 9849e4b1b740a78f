"""Which law is best, cell by cell, and by how much the runner-up is worse.

Scores are such that less is better: ∞ for a run that diverged, NaN for a law that could not be
built.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.scenarios.paired.statistics import SAME, mean_interval, quotient

Runs = Float[np.ndarray, "*cell law scenario"]
Cells = Float[np.ndarray, "*cell"]


class Ranking(NamedTuple):
    """Laws in the order of a mean, the best first, and how many of them could be built."""

    order: Int[np.ndarray, "*cell law"]
    built: Int[np.ndarray, "*cell"]

    def place(self, rank: int) -> Int[np.ndarray, "*cell"]:
        """Which law has a rank in each cell, counting from 0; −1 where there are not so many."""
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
    """Laws by a mean of theirs, NaN where they could not be built.

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
    """1 where the interval of a quotient lies below 1, −1 where above, 0 where it decides nothing.

    NaN where the interval is.
    """
    verdict = (high < 1.0 - SAME) * 1.0 - (low > 1.0 + SAME) * 1.0
    return np.where(np.isnan(low), np.nan, verdict)


def winners_of(runs: Runs) -> Winners:
    """The law of the least geometric mean of paired quotients, and the runner-up's distance.

    Quotients are with the least score that any of the laws has on the signal: with another
    common reference the order is the same.

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
