"""Maps of the best law."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from deadtime.base.errors import ArgumentError
from deadtime.reports.figures.colours import colours_of
from deadtime.reports.figures.sweeps.heat import grid_for
from deadtime.reports.figures.sweeps.maps import winners
from deadtime.reports.figures.sweeps.reduction import reduce
from deadtime.reports.figures.sweeps.selection import (
    NOT_RUN,
    Where,
    causal,
    laws_of,
    named_laws,
    quotients_of,
    select,
    sides,
)
from deadtime.reports.figures.sweeps.titles import add_title, symbol_of

if TYPE_CHECKING:
    import xarray as xr


def plot_wins(
    data: xr.Dataset,
    metric: str = "ise",
    laws: Sequence[str] | None = None,
    x: str | None = None,
    y: str | None = None,
    where: Where | None = None,
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
    kept = select(data, quotients_of(metric), where)
    rivals = named_laws(kept, laws, causal(kept))
    if not rivals:
        raise ArgumentError(
            "laws must be given where the oracle is the only law: name it, or run more laws."
        )
    sides(kept, x, y)
    return wins(reduce(kept, metric, rivals), rivals, metric, x, y)


def wins(
    found: xr.Dataset, rivals: Sequence[str], metric: str, x: str | None, y: str | None
) -> Figure:
    """`plot_wins` of what `reduce` gives for these rivals."""
    colours = colours_of(laws_of(found))
    grid = grid_for(found, x, y)
    figure = winners(found, grid, found, {law: colours[law] for law in rivals}, found[NOT_RUN])
    second = ", and the runner-up's over it" * grid.has_figures(found)
    lead = f"Least {symbol_of(metric, found)}{second}"
    return add_title(figure, found, grid, lead)
