"""Which part of a sweep to draw, checked: cells, axes, metrics and laws by their names."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from deadtime.base.errors import ArgumentError
from deadtime.reports.figures.sweeps.axis_words import one_of, text_of

if TYPE_CHECKING:
    import xarray as xr

SAME = 1e-9  # relative difference below which a number names a value of an axis
RUNS = ("law", "scenario")
# Metrics of which more is better, and which may be negative: a quotient of two says nothing.
RATES = ("decay_rate",)
NOT_RUN = "not_run"  # of a reduced sweep: which cells are not done
Where = Mapping[str, Any]


def axes_of(data: xr.Dataset) -> list[str]:
    """The axes of the grid, in their order, of a sweep or of what `reduce` makes of it."""
    cells = data[NOT_RUN] if NOT_RUN in data else data["diverged"]
    return [str(name) for name in cells.dims if name not in RUNS]


def metrics_of(data: xr.Dataset) -> list[str]:
    """The metrics that every law and scenario has."""
    return [
        str(name)
        for name, values in data.data_vars.items()
        if name != "diverged" and set(RUNS) <= set(values.dims)
    ]


def laws_of(data: xr.Dataset) -> list[str]:
    """The laws, in their order."""
    return [str(name) for name in data["law"].values]


def causal(data: xr.Dataset) -> list[str]:
    """The laws that do not know the future."""
    return [law for law in laws_of(data) if law != oracle_of(data)]


def oracle_of(data: xr.Dataset) -> str:
    """The law that knows the future, "" if there is none."""
    name = str(data.attrs.get("oracle", ""))
    return name if name in laws_of(data) else ""


def select(data: xr.Dataset, metric: str, where: Where | None = None) -> xr.Dataset:
    """The cells to draw, and of the metrics only one; an axis keeps the value that it is held at.

    Raises
    ------
    ArgumentError
        If an axis, a value on it or the metric is not there, or no cell is done.
    """
    names = {*map(str, data.variables), *map(str, data.dims)}
    missing = {"diverged", *RUNS} - names
    if missing:
        raise ArgumentError(
            f"data must be of a sweep, got a dataset without {', '.join(sorted(missing))}: open "
            "its store with deadtime.open_sweep."
        )
    metric = one_of("metric", metric, metrics_of(data))
    kept = data[[metric, "diverged", *(["done"] if "done" in data else [])]]
    for name, value in (where or {}).items():
        axis = one_of("where", name, axes_of(data))
        kept = kept.isel({axis: [_index(axis, value, data[axis].values)]})
    if kept.sizes["scenario"] == 0 or ("done" in kept and not bool(kept["done"].any())):
        raise ArgumentError(
            "data must hold a cell that is done, got none"
            + (" where asked: choose other cells." if where else ": run the sweep first.")
        )
    return kept


def _index(axis: str, value: object, values: np.ndarray) -> int:
    """The place of a value on its axis: a number nearly exactly, anything else by its text."""
    number = _number(value)
    for place, one in enumerate(values.tolist()):
        near = isinstance(one, int | float) and math.isclose(number, one, rel_tol=SAME)
        if near or text_of(one) == str(value):
            return place
    listed = ", ".join(map(text_of, values.tolist()))
    raise ArgumentError(f"where[{axis!r}] must be one of {listed}, got {text_of(value)}.")


def _number(value: object) -> float:
    """A number, also one that is written as text, as on a command line; NaN for other text."""
    try:
        return float(value)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError):
        return math.nan


def long_axes(data: xr.Dataset) -> list[str]:
    """The axes with more than one value."""
    return [axis for axis in axes_of(data) if data.sizes[axis] > 1]


def sides(data: xr.Dataset, x: str | None, y: str | None) -> tuple[str | None, str | None]:
    """The axes across and up: the last two with more than one value, unless given.

    None where no axis is left.
    """
    named = [one_of(*pair, axes_of(data)) for pair in (("x", x), ("y", y)) if pair[1] is not None]
    if len(set(named)) < len(named):
        raise ArgumentError(f"x and y must be different axes, got {x!r} for both.")
    free = [axis for axis in long_axes(data) if axis not in named]
    x = (free.pop() if free else None) if x is None else x
    y = (free.pop() if free else None) if y is None else y
    return x, y


def named_laws(data: xr.Dataset, laws: Sequence[str] | None, default: Sequence[str]) -> list[str]:
    """Laws by name, in the order given."""
    if laws is None:
        return list(default)
    if isinstance(laws, str) or not laws:
        raise ArgumentError(f"laws must be a list of at least one name, got {laws!r}.")
    return list(dict.fromkeys(one_of("laws", law, laws_of(data)) for law in laws))


def quotients_of(metric: str) -> str:
    """The same metric, if quotients of it compare laws."""
    if metric in RATES:
        raise ArgumentError(
            f"metric must not be {metric!r}, which may be negative, so that a quotient of two says "
            "nothing: draw it with plot_heat or plot_bands, or choose another metric."
        )
    return metric


def oracle_or_refuse(data: xr.Dataset) -> str:
    """The law that knows the future, which regret is held against."""
    if not oracle_of(data):
        raise ArgumentError(
            "data must hold a law that knows the future, got none: sweep a problem file with a "
            '[[law]] of kind = "exact", or a study with poles; or draw wins, which need none.'
        )
    return oracle_of(data)
