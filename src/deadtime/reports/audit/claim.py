"""What the audit says about one claim, and how its verdict follows from the numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

NORMAL_97_5 = 1.959963984540054  # 97.5 % quantile of the normal distribution


@dataclass(frozen=True)
class Proportion:
    """How often something held: a count out of trials, with Wilson's 95 % interval.

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
        n, p, z = self.trials, self.fraction, NORMAL_97_5
        centre = (p + z * z / (2 * n)) / (1 + z * z / n)
        half = z / (1 + z * z / n) * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
        low = 0.0 if self.count == 0 else centre - half
        high = 1.0 if self.count == self.trials else centre + half
        return low, high

    def __str__(self) -> str:
        low, high = self.interval
        return (
            f"{100 * self.fraction:.1f} % of {self.trials:,} "
            f"({100 * low:.1f} to {100 * high:.1f} %)"
        )


@dataclass(frozen=True, eq=False)
class Sweep:
    """Shares measured along a parameter, for a figure.

    Attributes
    ----------
    parameter : str
        Name of the parameter, with its unit.
    values, ticks
        Its values, and how to write them on an axis.
    shares : mapping
        From what is counted to one `Proportion` per value.
    ratio : tuple of float
        Median ∫|x|² under law (2) over that under law (80), per value.
    """

    parameter: str
    values: tuple[float, ...]
    ticks: tuple[str, ...]
    shares: Mapping[str, tuple[Proportion, ...]]
    ratio: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Claim:
    """A claim of the paper, in our words, and what became of it.

    Attributes
    ----------
    key, title : str
        A short identifier, and a few words for figures.
    where : str
        Where the paper makes the claim.
    statement : str
        The claim.
    test : str
        What has to be true of a run (or a signal) for the claim to hold there.
    one_run : str
        What the problem's own signal shows.
    holds_in_run : bool or None
        Whether the claim holds there; None when one run cannot decide it.
    many : str
        What many random signals show.
    proportion : Proportion or None
        On how many of them the claim holds; None for a claim about no signal.
    sweep : Sweep or None
        What was measured along a parameter.
    """

    key: str
    title: str
    where: str
    statement: str
    test: str
    one_run: str
    holds_in_run: bool | None
    many: str
    proportion: Proportion | None = None
    sweep: Sweep | None = None

    @property
    def verdict(self) -> str:
        """What the numbers alone say.

        A claim "holds" when no signal drawn contradicts it, "holds on most signals" when its
        whole confidence interval lies above one half (which the first also needs), "does not
        hold on most signals" when all of it lies below, and is "not decided" otherwise. A
        claim about no signal "holds" or "does not hold" as it does in its one computation.
        """
        if self.proportion is None:
            return "holds" if self.holds_in_run else "does not hold"
        low, high = self.proportion.interval
        if low <= 0.5:
            return "does not hold on most signals" if high < 0.5 else "not decided"
        everywhere = self.proportion.count == self.proportion.trials
        return "holds" if everywhere else "holds on most signals"
