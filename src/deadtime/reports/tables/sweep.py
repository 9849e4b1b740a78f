"""A sweep in numbers: every cell and law with its median and the ratio to the oracle."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from deadtime.base.latex import booktabs
from deadtime.base.wording import compact
from deadtime.reports.figures.sweeps.axis_words import one_of, text_of
from deadtime.reports.figures.sweeps.reduction import score_of
from deadtime.reports.figures.sweeps.selection import (
    RATES,
    RUNS,
    laws_of,
    long_axes,
    metrics_of,
    oracle_of,
    select,
)
from deadtime.reports.figures.sweeps.titles import symbol_of
from deadtime.reports.tables.monte_carlo import interval_text
from deadtime.scenarios.dataset import formula_of
from deadtime.scenarios.paired_statistics import mean_interval, median_interval, quotient

if TYPE_CHECKING:
    import xarray as xr

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
    said : list of str
        What the numbers are.
    """

    headings: list[str]
    rows: list[list[str]]
    said: list[str]

    def to_latex(self) -> str:
        """The table for LaTeX, of the package booktabs."""
        return booktabs(self.headings, self.rows, self.said)


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

    known = metrics_of(data)
    default = "ise" if "ise" in known else known[0]
    metric = default if metric is None else one_of("metric", metric, known)
    kept = select(data, metric)
    laws, oracle = laws_of(kept), oracle_of(kept) if metric not in RATES else ""
    found = xr.apply_ufunc(
        _figures,
        score_of(kept, metric),
        kwargs={"oracle": laws.index(oracle) if oracle else -1},
        input_core_dims=[RUNS],
        output_core_dims=[("law", "part")],
        dask="parallelized",
        output_dtypes=[float],
        dask_gufunc_kwargs={"output_sizes": {"part": _PARTS}},
    ).compute()
    axes = long_axes(kept)
    rows = []
    for place in np.ndindex(found.shape[:-1]):
        at = dict(zip(found.dims, place, strict=False))
        cell = [text_of(kept[name].values[at[name]]) for name in axes]
        rows.append([laws[at["law"]], *cell, *_row(found.values[place], metric, bool(oracle))])
    ratio = [f"/ {oracle}", "95 % interval"] if oracle else []
    symbol = formula_of(kept[metric]) if metric == "cost" else symbol_of(metric)
    headings = ["law", *axes, f"median {symbol}", "95 % interval", *ratio, "diverged"]
    said = [
        f"deadtime: medians of {symbol} over {kept.sizes['scenario']:,} signals a cell, and their",
        "distribution-free intervals (order statistics)"
        + (f"; / {oracle}: the geometric mean of the ratio" if oracle else ""),
        *(["on the same signal, and Student's interval of the logarithms' mean"] if oracle else []),
    ]
    return SweepTable(headings, rows, said)


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
    """The figures of one cell and law in words."""
    if math.isnan(parts[0]):
        return ["–"] * (5 if ratio else 3)
    if metric in RATES:  # of either sign; −∞ where runs diverged
        low, high = (f"{end:+.3g}" for end in parts[1:3])
        middle = [f"{parts[0]:+.3g}", f"{low} to {high}"]
    else:
        middle = [compact(parts[0]), interval_text(*parts[1:3])]
    middle += [compact(parts[3]), interval_text(*parts[4:6])] if ratio else []
    return [*middle, f"{parts[6]:.0f}"]
