"""Words for the findings of a study: quotients, counts of cells, regions of the grid."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from deadtime.base.wording import amount
from deadtime.scenarios.sweeps.axes import AXES

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True)
class AnswerTable:
    """A small table beside an answer."""

    caption: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Answer:
    """A question, its answer from the data, and the tables beside it.

    `duels` are pairs of laws whose comparison a map should show.
    """

    question: str
    sentences: tuple[str, ...]
    tables: tuple[AnswerTable, ...] = ()
    duels: tuple[tuple[str, str], ...] = ()


def change(ratio: float) -> str:
    """A quotient of two ∫|x|² in words.

    Examples
    --------
    >>> change(0.984), change(0.02), change(1.031), change(2.5), change(1.0001), change(np.inf)
    ('1.6 % less', '50.0 times less', '3.1 % more', '2.50 times as much', 'the same',
     'infinitely more')
    """
    if not np.isfinite(ratio):
        return "infinitely more"
    if abs(ratio - 1.0) < 5e-4:
        return "the same"
    if ratio < 0.5:
        return f"{amount(1.0 / ratio)} times less" if ratio > 0.0 else "infinitely less"
    if ratio > 2.0:
        return f"{amount(ratio)} times as much"
    percent = 100.0 * abs(ratio - 1.0)
    digits = 1 if percent < 9.95 else 0
    return f"{percent:.{digits}f} % {'less' if ratio < 1.0 else 'more'}"


def of_cells(count: int, total: int) -> str:
    """How many of the cells.

    Examples
    --------
    >>> of_cells(3, 160), of_cells(160, 160), of_cells(0, 160)
    ('3 of 160 cells', 'all 160 cells', 'none of the 160 cells')
    """
    if count == 0:
        return f"none of the {total} cells"
    if count == total:
        return f"all {total} cells" if total > 1 else "the one cell"
    return f"{count} of {total} cells"


def tally(verdict: xr.DataArray) -> tuple[int, int, int, int]:
    """In how many cells a duel's first law is better, its second, neither; and all compared."""
    values = verdict.values[~np.isnan(verdict.values)]
    counts = [int(np.sum(values == which)) for which in (1.0, -1.0, 0.0)]
    return counts[0], counts[1], counts[2], values.size


def region(cells: xr.DataArray) -> str:
    """Where on the grid some cells lie: the axes that they do not span, and how far they reach.

    Empty if they span every axis.

    Examples
    --------
    >>> import xarray as xr
    >>> grid = {"distance": [0.5, 1.0], "dwell_time": [0.1, 0.2, 0.4]}
    >>> mask = xr.DataArray([[False] * 3, [False, True, True]], grid, tuple(grid))
    >>> region(mask)
    'mode distance α 1, dwell time ≥ 0.2 s'
    """
    parts = []
    for name in cells.dims:
        values = cells[name].values
        touched = cells.any([dim for dim in cells.dims if dim != name]).values
        if touched.all() or not touched.any():
            continue
        parts.append(_reach(str(name), values, touched))
    return ", ".join(parts)


def _reach(name: str, values: np.ndarray, touched: np.ndarray) -> str:
    """The touched values of one axis: a single one, an end of it, or a list."""
    axis, chosen = AXES[name], values[touched]
    if isinstance(values[0], str):
        return " or ".join(map(str, chosen)) + f" {axis.label}"
    order = np.argsort(values)
    ordered, unit = touched[order], f" {axis.unit}".rstrip()
    if chosen.size == 1:
        return axis.say(chosen[0])
    if ordered[-1] and np.all(np.diff(ordered.astype(int)) >= 0):
        return f"{axis.label} ≥ {chosen.min():g}{unit}"
    if ordered[0] and np.all(np.diff(ordered.astype(int)) <= 0):
        return f"{axis.label} ≤ {chosen.max():g}{unit}"
    return f"{axis.label} {' or '.join(f'{value:g}' for value in chosen)}{unit}"


def span(values: np.ndarray) -> str:
    """A quotient over several cells: in the median one, and from the least to the largest.

    Examples
    --------
    >>> span(np.array([0.5, 0.9, 0.99]))
    '10 % less in the median cell (50 % less to 1.0 % less)'
    """
    values = values[~np.isnan(values)]
    if values.size == 1:
        return change(float(values[0]))
    ends = f"{change(float(values.min()))} to {change(float(values.max()))}"
    return f"{change(float(np.median(values)))} in the median cell ({ends})"


def percent(share: float) -> str:
    """A share in per cent, without hiding that it is not quite all or nothing.

    Examples
    --------
    >>> percent(1.0), percent(0.9996), percent(0.424), percent(0.0)
    ('100 %', '99.9 %', '42 %', '0 %')
    """
    value = 100.0 * share
    if 99.0 <= value < 100.0:
        return f"{min(value, 99.9):.1f} %"
    return f"{max(value, 0.1):.1f} %" if 0.0 < value < 1.0 else f"{value:.0f} %"


def times_the_oracle(regret: np.ndarray) -> str:
    """Regret in the median cell and in the worst.

    Examples
    --------
    >>> times_the_oracle(np.array([1.01, 1.5, np.nan, 20.0]))
    '1.50 times the oracle’s in the median cell and 20.0 times in the worst'
    """
    regret = regret[~np.isnan(regret)]
    if not regret.size:
        return "not known"
    middle, worst = amount(float(np.median(regret))), amount(float(regret.max()))
    return f"{middle} times the oracle’s in the median cell and {worst} times in the worst"


def place_of(values: xr.DataArray, flat: int) -> dict[str, Any]:
    """The cell with a flat index: its value along every axis."""
    index = np.unravel_index(flat, values.shape)
    return {str(dim): values[dim].values[i] for dim, i in zip(values.dims, index, strict=True)}


def words_of(place: Mapping[str, Any]) -> str:
    """A cell in words.

    Examples
    --------
    >>> words_of({"sojourn": "uniform", "delay": 1.0, "dwell_time": 0.2})
    'uniform sojourns, delay 1 s, dwell time 0.2 s'
    """
    return ", ".join(AXES[name].say(value) for name, value in place.items())
