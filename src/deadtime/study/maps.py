"""Maps of a study: small multiples over dwell time and mode distance.

A cell carries its figure; a hatched cell is a tie. Where a map shows one law, dark is bad.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from deadtime.plotting import COLOURS, STYLE, WIDTH, plain
from deadtime.study.findings import LOST, best, duel, summary
from deadtime.study.panels import (
    HATCH,
    draw_cell,
    draw_missing,
    panels_of,
    places_of,
    short,
)
from deadtime.study.phrases import words_of
from deadtime.sweeps.laws import AWARE

if TYPE_CHECKING:
    import xarray as xr

MOST_RATIO = 3.0  # where the colours of a comparison end, in both directions
MAP_STYLE = {**STYLE, "hatch.linewidth": 0.6}
HUES = {
    "averaged": COLOURS[0],
    "averaged, dwell-aware": COLOURS[5],
    "mean": COLOURS[1],
    "mean, dwell-aware": COLOURS[4],
    "expected": COLOURS[2],
    "averaged, minimax": COLOURS[3],
    "averaged, one-gain minimax": "#7a4fa3",
    "optimal": "#303030",
}
OTHER = "#8c8c8c"


def colour_of(law: str) -> str:
    """The colour of a law: warm for the mean laws, blue for the averaged ones."""
    return HUES.get(law, OTHER)


def plot_winners(data: xr.Dataset, laws: Sequence[str]) -> Figure:
    """Which of some laws is best in every cell, and the runner-up's ∫|x|² over the winner's."""
    found = best(data, laws)
    with rc_context(MAP_STYLE):
        figure, panels = panels_of(data)
        for panel, place in panels:
            cells = found.sel(place)
            for at, inner in places_of(cells):
                cell = cells.sel(inner)
                law, ratio = str(cell.winner.item()), float(cell.ratio)
                if not law:
                    draw_missing(panel, at)
                    continue
                text = "" if np.isnan(ratio) else short(1.0 / ratio if ratio else np.inf)
                draw_cell(panel, at, to_rgb(colour_of(law)), text, tied=float(cell.verdict) == 0.0)
        winners = [law for law in laws if (found.winner == law).any()]
        keys = [Patch(facecolor=colour_of(law), label=plain(law)) for law in winners]
        keys.append(Patch(facecolor="white", edgecolor=HATCH, hatch="////", lw=0.0, label="tied"))
        figure.legend(handles=keys, loc="outside lower center", ncols=5, handlelength=1.6)
    return figure


def plot_duel(data: xr.Dataset, first: str, second: str) -> Figure:
    """The mean quotient of two laws' ∫|x|²: blue where the first is better, red the second."""
    found = duel(data, first, second)
    label = f"∫|x|², {first} over {second}"
    return _coloured(
        data,
        found.ratio,
        (LogNorm(1.0 / MOST_RATIO, MOST_RATIO), "RdBu_r", "both"),
        (label, {1.0 / MOST_RATIO: "1/3", 0.5: "1/2", 1.0: "1", 2.0: "2", MOST_RATIO: "3"}),
        tied=found.verdict == 0.0,
    )


def plot_regret(data: xr.Dataset, law: str) -> Figure:
    """The mean ∫|x|² of a law over the oracle's."""
    return _coloured(
        data,
        summary(data).regret.sel(law=law),
        (LogNorm(1.0, LOST), "YlOrRd", "max"),
        (f"∫|x|², {law} over oracle", {1.0: "1", 3.0: "3", 10.0: "10", 30.0: "30", 100.0: "100"}),
    )


def plot_stabilised(data: xr.Dataset, law: str) -> Figure:
    """The share of the signals on which |x| ends below where it started."""
    return _coloured(
        data,
        100.0 * summary(data).stabilised.sel(law=law),
        (Normalize(0.0, 100.0), "YlOrRd_r", "neither"),
        (f"signals stabilised, {law} (%)", {share: f"{share:g}" for share in (0, 25, 50, 75, 100)}),
        write=_share,
    )


def _coloured(
    data: xr.Dataset,
    values: xr.DataArray,
    colours: tuple[Normalize, str, str],
    scale: tuple[str, dict[float, str]],
    write: Callable[[float], str] = short,
    tied: xr.DataArray | None = None,
) -> Figure:
    """Values in every cell, coloured along (norm, colour map, open ends), with a colour bar."""
    norm, name, extend = colours
    colour = ScalarMappable(norm, colormaps[name])
    with rc_context(MAP_STYLE):
        figure, panels = panels_of(data)
        for panel, place in panels:
            cells = values.sel(place)
            for at, inner in places_of(cells):
                value = float(cells.sel(inner))
                if np.isnan(value):
                    draw_missing(panel, at)
                    continue
                shade = to_rgb(colour.to_rgba(np.clip(value, norm.vmin, norm.vmax)))  # pyright: ignore
                same = tied is not None and bool(tied.sel(place).sel(inner))
                draw_cell(panel, at, shade, write(value), same)
        label, ticks = scale
        bar = figure.colorbar(
            colour, ax=[panel for panel, _ in panels], extend=extend, aspect=30, pad=0.015
        )
        bar.set_ticks(list(ticks), labels=list(ticks.values()))
        bar.ax.minorticks_off()
        bar.set_label(plain(label), fontsize=8.0)
        bar.outline.set_visible(False)
    return figure


def _share(value: float) -> str:
    """A percentage that is not rounded to all or nothing."""
    rounded = f"{value:.0f}"
    if rounded == "100" and value < 100.0:
        return ">99"
    return "<1" if rounded == "0" and value > 0.0 else rounded


def plot_lines(data: xr.Dataset, laws: Sequence[str]) -> Figure:
    """Regret of some laws over the dwell time, with intervals, on one line of the grid.

    The line has the longest delay, α nearest to 1 and the first kind of sojourns.
    """
    place = reference(data)
    figures, times = summary(data).sel(place), data.dwell_time.values
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 3.5))
        axes = figure.subplots()
        axes.axhline(1.0, color="#888888", linewidth=0.8)
        for number, law in enumerate(laws):
            middle, low, high = (
                figures[name].sel(law=law).values
                for name in ("regret", "regret_low", "regret_high")
            )
            shown = np.isfinite(middle)
            gaps = np.nan_to_num([middle - low, high - middle], posinf=0.0)[:, shown]
            axes.errorbar(
                np.flatnonzero(shown) + 0.05 * (number - (len(laws) - 1) / 2.0),
                middle[shown],
                gaps,
                fmt="s--" if law.endswith(AWARE) else "o-",
                color=colour_of(law),
                markersize=3.5,
                capsize=2.0,
                label=plain(law),
            )
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.set_xticks(range(times.size), [f"{time:g}" for time in times])
        axes.set_xlabel("dwell time (s)")
        axes.set_ylabel("∫|x|² over the oracle's")
        axes.set_title(words_of(place))
        figure.legend(loc="outside lower center", ncols=2)
    return figure


def reference(data: xr.Dataset) -> dict[str, Any]:
    """The line of the grid along the dwell time that stands for the others."""
    place: dict[str, Any] = {}
    for name in map(str, data.ise.dims[:-2]):
        values = data[name].values
        if name == "delay":
            place[name] = values.max()
        elif name == "distance":
            place[name] = values[np.argmin(np.abs(values - 1.0))]
        elif name != "dwell_time":
            place[name] = values[0]
    return place
