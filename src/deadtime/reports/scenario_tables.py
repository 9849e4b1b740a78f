"""Many scenarios in numbers: quantiles, wins and ratios of the laws, of one problem or of a sweep.

A scenario on which a law diverges has infinite cost for that law: the metrics of such a run stop
at its end, and would make the law look better than it is.
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
from deadtime.reports.figures.sweeps import selection
from deadtime.reports.figures.sweeps.panels import symbol_of
from deadtime.reports.figures.sweeps.reduction import quantiles, score_of
from deadtime.scenarios.dataset import formula_of
from deadtime.scenarios.paired_statistics import (
    Proportion,
    mean_interval,
    median_interval,
    quotient,
)

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
    def compares(self) -> bool:
        """Whether there are several laws; the tables of one law have no wins and no ratios."""
        return len(self.laws) > 1

    @property
    def headings(self) -> list[str]:
        """Headings of the columns of `rows`."""
        against = ["wins", f"/ {self.reference}"] if self.compares else []
        return ["law", "5 %", "median", "95 %", *against, "growing runs"]

    def rows(self) -> list[list[str]]:
        """A row for each law: the metric that ranks them, for a terminal."""
        rows = []
        for row, one in zip(self.rows_of(self.measure), self.laws, strict=True):
            against = [f"{100.0 * one.best:.1f} %", compact(one.relative)] if self.compares else []
            rows.append([*row, *against, f"{one.grew:,}"])
        return rows

    def rows_of(self, metric: str) -> list[list[str]]:
        """Any metric for a terminal: law and quantiles, under `headings[:4]`."""
        return [[one.law, *map(compact, getattr(one, metric))] for one in self.laws]

    @property
    def interval_headings(self) -> list[str]:
        """Headings of the columns of `interval_rows`."""
        against = [f"/ {self.reference}", _INTERVAL] if self.compares else []
        return ["law", "median", _INTERVAL, *against]

    def interval_rows(self) -> list[list[str]]:
        """Medians of the metric that ranks the laws, and of its ratio, with their intervals."""
        rows = []
        for one in self.laws:
            median = compact(getattr(one, self.measure).median)
            ratio = [compact(one.relative), interval_text(*one.relative_interval)]
            rows.append(
                [one.law, median, interval_text(*one.interval), *(ratio if self.compares else [])]
            )
        return rows

    @property
    def answer(self) -> str:
        """One sentence: the law with the least median, an oracle aside, and laws that fail."""
        rivals = [one for one in self.laws if one.law != ORACLE] or list(self.laws)
        best = min(rivals, key=lambda one: getattr(one, self.measure).median)
        what = "∫|r − y|" if self.measure == "iae" else "cost"
        median = compact(getattr(best, self.measure).median)
        if not self.compares:
            text = f"Median {what} of {best.law}: {median}"
        else:
            aside = ", the oracle aside" if len(rivals) < len(self.laws) else ""
            text = f"Least median {what}{aside}: {best.law}, {median}"
        grew = [f"{x.law} ({x.grew:,} of {self.scenarios:,})" for x in self.laws if x.grew]
        return f"{text}; |x| grows under {', '.join(grew) or 'no law'}."

    @property
    def notes(self) -> tuple[str, str]:
        """Sentences on the ratio and on the intervals."""
        return (
            f"/ {self.reference}: the median of the ratio on the same signal.",
            "Intervals hold the true median at 95 % or more: order statistics, whatever the "
            "distribution.",
        )

    def to_latex(self) -> str:
        """The laws as a LaTeX table of the package booktabs: what ranks them, with intervals."""
        rows = []
        for (law, low, median, high), one in zip(
            self.rows_of(self.measure), self.laws, strict=True
        ):
            wins = f"{100.0 * one.best:.1f} %"
            shares = "{:.1f} to {:.1f} %".format(*(100.0 * end for end in one.best_interval))
            ratio = compact(one.relative), interval_text(*one.relative_interval)
            against = [wins, shares, *ratio] if self.compares else []
            interval = interval_text(*one.interval)
            rows.append([law, low, median, interval, high, *against, f"{one.grew:,}"])
        against = ["wins", _INTERVAL, f"/ {self.reference}", _INTERVAL] if self.compares else []
        headings = ["law", "5 %", "median", _INTERVAL, "95 %", *against, "growing runs"]
        measure = "∫|r - y|" if self.measure == "iae" else "the cost"
        about, (ratio, intervals) = f"{measure} of {self.scenarios:,} random signals", self.notes
        if self.compares:
            about += ", the same for all laws"
            remarks = [ratio, intervals, "Those of shares are Wilson's."]
        else:
            remarks = [intervals]
        return booktabs(headings, rows, [f"deadtime: {about};", *remarks])

    def records(self) -> list[dict[str, Any]]:
        """A dictionary for each law for JSON, which knows no infinity: None where there is one."""
        rows = plain(self.laws)
        return [{k: v for k, v in row.items() if k != "iae" or v is not None} for row in rows]


class LawRuns:
    """The runs of laws over the same scenarios, read from a dataset.

    `names` are those of the laws; `lost` tells where a law diverged.
    """

    def __init__(self, data: xr.Dataset) -> None:
        self.names, self._data = selection.laws_of(data), data
        self.lost: Bool[np.ndarray, "law scenario"] = self._values("diverged").astype(bool)
        if self.count == 0:
            raise ArgumentError(
                "data must hold at least one scenario, got none: run some to the end."
            )

    @property
    def count(self) -> int:
        """Number of scenarios."""
        return self.lost.shape[1]

    @property
    def reference(self) -> str:
        """The law that others are compared with: the oracle, or the first where there is none."""
        return ORACLE if ORACLE in self.names else self.names[0]

    @property
    def measure(self) -> str:
        """The metric that ranks the laws: iae where all follow a reference, else the cost."""
        tracked = "iae" in self._data and not np.isnan(self.losses("iae")).any()
        return "iae" if tracked else "cost"

    def losses(self, metric: str) -> Float[np.ndarray, "law scenario"]:
        """A metric, infinite on diverged scenarios."""
        return np.where(self.lost, np.inf, self._values(metric))

    def relative(self) -> Float[np.ndarray, "law scenario"]:
        """The metric that ranks the laws, over that of the reference law.

        1 where both are 0, infinite where a law diverged.
        """
        cost = self.losses(self.measure)
        base = cost[self.names.index(self.reference)]
        with np.errstate(divide="ignore", invalid="ignore"):
            ratios = np.where(cost == base, 1.0, cost / base)
        return np.where(np.isinf(cost), np.inf, ratios)

    def grown(self) -> Bool[np.ndarray, "law scenario"]:
        """Where a law diverged, or |x| grew."""
        if "grows_above" not in self._data.attrs:
            return self.lost
        start = float(self._data.attrs["grows_above"])
        above = start if math.isfinite(start) else GROWN * self.losses("peak").min(axis=0)
        rises = (self._values("decay_rate") < 0.0) & (self._values("final_norm") > above)
        return self.lost | rises

    def _values(self, metric: str) -> Float[np.ndarray, "law scenario"]:
        return self._data[metric].transpose("law", "scenario").values.astype(float)


def summary(data: xr.Dataset) -> Summary:
    r"""Quantiles, wins and relative costs of the laws of a `monte_carlo` dataset.

    With J_ℓi the cost of law ℓ on scenario i, ∞ where it diverged, law ℓ is best on the scenarios
    with J_ℓi = min_k J_ki < ∞, and its relative cost is the median of J_ℓi / J_ri over i, r being
    the reference law. Where all laws follow a reference :math:`J` is :math:`\int |r - y|` instead.

    A run has grown that diverged, or whose :math:`|x|` does not decay over its second half and ends
    above where it started; where a reference, a disturbance or noise pushes x, above `GROWN` times
    the least peak that a law has on the same scenario.

    Parameters
    ----------
    data : xarray.Dataset
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
    runs = LawRuns(data)
    measure = runs.measure
    cost, ise, ranked = (runs.losses(name) for name in ("cost", "ise", measure))
    least = ranked.min(axis=0)
    best = [Proportion.of(row) for row in (ranked == least) & np.isfinite(least)]
    ratios, diverged, grew = runs.relative(), runs.lost.sum(axis=1), runs.grown().sum(axis=1)
    laws = tuple(
        LawSummary(
            name,
            _quantiles(cost[i]),
            _quantiles(ise[i]),
            best[i].fraction,
            _quantiles(ratios[i]).median,
            int(diverged[i]),
            int(grew[i]),
            Interval(*map(float, median_interval(ranked[i])[1:])),
            Interval(*map(float, median_interval(ratios[i])[1:])),
            Interval(*best[i].interval),
            _quantiles(ranked[i]) if measure == "iae" else None,
        )
        for i, name in enumerate(runs.names)
    )
    return Summary(runs.count, runs.reference, laws, measure)


