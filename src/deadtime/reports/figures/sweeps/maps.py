"""Two kinds of maps: figures coloured along a scale, and which of some laws is best.

A cell carries its figure; a hatched cell is a tie.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from deadtime.base.figure_files import legend_columns
from deadtime.base.figure_style import STYLE, plain
from deadtime.reports.figures.sweeps.panels import (
    HATCH,
    NOT_BUILT,
    NOT_RUN,
    PanelGrid,
    draw_cells,
    panels_of,
    round_ticks,
)
from deadtime.reports.figures.sweeps.selection import short

if TYPE_CHECKING:
    import xarray as xr


MAP_STYLE = {**STYLE, "hatch.linewidth": 0.6}
_READS_1 = 1.005  # as 1.00, below it
EMPTY, WAITING = "–", "…"  # in a cell where no law could be built, and in one not run yet


@dataclass(frozen=True)
class Scale:
    """How a figure becomes a colour, and what stands beside the colour bar; ticks if unusual."""

    norm: Normalize
    colours: str
    extend: str
    label: str
    ticks: Mapping[float, str] = field(default_factory=dict)


def colour_map(
    data: xr.Dataset,
    grid: PanelGrid,
    values: xr.DataArray,
    scale: Scale,
    write: Callable[[float], str] = short,
    tied: xr.DataArray | None = None,
    waiting: xr.DataArray | None = None,
) -> Figure:
    """Values in every cell, coloured along a scale, with a colour bar.

    NaN is a law that could not be built; `waiting` says which cells have not been run.
    """
    colour = ScalarMappable(scale.norm, colormaps[scale.colours])
    with rc_context(MAP_STYLE):
        figure, panels = panels_of(data, grid)
        for panel, place in panels:
            cells = grid.table(values, place)
            shades = colour.to_rgba(np.clip(cells, scale.norm.vmin, scale.norm.vmax))  # pyright: ignore
            texts = [[write(value) for value in row] for row in cells.tolist()]
            same = np.zeros(cells.shape, bool) if tied is None else grid.table(tied, place)
            holes = None if waiting is None else grid.table(waiting, place)
            _draw(panel, np.asarray(shades)[..., :3], texts, same, (np.isnan(cells), holes))
        axes = [panel for panel, _ in panels]
        bar = figure.colorbar(colour, ax=axes, extend=scale.extend, aspect=30, pad=0.015)
        if scale.ticks:
            bar.set_ticks(list(scale.ticks), labels=list(scale.ticks.values()))
            bar.ax.minorticks_off()
        elif isinstance(scale.norm, LogNorm):
            round_ticks(bar.ax.yaxis, *bar.mappable.get_clim())
        room = int(17.0 * figure.get_figheight())
        bar.set_label(textwrap.fill(plain(scale.label), room), fontsize=8.0)
        bar.outline.set_visible(False)
        keys = [] if waiting is None else keys_of(values.isnull(), waiting)
        if keys:
            figure.legend(handles=keys, loc="outside lower center", ncols=2, handlelength=1.6)
    return figure


def winners(
    data: xr.Dataset,
    grid: PanelGrid,
    ranking: xr.Dataset,
    colours: Mapping[str, str],
    waiting: xr.DataArray | None = None,
) -> Figure:
    """Which law is best in every cell, and the runner-up's figure over the winner's.

    `data` has the axes. `found` has winner, an index into `colours`, −1 where there is none; ratio,
    the winner's figure over the runner-up's; verdict, 0 where they are tied. What reads 1.00 is
    tied, too, however sure it is that it is more. `waiting` says which cells have not been run.
    """
    palette = np.array([to_rgb(colour) for colour in colours.values()])
    with rc_context(MAP_STYLE):
        figure, panels = panels_of(data, grid)
        for panel, place in panels:
            best, ratio, verdict = (
                grid.table(ranking[name], place) for name in ("winner", "ratio", "verdict")
            )
            holes = None if waiting is None else grid.table(waiting, place)
            with np.errstate(divide="ignore"):
                gaps = (1.0 / ratio).tolist()
            texts = [["" if np.isnan(gap) else short(gap) for gap in row] for row in gaps]
            same = (verdict == 0.0) | (ratio * _READS_1 > 1.0)
            _draw(panel, palette[best], texts, same, (best < 0, holes))
        present = np.unique(ranking["winner"].values)
        keys = [
            Patch(facecolor=colour, label=plain(law))
            for i, (law, colour) in enumerate(colours.items())
            if i in present
        ]
        keys.append(Patch(facecolor="white", edgecolor=HATCH, hatch="////", lw=0.0, label="tied"))
        if waiting is not None:
            keys += keys_of(ranking["winner"] < 0, waiting)
        columns = legend_columns(figure, (str(key.get_label()) for key in keys), 5)
        figure.legend(handles=keys, loc="outside lower center", ncols=columns, handlelength=1.6)
    return figure


def keys_of(empty: xr.DataArray, waiting: xr.DataArray) -> list[Patch]:
    """Keys for cells without a figure, as far as there are any."""
    keys = []
    if bool((empty & ~waiting).any()):
        keys.append(Patch(facecolor=NOT_BUILT, label=f"{EMPTY}  could not be built"))
    if bool(waiting.any()):
        line = {"edgecolor": HATCH, "lw": 0.5}
        keys.append(Patch(facecolor=NOT_RUN, label=f"{WAITING}  not run yet", **line))
    return keys


def _draw(
    panel: Axes,
    shades: np.ndarray,
    texts: Sequence[list[str]],
    tied: np.ndarray,
    without: tuple[np.ndarray, np.ndarray | None],
) -> None:
    """Cells, those without a figure grey."""
    empty, waiting = without
    marks = [(empty, NOT_BUILT, EMPTY)]
    if waiting is not None:
        marks.append((waiting, NOT_RUN, WAITING))
    shades = np.array(shades, dtype=float)
    for cells, shade, text in marks:
        shades[cells] = shade
        for row, column in np.argwhere(cells):
            texts[row][column] = text
    draw_cells(panel, shades, texts, tied & ~empty)


WIDE = 10.0  # largest over least figure from which colours follow the logarithm
_NARROW = 1.5  # the colours of positive figures span this factor at least
_FAR = 1e3  # figures so many times above or below the median share their colour


def scale_of(values: np.ndarray, label: str, colours: str) -> Scale:
    """Colours for any figures: along the logarithm where they are positive and differ widely."""
    finite = values[np.isfinite(values)]
    finite = finite if finite.size else np.array([1.0])
    low, high = float(finite.min()), float(finite.max())
    if low > 0.0 and high > WIDE * low:
        middle = float(np.exp(np.median(np.log(finite))))
        ends = max(low, middle / _FAR), min(high, middle * _FAR)
        norm: Normalize = LogNorm(*ends)
    else:
        # Figures that hardly differ should not look as if they did.
        ends = low, max(high, _NARROW * low if low > 0.0 else low + 1e-9)
        norm = Normalize(*ends)
    below, above = bool((values < ends[0]).any()), bool((values > ends[1]).any())
    extend = {(True, True): "both", (True, False): "min", (False, True): "max"}
    return Scale(norm, colours, extend.get((below, above), "neither"), label)
