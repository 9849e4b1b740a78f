"""The panels that maps are drawn on: rows and columns of small grids, with a figure per cell."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from deadtime.sweeps.axes import AXES

if TYPE_CHECKING:
    import xarray as xr

INNER = ("distance", "dwell_time")  # y and x of every panel
Colour = tuple[float, float, float]
HATCH = "#a0a0a0"


def panels_of(data: xr.Dataset) -> tuple[Figure, list[tuple[Axes, dict[str, Any]]]]:
    """A panel for every combination of the other axes: sojourns side by side, the rest below.

    Returns the figure, and every panel with its place on these axes.
    """
    outer = [str(name) for name in data.dims if name in AXES and name not in (*INNER, "sojourn")]
    columns = data.sojourn.values
    rows = list(itertools.product(*(data[name].values for name in outer)))
    y, x = (data.sizes[name] for name in INNER)
    size = (0.8 + max(1.5, 0.32 * x) * len(columns), 0.95 + (0.38 + 0.26 * y) * len(rows))
    figure = Figure(figsize=(max(size[0], 4.6), size[1]))
    grid = figure.subplots(len(rows), len(columns), sharex=True, sharey=True, squeeze=False)
    panels = []
    for (row, values), (column, sojourn) in itertools.product(enumerate(rows), enumerate(columns)):
        panel = grid[row, column]
        place = dict(zip(outer, values, strict=True))
        _frame(panel, data)
        names = [AXES[name].say(value) for name, value in place.items()] if column == 0 else []
        heads = [AXES["sojourn"].say(str(sojourn))] if row == 0 else []
        panel.set_title("\n".join([*heads, ", ".join(names)]), fontsize=8.5)
        if row == len(rows) - 1:
            panel.set_xlabel("dwell time (s)", fontsize=8.5)
        if column == 0:
            panel.set_ylabel("mode distance α" if y > 3 else "α", fontsize=8.5)
        panels.append((panel, {"sojourn": sojourn} | place))
    return figure, panels


def _frame(panel: Axes, data: xr.Dataset) -> None:
    """Ticks for the values of the inner axes, and nothing else."""
    for name, axis, limit in zip(
        INNER, (panel.yaxis, panel.xaxis), (panel.set_ylim, panel.set_xlim), strict=True
    ):
        values = data[name].values
        axis.set_ticks(range(values.size), [f"{value:g}" for value in values], fontsize=7.5)
        limit(-0.5, values.size - 0.5)
    panel.tick_params(length=0)
    panel.grid(False)
    panel.spines[:].set_visible(False)


def places_of(cells: xr.Dataset | xr.DataArray) -> Iterator[tuple[tuple[int, int], dict[str, Any]]]:
    """Row, column and place of every cell of a panel."""
    y, x = (cells[name].values for name in INNER)
    for i, j in itertools.product(range(y.size), range(x.size)):
        yield (i, j), {"distance": y[i], "dwell_time": x[j]}


def draw_cell(panel: Axes, at: tuple[int, int], colour: Colour, text: str, tied: bool) -> None:
    """One cell: its colour, paler and hatched where tied, and its figure in black or white."""
    row, column = at
    corner = (column - 0.5, row - 0.5)
    red, green, blue = (0.6 + 0.4 * part if tied else part for part in colour)
    shade = (red, green, blue)
    panel.add_patch(Rectangle(corner, 1, 1, facecolor=shade, edgecolor="white", linewidth=0.8))
    if tied:
        panel.add_patch(Rectangle(corner, 1, 1, fill=False, edgecolor=HATCH, hatch="////", lw=0.0))
    dark = float(np.dot(shade, (0.299, 0.587, 0.114))) < 0.5
    box = {"boxstyle": "square,pad=0.1", "facecolor": shade, "linewidth": 0.0}
    panel.text(
        column,
        row,
        text,
        ha="center",
        va="center",
        fontsize=6.2,
        color="white" if dark else "black",
        bbox=box if tied else None,
    )


def draw_missing(panel: Axes, at: tuple[int, int]) -> None:
    """A cell without a figure: no law could be built."""
    draw_cell(panel, at, (0.93, 0.93, 0.93), "–", tied=False)


def short(value: float) -> str:
    """A quotient in at most four characters.

    Examples
    --------
    >>> [short(value) for value in (0.0314, 0.994, 1.234, 12.34, 234.6, 19588.0, np.inf)]
    ['0.03', '0.99', '1.23', '12', '235', '2e4', '∞']
    """
    if not np.isfinite(value):
        return "∞"
    if value >= 999.5 or 0.0 < value < 0.005:
        mantissa, exponent = f"{value:.0e}".split("e")
        return f"{mantissa}e{int(exponent)}"
    return f"{value:.2f}" if value < 9.995 else f"{value:.0f}"
