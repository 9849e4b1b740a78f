"""Heat maps of one law: the median of a metric, and its regret. Dark is bad."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

from deadtime.plotting import plain
from deadtime.sweep_plots.maps import Scale, coloured
from deadtime.sweep_plots.panels import Grid, grid_of
from deadtime.sweep_plots.reduction import reduced
from deadtime.sweep_plots.selection import (
    NOT_RUN,
    RATES,
    Where,
    axes_of,
    laws_of,
    long_axes,
    oracle_or_refuse,
    quotients_of,
    selected,
    sides,
)
from deadtime.sweep_plots.words import figure_of, one_of, say, unbroken

if TYPE_CHECKING:
    import xarray as xr

SYMBOLS = {
    "ise": "∫|x|²",
    "energy": "∫|u|²",
    "cost": "∫|x|² + |u|²",
    "peak": "peak of |x|",
    "final_norm": "|x| at the end",
}
WIDE = 10.0  # largest over least figure from which colours follow the logarithm
_NARROW = 1.5  # the colours of positive figures span this factor at least
_FAR = 1e3  # figures so many times above or below the median share their colour
_LOST = 100.0  # regret at which the colours end


def plot_heat(
    data: xr.Dataset,
    law: str,
    metric: str = "ise",
    x: str | None = None,
    y: str | None = None,
    where: Where | None = None,
) -> Figure:
    """The median of a metric over the scenarios under one law, in every cell of a sweep.

    A run that diverged counts as ∞. Two axes span a panel, the others tell panels apart; axes
    with one value stand in the title.

    Parameters
    ----------
    data : xarray.Dataset
        From `deadtime.sweep.open_sweep`; reduced chunk by chunk where it is lazy.
    law : str
    metric : str
        A metric of the sweep: ise, energy, cost, peak, settling_time, decay_rate, final_norm.
    x, y : str, optional
        The axes across and up; the last two with more than one value by default.
    where : mapping, optional
        From axes to the value that each is held at.

    Raises
    ------
    ArgumentError
        If a name or value is not in the sweep, no cell is done, or there are too many panels.

    Examples
    --------
    >>> import xarray as xr
    >>> dims, values = ("delay", "law", "scenario"), [[[1.0, 2.0, 9.0]], [[3.0, 4.0, 9.0]]]
    >>> variables = {"ise": (dims, values), "diverged": (dims, np.zeros((2, 1, 3), dtype=bool))}
    >>> data = xr.Dataset(variables, {"delay": [0.5, 1.0], "law": ["mean"]})
    >>> panel = plot_heat(data, "mean").axes[0]
    >>> [cell.get_text() for cell in panel.texts]
    ['2.00', '4.00']
    """
    kept = selected(data, metric, where)
    law = one_of("law", law, laws_of(kept))
    sides(kept, x, y)  # names are checked before the store is read
    return heat(reduced(kept, metric), law, metric, x, y)


def plot_regret(
    data: xr.Dataset,
    law: str,
    metric: str = "ise",
    x: str | None = None,
    y: str | None = None,
    where: Where | None = None,
) -> Figure:
    """A metric of one law over the oracle's on the same signal, in every cell of a sweep.

    The geometric mean over the scenarios. The oracle is the law that knows the future.

    Parameters
    ----------
    data, law, metric, x, y, where
        As `plot_heat` takes them; the metric must not be decay_rate.

    Raises
    ------
    ArgumentError
        As `plot_heat`, and if the sweep has no oracle or quotients of the metric say nothing.

    Examples
    --------
    >>> import xarray as xr
    >>> dims, values = ("delay", "law", "scenario"), [[[2.0, 8.0], [1.0, 1.0]]]
    >>> variables = {"ise": (dims, values), "diverged": (dims, np.zeros((1, 2, 2), dtype=bool))}
    >>> names = {"delay": [0.5], "law": ["mean", "oracle"]}
    >>> panel = plot_regret(xr.Dataset(variables, names, {"oracle": "oracle"}), "mean").axes[0]
    >>> panel.texts[0].get_text()
    '4.00'
    """
    kept = selected(data, quotients_of(metric), where)
    law = one_of("law", law, laws_of(kept))
    sides(kept, x, y)
    oracle = oracle_or_refuse(kept)
    return regret(reduced(kept, metric, oracle=oracle), law, metric, x, y)


def heat(found: xr.Dataset, law: str, metric: str, x: str | None, y: str | None) -> Figure:
    """`plot_heat` of what `reduced` gives."""
    middle = found["quantile"].sel(law=law, level=0.5, drop=True)
    label = f"median {measure_of(found, metric)}"
    scale = scale_of(middle.values, label, "YlOrRd_r" if metric in RATES else "YlOrRd")
    grid = grid_for(found, x, y)
    figure = coloured(found, grid, middle, scale, figure_of, waiting=found[NOT_RUN])
    return headed(figure, found, grid, f"Law “{law}”")


def regret(found: xr.Dataset, law: str, metric: str, x: str | None, y: str | None) -> Figure:
    """`plot_regret` of what `reduced` gives."""
    ticks = {1.0: "1", 3.0: "3", 10.0: "10", 30.0: "30", _LOST: "100"}
    label = f"{SYMBOLS.get(metric, metric.replace('_', ' '))} over the oracle's"
    scale = Scale(LogNorm(1.0, _LOST), "YlOrRd", "max", label, ticks)
    grid, values = grid_for(found, x, y), found["regret"].sel(law=law, drop=True)
    figure = coloured(found, grid, values, scale, waiting=found[NOT_RUN])
    return headed(figure, found, grid, f"Law “{law}”")


def grid_for(found: xr.Dataset, x: str | None, y: str | None) -> Grid:
    """The panels of a map."""
    across, up = sides(found, x, y)
    return grid_of(found, (across, up), [a for a in long_axes(found) if a not in (across, up)])


def measure_of(found: xr.Dataset, metric: str) -> str:
    """A metric with its unit."""
    attributes = found["quantile"].attrs
    name = SYMBOLS.get(metric, metric.replace("_", " "))
    unit = str(attributes.get("units", "")).replace("^2", "²")
    return f"{name} ({unit})" if unit else name


def headed(figure: Figure, found: xr.Dataset, grid: Grid | None, lead: str = "") -> Figure:
    """A title: what is shown, and the axes that have one value."""
    shown = () if grid is None else (grid.x, grid.y)
    held = [axis for axis in axes_of(found) if found.sizes[axis] == 1 and axis not in shown]
    words = ", ".join(unbroken(say(found[axis], found[axis].values[0])) for axis in held)
    title = ": ".join(part for part in (lead, words) if part)
    if title:
        width, height = figure.get_size_inches()
        lines = textwrap.wrap(plain(title), int(width / 0.068))
        figure.set_size_inches(width, height + 0.18 * len(lines))
        figure.suptitle("\n".join(lines), fontsize=9.0, x=0.02, ha="left")
    return figure


def scale_of(values: np.ndarray, label: str, colours: str) -> Scale:
    """Colours for any figures: along the logarithm where they are positive and differ widely."""
    finite = values[np.isfinite(values)]
    finite = finite if finite.size else np.array([1.0])
    low, high = float(finite.min()), float(finite.max())
    if low > 0.0 and high > WIDE * low:
        middle = float(np.exp(np.median(np.log(finite))))
        ends = max(low, middle / _FAR), min(high, middle * _FAR)
        norm: Normalize = LogNorm(*ends)
        ticks = log_ticks(*ends)
    else:
        # Figures that hardly differ should not look as if they did.
        ends = low, max(high, _NARROW * low if low > 0.0 else low + 1e-9)
        norm = Normalize(*ends)
        ticks = linear_ticks(*ends)
    below, above = bool((values < ends[0]).any()), bool((values > ends[1]).any())
    extend = {(True, True): "both", (True, False): "min", (False, True): "max"}
    return Scale(norm, colours, extend.get((below, above), "neither"), label, ticks)


def log_ticks(low: float, high: float) -> dict[float, str]:
    """At most 7 round numbers from low to high: 1, 2, 5 and so on where they fit."""
    powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    for steps in ((1.0, 2.0, 5.0), (1.0, 3.0), (1.0,)):
        ticks = [step * 10.0**power for power in powers for step in steps]
        ticks = [tick for tick in ticks if low <= tick <= high]
        if len(ticks) <= 7:
            break
    return {tick: f"{tick:g}" for tick in ticks[:: -(-len(ticks) // 7) or 1]}


def linear_ticks(low: float, high: float) -> dict[float, str]:
    """About 5 round numbers from low to high."""
    from matplotlib.ticker import MaxNLocator

    ticks = MaxNLocator(5).tick_values(low, high)
    return {float(tick): f"{tick:.6g}".replace("-", "−") for tick in ticks if low <= tick <= high}
