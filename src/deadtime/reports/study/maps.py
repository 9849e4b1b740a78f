"""Maps of a study: small multiples over dwell time and mode distance.

A cell carries its figure; a hatched cell is a tie. Where a map shows one law, dark is bad.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import rc_context
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

from deadtime.base.figure_files import new_figure
from deadtime.base.figure_style import STYLE, WIDTH, plain
from deadtime.reports.figures.colours import colour_of
from deadtime.reports.figures.sweeps.bands import is_wide, set_scale
from deadtime.reports.figures.sweeps.maps import Scale, colour_map, winners
from deadtime.reports.figures.sweeps.panels import PanelGrid
from deadtime.reports.study.findings import LOST, best, duel, summary
from deadtime.reports.study.phrases import words_of
from deadtime.scenarios.sweeps.axes import AWARE

if TYPE_CHECKING:
    import xarray as xr

MOST_RATIO = 3.0  # where the colours of a comparison end, in both directions


def _grid(data: xr.Dataset) -> PanelGrid:
    """Dwell time across and mode distance up; sojourns side by side, the other axes down."""
    x, y, columns = "dwell_time", "distance", "sojourn"
    rows = (str(name) for name in data.ise.dims[:-2])
    return PanelGrid(x, y, columns, tuple(name for name in rows if name not in (x, y, columns)))


def plot_winners(data: xr.Dataset, laws: Sequence[str]) -> Figure:
    """Which of some laws is best in every cell, and the runner-up's ∫|x|² over the winner's."""
    comparison = best(data, laws)
    number = {"": -1} | {law: i for i, law in enumerate(laws)}
    places = np.vectorize(number.__getitem__, otypes=[int])(comparison.winner.values)
    comparison = comparison.assign(winner=comparison.winner.copy(data=places))
    return winners(data, _grid(data), comparison, {law: colour_of(law) for law in laws})


def plot_duel(data: xr.Dataset, first: str, second: str) -> Figure:
    """The mean quotient of two laws' ∫|x|²: blue where the first is better, red the second."""
    comparison = duel(data, first, second)
    ticks = {1.0 / MOST_RATIO: "1/3", 0.5: "1/2", 1.0: "1", 2.0: "2", MOST_RATIO: "3"}
    norm, label = LogNorm(1.0 / MOST_RATIO, MOST_RATIO), f"∫|x|², {first} over {second}"
    scale = Scale(norm, "RdBu_r", "both", label, ticks)
    return colour_map(data, _grid(data), comparison.ratio, scale, tied=comparison.verdict == 0.0)


def plot_regret(data: xr.Dataset, law: str) -> Figure:
    """The mean ∫|x|² of a law over the oracle's."""
    ticks = {1.0: "1", 3.0: "3", 10.0: "10", 30.0: "30", 100.0: "100"}
    scale = Scale(LogNorm(1.0, LOST), "YlOrRd", "max", f"∫|x|², {law} over oracle", ticks)
    return colour_map(data, _grid(data), summary(data).regret.sel(law=law), scale)


def plot_stabilised(data: xr.Dataset, law: str) -> Figure:
    """The share of the signals on which |x| ends below where it started."""
    shares = 100.0 * summary(data).stabilised.sel(law=law)
    ticks = {share: f"{share:g}" for share in (0.0, 25.0, 50.0, 75.0, 100.0)}
    label = f"signals stabilised, {law} (%)"
    scale = Scale(Normalize(0.0, 100.0), "YlOrRd_r", "neither", label, ticks)
    return colour_map(data, _grid(data), shares, scale, write=_share)


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
    figures, times = summary(data).sel(place).transpose(..., "law", "dwell_time"), data.dwell_time
    cells = [figures[name].sel(law=laws).values for name in ("regret_low", "regret", "regret_high")]
    with rc_context(STYLE):
        figure = new_figure(WIDTH, 3.5)
        axes = figure.subplots()
        axes.axhline(1.0, color="#888888", linewidth=0.8)
        for number, (law, low, middle, high) in enumerate(zip(laws, *cells, strict=True)):
            shown = np.isfinite(middle)
            gaps = np.nan_to_num([middle - low, high - middle], posinf=0.0)[:, shown]
            axes.errorbar(
                np.flatnonzero(shown) + 0.05 * (number - (len(laws) - 1) / 2.0),
                middle[shown], gaps, fmt="s--" if law.endswith(AWARE) else "o-",
                color=colour_of(law), markersize=3.5, capsize=2.0,
                label=plain(law) + " (off the axis)" * (not np.any(middle <= LOST)),
            )  # fmt: skip
        near = np.array([1.0, *(value for value in np.ravel(cells) if value <= LOST)])
        set_scale(axes, np.stack([near] * 3, axis=-1), is_wide(near))
        axes.set_xticks(range(times.size), [f"{time:g}" for time in times.values])
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
