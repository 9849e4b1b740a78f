"""Quantile bands of the laws along one axis of a sweep; bars where it has no order."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from deadtime.base.figure_files import Width, inches, legend_columns, new_figure, style_of
from deadtime.base.figure_style import LINES, WIDTH, plain
from deadtime.reports.figures.colours import colours_of
from deadtime.reports.figures.sweeps import selection
from deadtime.reports.figures.sweeps.panels import (
    add_title,
    measure_of,
    places_of,
    round_ticks,
    too_many,
    words_of,
)
from deadtime.reports.figures.sweeps.reduction import reduce

if TYPE_CHECKING:
    import xarray as xr


_WIDE = 20.0  # largest over least figure from which the axis is logarithmic
_DOTS = 15  # values across up to which each has a dot
_SPREAD = 8.0  # largest over least value from which the axis across is
_NARROW = 1.5  # a logarithmic axis spans this factor at least
_FAR = 1e3  # times the median of medians, where it ends
_DEEP = 1e9  # a logarithmic axis spans this factor at most


Quantiles = Float[np.ndarray, "x level"]
Mark = tuple[str, Any]  # the colour and the line of a law


def figure_of_panels(count: int, width: Width | None = None) -> tuple[Figure, list[Axes], int]:
    """Panels in reading order, and how many are side by side."""
    narrow = width is not None and inches(width) < WIDTH
    columns = 1 if count == 1 or narrow else 2 if count in (2, 4) else 3
    rows = math.ceil(count / columns)
    size = (WIDTH, 3.4) if count == 1 else (1.55 * WIDTH, 1.0 + 1.9 * rows)
    figure = new_figure(*size, width)
    grid = figure.add_gridspec(rows, columns)
    panels = [figure.add_subplot(grid[i // columns, i % columns]) for i in range(count)]
    for i, panel in enumerate(panels):
        panel.tick_params(labelbottom=i >= count - columns, labelsize=8.0)
    return figure, panels, columns


def is_ordered(data: xr.Dataset, across: str | None) -> bool:
    """Whether the axis across is of numbers that a line can join."""
    return across is not None and data.sizes[across] > 1 and data[across].dtype.kind in "iuf"


def draw(
    panel: Axes,
    data: xr.Dataset,
    across: str | None,
    cells: Float[np.ndarray, "law x level"],
    marks: Sequence[Mark],
) -> None:
    """Bands along numbers; for text and single values bars, 5 to 95 and 25 to 75 %."""
    values = np.zeros(1) if across is None else data[across].values
    if is_ordered(data, across):
        order = np.argsort(values)
        places = values[order].astype(float)
        for law, mark in zip(cells, marks, strict=True):
            _band(panel, places, law[order], mark, 1.0 / len(marks))
        panel.margins(x=0.04)
        if places[0] > 0.0 and places[-1] > _SPREAD * places[0]:
            panel.set_xscale("log")
            round_ticks(panel.xaxis, places[0], places[-1])
        return
    for number, (law, (colour, _)) in enumerate(zip(cells, marks, strict=True)):
        offset = (number - (len(marks) - 1) / 2.0) * min(0.12, 0.8 / len(marks))
        x = np.arange(values.size) + offset
        low, lower, middle, upper, high = _clip(law).T
        panel.vlines(x, low, high, color=colour, linewidth=1.0)
        panel.vlines(x, lower, upper, color=colour, linewidth=4.0, alpha=0.5)
        panel.plot(x, middle, "o", color=colour, markersize=3.5)
    texts = [] if across is None else [plain(selection.text_of(value)) for value in values.tolist()]
    panel.set_xticks(range(len(texts)), texts)
    if sum(map(len, texts)) > 24:
        panel.tick_params("x", rotation=30)
    panel.set_xlim(-0.5, values.size - 0.5)
    panel.grid(False, axis="x")


def _band(panel: Axes, x: np.ndarray, cells: Quantiles, mark: Mark, share: float) -> None:
    """A law along an axis of numbers; a cell without figures is a gap."""
    low, lower, middle, upper, high = _clip(cells).T
    colour, line = mark
    for bottom, top, alpha in ((low, high, 0.25), (lower, upper, 0.5)):
        # The more laws, the paler: where bands lie on each other their edges tell them apart.
        panel.fill_between(x, bottom, top, color=colour, alpha=alpha * share, linewidth=0.0)
        for edge in (bottom, top):
            panel.plot(x, edge, color=colour, alpha=1.2 * alpha, linewidth=0.6)
    marker = "o" if x.size <= _DOTS else ""
    panel.plot(x, middle, linestyle=line, color=colour, marker=marker, markersize=2.8)


def _clip(cells: Quantiles) -> Quantiles:
    """Infinite figures as ones far beyond every axis, which lines can lead to."""
    return np.clip(cells, -1e250, 1e250)


def is_wide(values: np.ndarray) -> bool:
    """Whether the figures of all panels are positive and differ so much as to ask for powers."""
    finite = values[np.isfinite(values)]
    return finite.size > 0 and bool(0.0 < _WIDE * finite.min() < finite.max())


def set_scale(panel: Axes, cells: np.ndarray, logarithmic: bool) -> float:
    """Set the axis up for what is in a panel; its upper end."""
    finite = cells[np.isfinite(cells)]
    if not finite.size:
        panel.set_yticks([])
        panel.set_ylim(0.0, 1.0)
        panel.text(0.5, 0.5, "no figures", ha="center", transform=panel.transAxes)
        return -np.inf
    low, high = float(finite.min()), float(finite.max())
    if not logarithmic:
        air = 0.05 * (high - low) or 0.1 * abs(high) or 1.0
        panel.set_ylim(low - air, high + air)
        return high + air
    medians = cells[..., 2][np.isfinite(cells[..., 2])]
    middle = float(np.exp(np.median(np.log(medians)))) if medians.size else high
    least = float(medians.min()) if medians.size else low
    # Where some cells grow beyond all measure it is the others that are to be seen.
    high = max(min(high, _FAR * middle, _DEEP * least), _NARROW * low)
    low = max(low, high / _DEEP)
    air = (high / low) ** 0.05
    low, high = low / air, high * air
    panel.set_yscale("log")
    round_ticks(panel.yaxis, low, high)
    panel.set_ylim(low, high)
    return high


def add_legend(figure: Figure, laws: Sequence[tuple[str, Mark]], joined: bool) -> None:
    """Laws and levels below the panels."""
    keys: list[Line2D | Patch] = []
    for label, (colour, line) in laws:
        key = Line2D([], [], color=colour, marker="o", markersize=3.0, label=label)
        key.set_linestyle(line if joined else "")  # pyright: ignore[reportArgumentType]
        keys.append(key)
    for label, alpha, width in (("25–75 %", 0.5, 4.0), ("5–95 %", 0.25, 1.0)):
        if joined:
            face, edge = (0.2, 0.2, 0.2, 0.6 * alpha), (0.2, 0.2, 0.2, 1.2 * alpha)
            keys.append(Patch(facecolor=face, edgecolor=edge, linewidth=0.6, label=label))
        else:
            shade = {"color": "#555555", "alpha": 0.5 if width > 1.0 else 1.0}
            keys.append(Line2D([], [], linewidth=width, label=label, **shade))
    columns = legend_columns(figure, (str(key.get_label()) for key in keys), len(keys))
    figure.legend(handles=keys, loc="outside lower center", ncols=columns)


MOST = 12  # panels


def plot_bands(
    data: xr.Dataset,
    metric: str = "ise",
    x: str | None = None,
    where: selection.Where | None = None,
    laws: Sequence[str] | None = None,
    width: Width | None = None,
) -> Figure:
    """Median and quantile bands of a metric under every law, along one axis of a sweep.

    The dark band holds the middle half of the scenarios, from 25 to 75 %, the pale one 90 %, from
    5 to 95 %. A run that diverged counts as ∞ and takes the band out of the frame. Values that are
    text, or a single one, have bars instead of bands.

    Parameters
    ----------
    data, metric, where
        As `plot_heat` takes them.
    x : str, optional
        The axis across; the last with more than one value by default.
    laws : sequence of str, optional
        All by default.
    width : "column", "page" or float, optional
        Of the figure: 3.5 in, 7.16 in, or inches.

    Raises
    ------
    ArgumentError
        As `plot_heat`, and if the other axes make more than 12 panels.

    Examples
    --------
    >>> import numpy as np, xarray as xr
    >>> dims, values = ("delay", "law", "scenario"), [[[1.0, 2.0, 9.0]], [[3.0, 4.0, 9.0]]]
    >>> variables = {"ise": (dims, values), "diverged": (dims, np.zeros((2, 1, 3), dtype=bool))}
    >>> data = xr.Dataset(variables, {"delay": [0.5, 1.0], "law": ["mean"]})
    >>> plot_bands(data).axes[0].lines[-1].get_ydata()
    array([2., 4.])
    """
    kept = selection.select(data, metric, where)
    selection.named_laws(kept, laws, ())
    panes(kept, x)  # names and sizes are checked before the store is read
    return bands(reduce(kept, metric), metric, x, laws, width)


def bands(
    reduced: xr.Dataset,
    metric: str,
    x: str | None,
    laws: Sequence[str] | None = None,
    width: Width | None = None,
) -> Figure:
    """`plot_bands` of what `reduce` gives."""
    across, rest = panes(reduced, x)
    shown = selection.named_laws(reduced, laws, selection.laws_of(reduced))
    colours = colours_of(selection.laws_of(reduced), selection.oracle_of(reduced))
    marks = [(colours[law], LINES[i % len(LINES)]) for i, law in enumerate(shown)]
    places = list(places_of(reduced, rest))
    values = reduced["quantile"].sel(law=shown).transpose("law", ..., "level")
    logarithmic = is_wide(values.values)
    seen = np.zeros(len(shown), dtype=bool)
    with rc_context(style_of(width)):
        figure, panels, columns = figure_of_panels(len(places), width)
        for number, (panel, place) in enumerate(zip(panels, places, strict=True)):
            cells = values.isel(place).values
            cells = cells.reshape(len(shown), -1, cells.shape[-1])  # one axis is longer than 1
            draw(panel, reduced, across, cells, marks)
            top = set_scale(panel, cells, logarithmic)
            seen |= (cells[..., 2] < top).any(axis=1)
            words = ", ".join(map(selection.unbroken, words_of(reduced, place)))
            letters = {1: 70, 2: 50, 3: 34}[columns]
            panel.set_title(textwrap.fill(words, letters), fontsize=8.5)
            if number % columns == 0:
                panel.set_ylabel(plain(measure_of(reduced, metric)))
            if across and number >= len(places) - columns:
                panel.set_xlabel(plain(selection.label_of(reduced[across])))
        figure.align_ylabels()
        labels = [plain(law) + " (off the axes)" * (not seen[i]) for i, law in enumerate(shown)]
        add_legend(figure, list(zip(labels, marks, strict=True)), is_ordered(reduced, across))
    return add_title(figure, reduced, None)


def panes(data: xr.Dataset, x: str | None) -> tuple[str | None, list[str]]:
    """The axis across, and those that tell panels apart."""
    across, _ = selection.sides(data, x, None)
    rest = [axis for axis in selection.long_axes(data) if axis != across]
    count = math.prod(data.sizes[axis] for axis in rest)
    if count > MOST:
        raise too_many(data, rest, count, MOST)
    return across, rest
