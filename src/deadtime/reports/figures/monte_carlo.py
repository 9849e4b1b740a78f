"""The picture of many scenarios: how costs are distributed under each law."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from deadtime.base.figure_files import Width, inches, legend_columns, new_figure, style_of
from deadtime.base.figure_style import LINES, WIDTH, plain
from deadtime.plant.weight import PLAIN
from deadtime.reports.figures.colours import looks_of
from deadtime.reports.figures.sweeps.panels import round_ticks
from deadtime.reports.figures.sweeps.reduction import quantiles
from deadtime.reports.scenario_tables import LawRuns
from deadtime.scenarios.dataset import formula_of
from deadtime.simulation.tracking import TRACKING_ERROR

if TYPE_CHECKING:
    import xarray as xr

_POINTS = 2000  # of a curve: more would only make a vector file large
_FAR = 1e3  # a law whose cheapest scenarios cost so many times the best median is off the axis
_TAIL = 1e2  # nor does the axis go further than this many times a law's median


def plot_monte_carlo(
    data: xr.Dataset, title: str | None = None, width: Width | None = None
) -> Figure:
    r"""Distribution functions of the laws' costs, and of their costs over the reference law's.

    Where all laws follow a reference, of :math:`\int |r - y|` instead. A curve at (c, p): on a
    share p of the scenarios the cost is at most c. A law that diverges never reaches the top. Axes
    end where heavy tails would take all the room; laws that lie beyond an axis are named so in the
    legend.

    Parameters
    ----------
    data : xarray.Dataset
        Of `monte_carlo`: `cost` and `diverged` over (law, scenario).
    title : str, optional
    width : "column", "page" or float, optional
        Of the figure: 3.5 in, 7.16 in, or inches; narrow ones have a panel above the other.

    Raises
    ------
    ArgumentError
        If there is no scenario in it.

    Examples
    --------
    >>> import xarray as xr
    >>> dims, cost, fine = ("law", "scenario"), [[2.0, 4.0], [1.0, 4.0]], [[False] * 2] * 2
    >>> data = xr.Dataset({"cost": (dims, cost), "diverged": (dims, fine)}, {"law": ["a", "b"]})
    >>> [axes.get_xscale() for axes in plot_monte_carlo(data).axes]
    ['log', 'log']
    """
    runs = LawRuns(data)
    names, count, measure = runs.names, runs.count, runs.measure
    with rc_context(style_of(width)):
        wide = 1.55 * WIDTH if width is None else inches(width)
        beside = wide >= WIDTH
        figure = new_figure(wide, 3.2 if beside else 5.0)
        left, right = figure.subplots(*((1, 2) if beside else (2, 1)), sharey=True)
        looks = looks_of(names)
        styles: list[dict[str, Any]] = [
            {"color": looks[name].colour, "linestyle": LINES[i % len(LINES)]}
            for i, name in enumerate(names)
        ]
        seen = _panel(left, runs.losses(measure), styles)
        seen |= _panel(right, runs.relative(), styles)
        formula, word = TRACKING_ERROR, TRACKING_ERROR
        if measure == "cost":
            formula = formula_of(data["cost"])
            unit = "  (x² s + u² s)" if formula == PLAIN else ""
            formula, word = f"cost, {plain(formula)}{unit}", "cost"
        left.set_xlabel(formula)
        right.set_xlabel(
            f"{word} / {'that' if word != 'cost' else word} of “{plain(runs.reference)}”  (–)"
        )
        left.set_ylabel(f"share of {count:,} scenario{'s' * (count != 1)} (%)")
        left.set_ylim(0.0, 102.0)
        keys = [
            Line2D([], [], **styles[i], label=plain(name) + " (off the axes)" * (not seen[i]))
            for i, name in enumerate(names)
        ]
        columns = legend_columns(figure, (str(key.get_label()) for key in keys), len(keys))
        figure.legend(handles=keys, loc="outside lower center", ncols=columns)
        if title:
            figure.suptitle(plain(title), fontsize=9.5, x=0.02, ha="left")
    return figure


def _panel(
    panel: Axes, values: Float[np.ndarray, "law scenario"], styles: list[dict[str, Any]]
) -> Bool[np.ndarray, " law"]:
    """Distribution functions on a logarithmic axis; which of them can be seen."""
    limits = _limits(values)
    if limits is None:
        panel.text(0.5, 0.5, "every run diverged", ha="center", transform=panel.transAxes)
        panel.set_xticks([])
        return np.zeros(len(values), dtype=bool)
    low, high = limits
    panel.set_xscale("log")
    for row, style in zip(values, styles, strict=True):
        _curve(panel, row, (low, high), style)
    panel.set_xlim(low, high)
    round_ticks(panel.xaxis, low, high)
    return np.any(values < high, axis=1)


def _curve(
    panel: Axes, row: np.ndarray, limits: tuple[float, float], style: dict[str, Any]
) -> None:
    """One law's share of scenarios up to each value, right to the edges of the axis."""
    finite = np.sort(row[np.isfinite(row)])
    if finite.size == 0:
        return
    ranks = np.unique(np.linspace(0, finite.size - 1, _POINTS).astype(int))
    low, high = limits
    x = np.concatenate(([low], np.maximum(finite[ranks], 0.5 * low), [2.0 * high]))
    share = np.concatenate(
        ([0.0], 100.0 * (ranks + 1) / row.size, [100.0 * finite.size / row.size])
    )
    panel.step(np.maximum.accumulate(x), share, where="post", **style)


def _limits(values: Float[np.ndarray, "law scenario"]) -> tuple[float, float] | None:
    """Ends of the axis, for laws that are comparable with the best; None if no run ended well."""
    rows = [row[np.isfinite(row) & (row > 0.0)] for row in values]
    rows = [row for row in rows if row.size]
    if not rows:
        # Costs of 0 have no place on the axis, but a picture they do have.
        return (0.1, 10.0) if np.isfinite(values).any() else None
    medians = [float(np.median(row)) for row in rows]
    best = min(medians)
    ends = [quantiles(row, (0.002, 0.05, 0.99)).tolist() for row in rows]
    near = [i for i, (_, low, _) in enumerate(ends) if low <= _FAR * best]
    low = min(ends[i][0] for i in near)
    tops = [min(ends[i][2], _TAIL * max(medians[i], best)) for i in near]
    high = min(max(tops), _FAR * _TAIL * best)
    # Air on both sides, also where all laws cost the same.
    air = max((high / low) ** 0.03, 1.02)
    return low / air, high * air
