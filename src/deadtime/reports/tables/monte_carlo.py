"""What many scenarios say about each law: quantiles, wins, and the price against a reference law.

A scenario on which a law diverges counts as infinitely dear for it: the figures of such a run
are only those up to its end, and would flatter the law.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from deadtime.base.errors import ArgumentError
from deadtime.base.json_records import plain
from deadtime.base.latex import booktabs
from deadtime.base.wording import compact
from deadtime.scenarios.dataset import Comparison
from deadtime.scenarios.paired_statistics import Proportion, median_interval

if TYPE_CHECKING:
    import xarray as xr

ORACLE = "oracle"
LEVELS = (0.05, 0.5, 0.95)
GROWN = 1e6  # times a peak of x under the same push: no push does that to a loop that decays
_INTERVAL = "95 % interval"


class ThreeQuantiles(NamedTuple):
    """The 5 % quantile, the median and the 95 % quantile; ∞ where diverged runs reach into them."""

    low: float
    median: float
    high: float


class Interval(NamedTuple):
    """Ends of a 95 % confidence interval; infinite where a median is of fewer than 6 scenarios."""

    low: float
    high: float


@dataclass(frozen=True)
class LawSummary:
    """One law over all scenarios.

    Attributes
    ----------
    law : str
    cost, ise : Quantiles
        Of the cost and of ∫|x|².
    best : float
        Share of scenarios on which no law does better, 0 to 1; ties count for each.
    relative : float
        Median of what ranks the laws, over that of the reference law.
    diverged : int
        Number of scenarios on which the law diverged.
    interval, relative_interval : Interval
        Of the median of what ranks the laws, and of `relative`: order statistics, which hold the
        true median with a probability of at least 95 % whatever the distribution.
    best_interval : Interval
        Of `best`, Wilson's.
    grew : int
        Number of scenarios on which it diverged, or |x| grew; see `summary`.
    iae : Quantiles or None
        Of ∫|r − y|, where all laws follow a reference.
    """

    law: str
    cost: ThreeQuantiles
    ise: ThreeQuantiles
    best: float
    relative: float
    diverged: int
    grew: int
    interval: Interval
    relative_interval: Interval
    best_interval: Interval
    iae: ThreeQuantiles | None = None


@dataclass(frozen=True)
class Summary:
    """All laws over the same scenarios.

    Attributes
    ----------
    scenarios : int
    reference : str
        Law that costs are relative to: the one named "oracle", or else the first.
    laws : tuple of LawSummary
    measure : str
        The metric that ranks the laws: "iae" where all follow a reference, else "cost".
    """

    scenarios: int
    reference: str
    laws: tuple[LawSummary, ...]
    measure: str = "cost"

    @property
    def headings(self) -> list[str]:
        """Of the columns of `rows`."""
        return ["law", "5 %", "median", "95 %", "best on", f"/ {self.reference}", "|x| grows"]

    def rows(self) -> list[list[str]]:
        """What ranks the laws, for a terminal, a row for each law."""
        return [
            [
                one.law,
                *map(compact, getattr(one, self.measure)),
                _share(one.best),
                compact(one.relative),
                f"{one.grew:,}",
            ]
            for one in self.laws
        ]

    def rows_of(self, metric: str) -> list[list[str]]:
        """Another metric for a terminal: law and quantiles, under the first of the headings."""
        return [[one.law, *map(compact, getattr(one, metric))] for one in self.laws]

    @property
    def interval_headings(self) -> list[str]:
        """Of the columns of `interval_rows`."""
        return ["law", "median", _INTERVAL, f"/ {self.reference}", _INTERVAL]

    def interval_rows(self) -> list[list[str]]:
        """Medians of what ranks the laws, and of its ratio, with their intervals."""
        return [
            [
                one.law,
                compact(getattr(one, self.measure).median),
                interval_text(*one.interval),
                compact(one.relative),
                interval_text(*one.relative_interval),
            ]
            for one in self.laws
        ]

    def to_latex(self) -> str:
        """The laws as a LaTeX table of the package booktabs: what ranks them, with intervals."""
        both = zip(self.rows(), self.interval_rows(), strict=True)
        rows = [
            [*row[:3], more[2], *row[3:5], _shares(one.best_interval), row[5], more[4], row[6]]
            for (row, more), one in zip(both, self.laws, strict=True)
        ]
        low, median, high = self.headings[1:4]
        headings = ["law", low, median, _INTERVAL, high, "best on", _INTERVAL]
        measure = "∫|r - y|" if self.measure == "iae" else "the cost"
        said = [
            f"deadtime: {measure} of {self.scenarios:,} random signals, the same for all laws;",
            f"/ {self.reference} is the median of the ratio on the same signal. Intervals of",
            "medians are order statistics (distribution-free), of shares Wilson's.",
        ]
        return booktabs([*headings, *self.interval_headings[3:], "diverged"], rows, said)

    def records(self) -> list[dict[str, Any]]:
        """A dictionary for each law for JSON, which knows no infinity: None where there is one."""
        rows = plain(self.laws)
        return [{k: v for k, v in row.items() if k != "iae" or v is not None} for row in rows]


def summary(data: xr.Dataset | Comparison) -> Summary:
    """Quantiles, wins and relative costs of the laws of a `monte_carlo` dataset.

    With J_ℓi the cost of law ℓ on scenario i, ∞ where it diverged, law ℓ is best on the
    scenarios with J_ℓi = min_k J_ki < ∞, and its relative cost is the median of J_ℓi / J_ri
    over i, r being the reference law. Where all laws follow a reference J is ∫|r − y| instead.

    A run has grown that diverged, or whose |x| does not decay over its second half and ends above
    where it started; where a reference, a disturbance or noise pushes x, above `GROWN` times the
    least peak that a law has on the same scenario.

    Parameters
    ----------
    data : xarray.Dataset or Comparison
        With `cost`, `ise` and `diverged` over (law, scenario).

    Raises
    ------
    ArgumentError
        If there is no scenario in it.

    Examples
    --------
    >>> import xarray as xr
    >>> cost = [[2.0, 4.0, 8.0], [1.0, 4.0, 9.0]]
    >>> lost = [[False, False, True], [False, False, False]]
    >>> dims = ("law", "scenario")
    >>> names = {"law": ["averaged", "oracle"]}
    >>> metrics = {"cost": (dims, cost), "ise": (dims, cost), "diverged": (dims, lost)}
    >>> first, second = summary(xr.Dataset(metrics, names)).laws
    >>> first.relative, first.diverged, first.cost[2], round(second.best, 2)
    (2.0, 1, inf, 1.0)
    """
    count, measure = count_of(data), measure_in(data)
    cost, ise, ranked = (losses(data, name) for name in ("cost", "ise", measure))
    least = ranked.min(axis=0)
    best = [Proportion.of(row) for row in (ranked == least) & np.isfinite(least)]
    ratios, diverged = relative_costs(data), _lost(data).sum(axis=1)
    grew = _grown(data).sum(axis=1)
    laws = tuple(
        LawSummary(
            name,
            _quantiles(cost[i]),
            _quantiles(ise[i]),
            best[i].fraction,
            _quantiles(ratios[i]).median,
            int(diverged[i]),
            int(grew[i]),
            _interval(ranked[i]),
            _interval(ratios[i]),
            Interval(*best[i].interval),
            _quantiles(ranked[i]) if measure == "iae" else None,
        )
        for i, name in enumerate(names_of(data))
    )
    return Summary(count, reference_of(data), laws, measure)


def measure_in(data: xr.Dataset | Comparison) -> str:
    """The metric that ranks the laws: iae where all of them follow a reference, else the cost."""
    held = data.results.metrics if isinstance(data, Comparison) else data
    if "iae" not in held:
        return "cost"
    return "cost" if np.isnan(losses(data, "iae")).any() else "iae"


def names_of(data: xr.Dataset | Comparison) -> list[str]:
    """The laws, in order."""
    if isinstance(data, Comparison):
        return list(data.names)
    return [str(name) for name in data["law"].values]


def count_of(data: xr.Dataset | Comparison) -> int:
    """How many scenarios there are; refused if there is none."""
    count = data.scenarios if isinstance(data, Comparison) else data.sizes["scenario"]
    if count == 0:
        raise ArgumentError("data must hold at least one scenario, got none: run some to the end.")
    return count


def reference_of(data: xr.Dataset | Comparison) -> str:
    """The law that others are held against: the oracle, or the first where there is none."""
    names = names_of(data)
    return ORACLE if ORACLE in names else names[0]


def losses(data: xr.Dataset | Comparison, metric: str) -> Float[np.ndarray, "law scenario"]:
    """A metric, infinite on diverged scenarios."""
    return np.where(_lost(data), np.inf, _values(data, metric))


def _values(data: xr.Dataset | Comparison, metric: str) -> Float[np.ndarray, "law scenario"]:
    """A metric of the runs up to their ends."""
    if isinstance(data, Comparison):
        return data.keep(data.results.metrics[metric])
    return data[metric].transpose("law", "scenario").values.astype(float)


def _grown(data: xr.Dataset | Comparison) -> Bool[np.ndarray, "law scenario"]:
    """Where a law diverged, or |x| grew."""
    told = data.attributes if isinstance(data, Comparison) else data.attrs
    if "grows_above" not in told:
        return _lost(data)
    start = float(told["grows_above"])
    above = start if math.isfinite(start) else GROWN * losses(data, "peak").min(axis=0)
    rises = (_values(data, "decay_rate") < 0.0) & (_values(data, "final_norm") > above)
    return _lost(data) | rises


def _lost(data: xr.Dataset | Comparison) -> Bool[np.ndarray, "law scenario"]:
    """Where a law diverged."""
    if isinstance(data, Comparison):
        return data.keep(data.results.diverged)
    return data["diverged"].transpose("law", "scenario").values.astype(bool)


def relative_costs(data: xr.Dataset | Comparison) -> Float[np.ndarray, "law scenario"]:
    """What ranks the laws, over that of the reference law.

    1 where both are 0, infinite where a law diverged.
    """
    cost = losses(data, measure_in(data))
    base = cost[names_of(data).index(reference_of(data))]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.where(cost == base, 1.0, cost / base)
    return np.where(np.isinf(cost), np.inf, ratios)


def quantile(values: Float[np.ndarray, " scenario"], level: float) -> float:
    """The linear quantile that numpy has, also where some values are infinite.

    Examples
    --------
    >>> quantile(np.array([1.0, 3.0, np.inf, np.inf]), 0.25)
    2.5
    >>> quantile(np.array([1.0, 3.0, np.inf, np.inf]), 0.5)
    inf
    """
    # Between a finite value and ∞, interpolation has ∞ − ∞ in it.
    if np.isinf(np.quantile(values, level, method="higher")):
        return math.inf
    highest = values[np.isfinite(values)].max()
    return float(np.quantile(np.minimum(values, highest), level))


def _quantiles(values: np.ndarray) -> ThreeQuantiles:
    return ThreeQuantiles(*(quantile(values, level) for level in LEVELS))


def interval_text(low: float, high: float) -> str:
    """An interval for tables; a dash where there is none.

    Examples
    --------
    >>> interval_text(1.5, 98765.0), interval_text(-np.inf, np.inf), interval_text(2.0, np.inf)
    ('1.50 to 98,765', '–', '2.00 to ∞')
    """
    return "–" if low == -math.inf else f"{compact(low)} to {compact(high)}"


def _interval(values: np.ndarray) -> Interval:
    _, low, high = median_interval(values)
    return Interval(float(low), float(high))


def _shares(interval: Interval) -> str:
    return f"{100.0 * interval.low:.1f} to {100.0 * interval.high:.1f} %"


def _share(share: float) -> str:
    return f"{100.0 * share:.1f} %"