def _quantiles(values: np.ndarray) -> ThreeQuantiles:
    return ThreeQuantiles(*quantiles(values, LEVELS).tolist())


def interval_text(low: float, high: float) -> str:
    """An interval for tables; a dash where there is none.

    Examples
    --------
    >>> interval_text(1.5, 98765.0), interval_text(-np.inf, np.inf), interval_text(2.0, np.inf)
    ('1.50 to 98,765', '–', '2.00 to ∞')
    """
    return "–" if low == -math.inf else f"{compact(low)} to {compact(high)}"


Runs = Float[np.ndarray, "*cell law scenario"]
_PARTS = 7  # of `_figures`


@dataclass(frozen=True)
class SweepTable:
    """A row for each cell and law of a sweep.

    Attributes
    ----------
    headings : list of str
    rows : list of list of str
        The law, values of the axes with more than one, the median of the metric with its 95 %
        interval, the geometric mean of its ratio to the oracle's on the same signal with its 95 %
        interval (where the sweep has an oracle, and ratios say something), and on how many signals
        the law diverged.
    notes : list of str
        What the numbers are.
    """

    headings: list[str]
    rows: list[list[str]]
    notes: list[str]

    def to_latex(self) -> str:
        """The table for LaTeX, of the package booktabs."""
        return booktabs(self.headings, self.rows, self.notes)


