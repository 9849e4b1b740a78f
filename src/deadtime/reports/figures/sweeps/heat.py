"""Maps of a sweep: the median of a metric under one law, its regret (dark is bad), the best law."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from deadtime.base.errors import ArgumentError
from deadtime.reports.figures.colours import colours_of
from deadtime.reports.figures.sweeps import selection
from deadtime.reports.figures.sweeps.maps import Scale, colour_map, scale_of, winners
from deadtime.reports.figures.sweeps.panels import (
    PanelGrid,
    add_title,
    grid_of,
    measure_of,
    symbol_of,
)
from deadtime.reports.figures.sweeps.reduction import reduce

if TYPE_CHECKING:
    import xarray as xr


_LOST = 100.0  # regret at which the colours end


def plot_heat(
    data: xr.Dataset,
    law: str,
    metric: str = "ise",
    x: str | None = None,
    y: str | None = None,
    where: selection.Where | None = None,
) -> Figure:
    """The median of a metric over the scenarios under one law, in every cell of a sweep.

    A run that diverged counts as ∞. Two axes span a panel, the others tell panels apart; axes
    with one value are named in the title.

    Parameters
    ----------
    data : xarray.Dataset
        From `deadtime.open_sweep`; reduced chunk by chunk where it is lazy.
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
    >>> import numpy as np, xarray as xr
    >>> dims, values = ("delay", "law", "scenario"), [[[1.0, 2.0, 9.0]], [[3.0, 4.0, 9.0]]]
    >>> variables = {"ise": (dims, values), "diverged": (dims, np.zeros((2, 1, 3), dtype=bool))}
    >>> data = xr.Dataset(variables, {"delay": [0.5, 1.0], "law": ["mean"]})
    >>> panel = plot_heat(data, "mean").axes[0]
    >>> [cell.get_text() for cell in panel.texts]
    ['2.00', '4.00']
    """
    cells = selection.select(data, metric, where)
    law = selection.one_of("law", law, selection.laws_of(cells))
    selection.sides(cells, x, y)  # names are checked before the store is read
    return heat(reduce(cells, metric), law, metric, x, y)


def plot_regret(
    data: xr.Dataset,
    law: str,
    metric: str = "ise",
    x: str | None = None,
    y: str | None = None,
    where: selection.Where | None = None,
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
    >>> import numpy as np, xarray as xr
    >>> dims, values = ("delay", "law", "scenario"), [[[2.0, 8.0], [1.0, 1.0]]]
    >>> variables = {"ise": (dims, values), "diverged": (dims, np.zeros((1, 2, 2), dtype=bool))}
    >>> names = {"delay": [0.5], "law": ["mean", "oracle"]}
    >>> panel = plot_regret(xr.Dataset(variables, names, {"oracle": "oracle"}), "mean").axes[0]
    >>> panel.texts[0].get_text()
    '4.00'
    """
    cells = selection.select(data, selection.quotients_of(metric), where)
    law = selection.one_of("law", law, selection.laws_of(cells))
    selection.sides(cells, x, y)
    oracle = selection.oracle_or_refuse(cells)
    return regret(reduce(cells, metric, oracle=oracle), law, metric, x, y)


def heat(reduced: xr.Dataset, law: str, metric: str, x: str | None, y: str | None) -> Figure:
    """`plot_heat` of what `reduce` gives."""
    middle = reduced["quantile"].sel(law=law, level=0.5, drop=True)
    label = f"median {measure_of(reduced, metric)}"
    scale = scale_of(middle.values, label, "YlOrRd_r" if metric in selection.RATES else "YlOrRd")
    grid = grid_for(reduced, x, y)
    figure = colour_map(
        reduced, grid, middle, scale, selection.figure_of, waiting=reduced[selection.NOT_RUN]
    )
    return add_title(figure, reduced, grid, f"Law “{law}”")


def regret(reduced: xr.Dataset, law: str, metric: str, x: str | None, y: str | None) -> Figure:
    """`plot_regret` of what `reduce` gives."""
    ticks = {1.0: "1", 3.0: "3", 10.0: "10", 30.0: "30", _LOST: "100"}
    label = f"{symbol_of(metric, reduced)} over the oracle's"
    scale = Scale(LogNorm(1.0, _LOST), "YlOrRd", "max", label, ticks)
    grid, values = grid_for(reduced, x, y), reduced["regret"].sel(law=law, drop=True)
    figure = colour_map(reduced, grid, values, scale, waiting=reduced[selection.NOT_RUN])
    return add_title(figure, reduced, grid, f"Law “{law}”")


def grid_for(reduced: xr.Dataset, x: str | None, y: str | None) -> PanelGrid:
    """The panels of a map."""
    across, up = selection.sides(reduced, x, y)
    rest = [axis for axis in selection.long_axes(reduced) if axis not in (across, up)]
    return grid_of(reduced, (across, up), rest)


def plot_wins(
    data: xr.Dataset,
    metric: str = "ise",
    laws: Sequence[str] | None = None,
    x: str | None = None,
    y: str | None = None,
    where: selection.Where | None = None,
) -> Figure:
    """Which law is best in every cell of a sweep, and the runner-up's metric over the winner's.

    Laws meet on the same signals: the best has the least geometric mean of quotients. Pale and
    hatched cells are tied: Student's 95 % interval of the mean holds 1, or the mean reads 1.00.

    Parameters
    ----------
    data, metric, x, y, where
        As `plot_heat` takes them; the metric must not be decay_rate.
    laws : sequence of str, optional
        The laws to choose from; all but the oracle by default.

    Raises
    ------
    ArgumentError
        As `plot_heat`, and if quotients of the metric say nothing.

    Examples
    --------
    >>> import numpy as np, xarray as xr
    >>> dims, values = ("delay", "law", "scenario"), [[[2.0, 8.0, 8.0], [1.0, 4.0, 4.0]]]
    >>> variables = {"ise": (dims, values), "diverged": (dims, np.zeros((1, 2, 3), dtype=bool))}
    >>> figure = plot_wins(xr.Dataset(variables, {"delay": [0.5], "law": ["averaged", "mean"]}))
    >>> figure.axes[0].texts[0].get_text(), figure.legends[0].get_texts()[0].get_text()
    ('2.00', 'mean')
    """
    cells = selection.select(data, selection.quotients_of(metric), where)
    rivals = selection.named_laws(cells, laws, selection.causal(cells))
    if not rivals:
        raise ArgumentError(
            "laws must be given where the oracle is the only law: name it, or run more laws."
        )
    selection.sides(cells, x, y)
    return wins(reduce(cells, metric, rivals), rivals, metric, x, y)


def wins(
    reduced: xr.Dataset, rivals: Sequence[str], metric: str, x: str | None, y: str | None
) -> Figure:
    """`plot_wins` of what `reduce` gives for these rivals."""
    colours = colours_of(selection.laws_of(reduced))
    grid = grid_for(reduced, x, y)
    figure = winners(
        reduced, grid, reduced, {law: colours[law] for law in rivals}, reduced[selection.NOT_RUN]
    )
    second = ", and the runner-up's over it" * grid.has_figures(reduced)
    lead = f"Least {symbol_of(metric, reduced)}{second}"
    return add_title(figure, reduced, grid, lead)
