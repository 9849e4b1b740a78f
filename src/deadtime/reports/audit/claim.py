"""What the audit says about one claim, and how its verdict follows from the numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from deadtime.scenarios.paired_statistics import Proportion


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