def sweep_table(data: xr.Dataset, metric: str | None = None) -> SweepTable:
    """Medians and ratios to the oracle of every cell and law of a sweep, with 95 % intervals.

    A run that diverged counts as ∞. Intervals of medians are order statistics, which hold the true
    median with a probability of at least 95 % whatever the distribution; those of geometric means
    are Student's for the mean of the logarithms. Cells that are not run yet, and laws that could
    not be built, have a dash.

    Parameters
    ----------
    data : xarray.Dataset
        From `deadtime.open_sweep` or `deadtime.sweep`; reduced chunk by chunk where it is lazy.
    metric : str, optional
        A metric of the sweep; ise by default, or its first where it has none.

    Raises
    ------
    ArgumentError
        If the sweep has no such metric, or no cell is done.

    Examples
    --------
    >>> import xarray as xr
    >>> dims, values = ("delay", "law", "scenario"), [[[2.0] * 8, [1.0] * 8]]
    >>> variables = {"ise": (dims, values), "diverged": (dims, np.zeros((1, 2, 8), dtype=bool))}
    >>> names = {"delay": [0.5], "law": ["mean", "oracle"]}
    >>> sweep_table(xr.Dataset(variables, names, {"oracle": "oracle"})).rows[0]
    ['mean', '2.00', '2.00 to 2.00', '2.00', '2.00 to 2.00', '0']
    """
    import xarray as xr

    known = selection.metrics_of(data)
    default = "ise" if "ise" in known else known[0]
    metric = default if metric is None else selection.one_of("metric", metric, known)
    cells = selection.select(data, metric)
    laws = selection.laws_of(cells)
    oracle = "" if metric in selection.RATES else selection.oracle_of(cells)
    found = xr.apply_ufunc(
        _figures,
        score_of(cells, metric),
        kwargs={"oracle": laws.index(oracle) if oracle else -1},
        input_core_dims=[selection.RUNS],
        output_core_dims=[("law", "part")],
        dask="parallelized",
        output_dtypes=[float],
        dask_gufunc_kwargs={"output_sizes": {"part": _PARTS}},
    ).compute()
    axes = selection.long_axes(cells)
    rows = []
    for place in np.ndindex(found.shape[:-1]):
        at = dict(zip(found.dims, place, strict=False))
        cell = [selection.text_of(cells[name].values[at[name]]) for name in axes]
        rows.append([laws[at["law"]], *cell, *_row(found.values[place], metric, bool(oracle))])
    ratio = [f"/ {oracle}", "95 % interval"] if oracle else []
    symbol = formula_of(cells[metric]) if metric == "cost" else symbol_of(metric)
    headings = ["law", *axes, f"median {symbol}", "95 % interval", *ratio, "diverged runs"]
    notes = [
        f"deadtime: medians of {symbol} over {cells.sizes['scenario']:,} signals a cell, and their",
        "distribution-free intervals (order statistics)"
        + (f"; / {oracle}: the geometric mean of the ratio" if oracle else ""),
        *(["on the same signal, and Student's interval of the logarithms' mean"] if oracle else []),
    ]
    return SweepTable(headings, rows, notes)


def _figures(runs: Runs, oracle: int) -> np.ndarray:
    """Median and its ends, ratio to the oracle and its ends, and how many runs diverged."""
    runs = np.asarray(runs, dtype=float)
    parts = [*median_interval(runs)]
    if oracle >= 0:
        parts += mean_interval(quotient(runs, runs[..., [oracle], :]))
    else:
        parts += [np.full(runs.shape[:-1], np.nan)] * 3
    lost = np.where(np.isnan(runs).any(axis=-1), np.nan, np.isinf(runs).sum(axis=-1))
    return np.stack([*parts, lost], axis=-1)


def _row(parts: np.ndarray, metric: str, ratio: bool) -> list[str]:
    if math.isnan(parts[0]):
        return ["–"] * (5 if ratio else 3)
    if metric in selection.RATES:  # of either sign; −∞ where runs diverged
        low, high = (f"{end:+.3g}" for end in parts[1:3])
        middle = [f"{parts[0]:+.3g}", f"{low} to {high}"]
    else:
        middle = [compact(parts[0]), interval_text(*parts[1:3])]
    middle += [compact(parts[3]), interval_text(*parts[4:6])] if ratio else []
    return [*middle, f"{parts[6]:.0f}"]
