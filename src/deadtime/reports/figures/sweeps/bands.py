"""Quantile bands of the laws along one axis of a sweep."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from deadtime.base.figure_files import Width, style_of
from deadtime.base.figure_style import LINES, plain
from deadtime.reports.figures.colours import colours_of
from deadtime.reports.figures.sweeps.axis_words import label_of
from deadtime.reports.figures.sweeps.band_panels import (
    add_legend,
    draw,
    figure_of_panels,
    is_ordered,
    is_wide,
    set_scale,
    title_of,
)
from deadtime.reports.figures.sweeps.panels import places_of, too_many, words_of
from deadtime.reports.figures.sweeps.reduction import reduce
from deadtime.reports.figures.sweeps.selection import (
    Where,
    laws_of,
    long_axes,
    named_laws,
    oracle_of,
    select,
    sides,
)
from deadtime.reports.figures.sweeps.titles import add_title, measure_of

if TYPE_CHECKING:
    import xarray as xr

MOST = 12  # panels


def plot_bands(
    data: xr.Dataset,
    metric: str = "ise",
    x: str | None = None,
    where: Where | None = None,
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
    kept = select(data, metric, where)
    named_laws(kept, laws, ())
    panes(kept, x)  # names and sizes are checked before the store is read
    return bands(reduce(kept, metric), metric, x, laws, width)


def bands(
    found: xr.Dataset,
    metric: str,
    x: str | None,
    laws: Sequence[str] | None = None,
    width: Width | None = None,
) -> Figure:
    """`plot_bands` of what `reduce` gives."""
    across, rest = panes(found, x)
    shown = named_laws(found, laws, laws_of(found))
    colours = colours_of(laws_of(found), oracle_of(found))
    marks = [(colours[law], LINES[i % len(LINES)]) for i, law in enumerate(shown)]
    places = list(places_of(found, rest))
    values = found["quantile"].sel(law=shown).transpose("law", ..., "level")
    logarithmic = is_wide(values.values)
    seen = np.zeros(len(shown), dtype=bool)
    with rc_context(style_of(width)):
        figure, panels, columns = figure_of_panels(len(places), width)
        for number, (panel, place) in enumerate(zip(panels, places, strict=True)):
            cells = values.isel(place).values
            cells = cells.reshape(len(shown), -1, cells.shape[-1])  # one axis is longer than 1
            draw(panel, found, across, cells, marks)
            top = set_scale(panel, cells, logarithmic)
            seen |= (cells[..., 2] < top).any(axis=1)
            panel.set_title(title_of(words_of(found, place), columns), fontsize=8.5)
            if number % columns == 0:
                panel.set_ylabel(plain(measure_of(found, metric)))
            if across and number >= len(places) - columns:
                panel.set_xlabel(plain(label_of(found[across])))
        figure.align_ylabels()
        labels = [plain(law) + " (off the axes)" * (not seen[i]) for i, law in enumerate(shown)]
        add_legend(figure, list(zip(labels, marks, strict=True)), is_ordered(found, across))
    return add_title(figure, found, None)


def panes(data: xr.Dataset, x: str | None) -> tuple[str | None, list[str]]:
    """The axis across, and those that tell panels apart."""
    across, _ = sides(data, x, None)
    rest = [axis for axis in long_axes(data) if axis != across]
    count = math.prod(data.sizes[axis] for axis in rest)
    if count > MOST:
        raise too_many(data, rest, count, MOST)
    return across, rest
