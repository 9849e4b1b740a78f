"""What stands above and beside a figure: the metric with its unit, and the axes held at a value."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from deadtime.base.figure_style import plain
from deadtime.plant.weight import PLAIN
from deadtime.reports.figures.sweeps.axis_words import say, unbroken
from deadtime.reports.figures.sweeps.panels import PanelGrid
from deadtime.reports.figures.sweeps.selection import axes_of
from deadtime.scenarios.dataset import formula_of

if TYPE_CHECKING:
    import xarray as xr

SYMBOLS = {
    "ise": "∫|x|²",
    "energy": "∫|u|²",
    "cost": PLAIN,
    "peak": "peak of |x|",
    "final_norm": "|x| at the end",
}


def symbol_of(metric: str, found: xr.Dataset | None = None) -> str:
    """What readers call a metric; the cost by the weight that the dataset was made with.

    Examples
    --------
    >>> symbol_of("ise"), symbol_of("settling_time")
    ('∫|x|²', 'settling time')
    """
    if metric == "cost" and found is not None:
        return formula_of(found["quantile"])
    return SYMBOLS.get(metric, metric.replace("_", " "))


def measure_of(found: xr.Dataset, metric: str) -> str:
    """A metric with its unit."""
    attributes = found["quantile"].attrs
    name = symbol_of(metric, found)
    unit = str(attributes.get("units", "")).replace("^2", "²")
    return f"{name} ({unit})" if unit else name


def add_title(figure: Figure, found: xr.Dataset, grid: PanelGrid | None, lead: str = "") -> Figure:
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
