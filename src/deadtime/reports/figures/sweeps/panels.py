"""The panels that maps are drawn on: small grids with a figure per cell, titles above them."""

from __future__ import annotations

import itertools
import math
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

from deadtime.base.errors import ArgumentError
from deadtime.base.figure_files import new_figure
from deadtime.base.figure_style import WIDTH, plain
from deadtime.plant.weight import PLAIN
from deadtime.reports.figures.sweeps.selection import (
    axes_of,
    label_of,
    name_of,
    say,
    text_of,
    unbroken,
)
from deadtime.scenarios.dataset import formula_of

if TYPE_CHECKING:
    import xarray as xr


HATCH = "#a0a0a0"
NOT_BUILT, NOT_RUN = (0.93, 0.93, 0.93), (0.985, 0.985, 0.985)
FIGURES = 24  # cells along a side of a panel up to which each has its figure
_CELL = {"x": 0.32, "y": 0.26}  # inches
_MANY = {"x": 4.2, "y": 3.2}  # inches of a side with more cells
_LEAST = 1.5  # inches across of a panel
_WIDEST = 11.0  # inches of a figure with columns
_LETTER = 0.062  # inches, in the size of titles
_MOST = 40  # panels


@dataclass(frozen=True)
class PanelGrid:
    """Which axes lie where: across and up in every panel, across and down over the panels."""

    x: str | None
    y: str | None
    columns: str | None = None
    rows: tuple[str, ...] = ()

    @property
    def inner(self) -> dict[str, str | None]:
        return {"x": self.x, "y": self.y}

    def has_figures(self, data: xr.Dataset) -> bool:
        """Whether cells are few enough for a figure in each."""
        return all(name is None or data.sizes[name] <= FIGURES for name in (self.x, self.y))

    def table(self, values: xr.DataArray, place: Place) -> np.ndarray:
        """The values of one panel, (y, x); axes that are nowhere have one value."""
        dims = [name for name in (self.y, self.x) if name is not None]
        held = {str(name): 0 for name in values.dims if name not in dims}
        cells = values.isel(held | place).transpose(*dims).values
        return cells.reshape(
            [1 if name is None else values.sizes[name] for name in (self.y, self.x)]
        )


Place = dict[str, int]


def grid_of(
    data: xr.Dataset, sides: tuple[str | None, str | None], rest: Sequence[str]
) -> PanelGrid:
    """Panels for a sweep: the last of the other axes that fits goes across, the others down."""
    x, y = sides
    count = math.prod(data.sizes[name] for name in rest)
    if count > _MOST:
        raise too_many(data, rest, count, _MOST)
    width = max(_LEAST, _length(data, "x", x))
    fitting = [name for name in rest if 0.8 + width * data.sizes[name] <= _WIDEST]
    columns = fitting[-1] if fitting else None
    return PanelGrid(x, y, columns, tuple(name for name in rest if name != columns))


def too_many(data: xr.Dataset, axes: Sequence[str], count: int, most: int) -> ArgumentError:
    """The refusal of more panels than a figure takes."""
    sizes = " × ".join(f"{data.sizes[name]} of {name}" for name in axes)
    largest = max(axes, key=lambda name: data.sizes[name])
    return ArgumentError(
        f"a figure takes {most} panels at most, got {count} ({sizes}): hold axes at one value "
        f"with where, such as {largest} at {text_of(data[largest].values[0])}."
    )


def places_of(data: xr.Dataset, axes: Sequence[str]) -> Iterator[Place]:
    """Every combination of indices on some axes, the last axis fastest."""
    for index in itertools.product(*(range(data.sizes[name]) for name in axes)):
        yield dict(zip(axes, index, strict=True))


def words_of(data: xr.Dataset, place: Place) -> list[str]:
    """A place in words, one for each of its axes."""
    return [plain(say(data[name], data[name].values[i])) for name, i in place.items()]


def panels_of(data: xr.Dataset, grid: PanelGrid) -> tuple[Figure, list[tuple[Axes, Place]]]:
    """A panel for every combination of the outer axes.

    Returns the figure, and every panel with its place on these axes.
    """
    heads = list(places_of(data, [grid.columns] if grid.columns else []))
    rows = list(places_of(data, grid.rows))
    width = max(_LEAST, _length(data, "x", grid.x))
    span = width if len(heads) > 1 else max(width, WIDTH - 0.8)
    names = [", ".join(words_of(data, row)) for row in rows]
    wrapped = [textwrap.wrap(name, int(span / _LETTER)) for name in names]
    lines = max(1, *map(len, wrapped))
    height = (0.24 + 0.14 * lines + _length(data, "y", grid.y)) * len(rows)
    figure = new_figure(max(0.8 + width * len(heads), WIDTH), 0.95 + height)
    panes = figure.subplots(len(rows), len(heads), sharex=True, sharey=True, squeeze=False)
    panels = []
    for (row, place), (column, head) in itertools.product(enumerate(rows), enumerate(heads)):
        panel = panes[row, column]
        _frame(panel, data, grid, (column == 0, row == len(rows) - 1))
        above = [textwrap.fill(word, int(width / _LETTER)) for word in words_of(data, head)]
        above = above if row == 0 else []
        beside = "\n".join(wrapped[row]) if column == 0 else ""
        panel.set_title("\n".join([*above, beside] if grid.rows else above), fontsize=8.5)
        panels.append((panel, head | place))
    return figure, panels


def _length(data: xr.Dataset, side: str, name: str | None) -> float:
    """Inches of a side of a panel."""
    count = 1 if name is None else data.sizes[name]
    return _CELL[side] * count if count <= FIGURES else _MANY[side]


def _frame(panel: Axes, data: xr.Dataset, grid: PanelGrid, labelled: tuple[bool, bool]) -> None:
    """Ticks for the values of the inner axes, and nothing else."""
    for side, name in grid.inner.items():
        axis = panel.xaxis if side == "x" else panel.yaxis
        values = [] if name is None else data[name].values.tolist()
        texts = [plain(text_of(value)) for value in values]
        chosen = range(0, len(values), math.ceil(len(values) / FIGURES) if values else 1)
        axis.set_ticks(chosen, [texts[i] for i in chosen], fontsize=7.5)
        limit = panel.set_xlim if side == "x" else panel.set_ylim
        limit(-0.5, max(len(values), 1) - 0.5)
        length = _length(data, side, name)
        room = max(length, _LEAST) / max(len(chosen), 1) / 0.06
        if side == "x" and max(map(len, texts), default=0) > room:
            panel.tick_params("x", rotation=90)
        if name is not None and labelled[side == "x"]:
            axis.set_label_text(_axis_label(data[name], side, length), fontsize=8.5)
    panel.tick_params(length=0)
    panel.grid(False)
    panel.spines[:].set_visible(False)


def _axis_label(axis: xr.DataArray, side: str, length: float) -> str:
    """The label of an axis: only the symbol at its end, or on several lines, where it is short."""
    label, symbol = label_of(axis), name_of(axis).split()[-1]
    if side == "x" or len(label) * _LETTER <= 1.1 * length:
        return plain(label)
    if len(symbol) == 1 and symbol.isalpha():
        return plain(symbol)
    return plain(textwrap.fill(label, max(int(length / _LETTER), 8)))


def draw_cells(
    panel: Axes,
    shades: Float[np.ndarray, "y x rgb"],
    texts: Sequence[Sequence[str]],
    tied: Bool[np.ndarray, "y x"],
) -> None:
    """All cells of a panel, ties pale and hatched; figures and borders where cells are few."""
    few = max(tied.shape) <= FIGURES
    shades = np.where(tied[..., None], 0.6 + 0.4 * shades, shades)
    y, x = (np.arange(count + 1) - 0.5 for count in tied.shape)
    lines = "white" if few else "none"
    panel.pcolormesh(x, y, shades, edgecolors=lines, linewidth=0.8, rasterized=not few)
    if tied.any():
        ties = np.ma.masked_array(np.ones(tied.shape), ~tied)
        panel.pcolor(x, y, ties, facecolors="none", edgecolors=HATCH, hatch="////", linewidth=0.0)
    for (row, column), text in np.ndenumerate(np.array(texts)) if few else ():
        shade = shades[row, column]
        panel.text(
            column, row, str(text), ha="center", va="center", fontsize=6.2,
            color="white" if shade @ (0.299, 0.587, 0.114) < 0.5 else "black",
            bbox={"boxstyle": "square,pad=0.1", "facecolor": shade, "linewidth": 0.0}
            if tied[row, column] else None,
        )  # fmt: skip


_NARROW, _WIDE = 8.0, 2e3  # ranges of a logarithmic axis with plain ticks, and with ticks 1, 2, 5


def round_ticks(axis: Axis, low: float, high: float) -> None:
    """Plain numbers on a logarithmic axis of few decades; powers of ten on any other."""
    if high < _WIDE * low:
        narrow = high < _NARROW * low
        axis.set_major_locator(
            MaxNLocator(5) if narrow else LogLocator(subs=(1.0, 2.0, 5.0), numticks=12)
        )
        axis.set_major_formatter("{x:g}")
        axis.set_minor_locator(NullLocator())


SYMBOLS = {
    "ise": "∫|x|²",
    "energy": "∫|u|²",
    "cost": PLAIN,
    "peak": "peak of |x|",
    "final_norm": "|x| at the end",
}


def symbol_of(metric: str, reduced: xr.Dataset | None = None) -> str:
    """A metric as readers call it; the cost by the weight that the dataset was made with.

    Examples
    --------
    >>> symbol_of("ise"), symbol_of("settling_time")
    ('∫|x|²', 'settling time')
    """
    if metric == "cost" and reduced is not None:
        return formula_of(reduced["quantile"])
    return SYMBOLS.get(metric, metric.replace("_", " "))


def measure_of(reduced: xr.Dataset, metric: str) -> str:
    """A metric with its unit."""
    attributes = reduced["quantile"].attrs
    name = symbol_of(metric, reduced)
    unit = str(attributes.get("units", "")).replace("^2", "²")
    return f"{name} ({unit})" if unit else name


def add_title(
    figure: Figure, reduced: xr.Dataset, grid: PanelGrid | None, lead: str = ""
) -> Figure:
    """A title: what is shown, and the axes that have one value."""
    shown = () if grid is None else (grid.x, grid.y)
    held = [axis for axis in axes_of(reduced) if reduced.sizes[axis] == 1 and axis not in shown]
    words = ", ".join(unbroken(say(reduced[axis], reduced[axis].values[0])) for axis in held)
    title = ": ".join(part for part in (lead, words) if part)
    if title:
        width, height = figure.get_size_inches()
        lines = textwrap.wrap(plain(title), int(width / 0.068))
        figure.set_size_inches(width, height + 0.18 * len(lines))
        figure.suptitle("\n".join(lines), fontsize=9.0, x=0.02, ha="left")
    return figure
