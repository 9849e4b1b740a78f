"""The part of a sweep to draw, checked, and words for its cells, axes, metrics and laws."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from deadtime.base.errors import ArgumentError

if TYPE_CHECKING:
    import xarray as xr


def text_of(value: object) -> str:
    """A value of an axis.

    Examples
    --------
    >>> text_of(0.50), text_of("uniform"), text_of(np.int64(20240101)), text_of(np.True_)
    ('0.5', 'uniform', '20240101', 'true')
    """
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    return f"{value:g}" if isinstance(value, float | np.floating) else str(value)


def name_of(axis: xr.DataArray) -> str:
    """The long name of an axis, for readers."""
    return str(axis.attrs.get("long_name") or axis.name).replace("_", " ")


def label_of(axis: xr.DataArray) -> str:
    """An axis with its unit, for the side of a panel.

    Examples
    --------
    >>> import xarray as xr
    >>> label_of(xr.DataArray([1.0], dims="delay", name="delay", attrs={"units": "s"}))
    'delay (s)'
    """
    unit = axis.attrs.get("units", "")
    return f"{name_of(axis)} ({unit})" if unit else name_of(axis)


def say(axis: xr.DataArray, value: object) -> str:
    """A value with the name of its axis, for titles.

    Examples
    --------
    >>> import xarray as xr
    >>> delay = xr.DataArray([0.5], dims="delay", name="delay", attrs={"units": "s"})
    >>> kind = xr.DataArray([""], dims="k", name="sojourn", attrs={"long_name": "sojourns"})
    >>> say(delay, 0.5), say(kind, "uniform"), say(delay.rename("plant.tyre"), "old")
    ('delay 0.5 s', 'uniform sojourns', 'plant.tyre old')
    """
    if isinstance(value, str):
        name = name_of(axis)
        # Of a path or a name of one's own the value comes last, as on the other axes.
        return f"{name} {value}" if name == str(axis.name).replace("_", " ") else f"{value} {name}"
    return f"{name_of(axis)} {text_of(value)} {axis.attrs.get('units', '')}".rstrip()


def unbroken(words: str) -> str:
    """Words that stay on one line."""
    return words.replace(" ", "\u00a0")


def short(value: float) -> str:
    """A quotient in at most four characters.

    Examples
    --------
    >>> [short(value) for value in (0.0314, 0.994, 1.234, 12.34, 234.6, 19588.0, np.inf)]
    ['0.03', '0.99', '1.23', '12', '235', '2e4', '∞']
    """
    if not np.isfinite(value):
        return "∞"
    if value >= 999.5 or 0.0 < value < 0.005:
        return _power(value)
    return f"{value:.2f}" if value < 9.995 else f"{value:.0f}"


def _power(value: float) -> str:
    mantissa, exponent = f"{value:.0e}".split("e")
    return f"{mantissa}e{int(exponent)}"


def figure_of(value: float) -> str:
    """A metric of any sign and size in at most six characters.

    Examples
    --------
    >>> [figure_of(value) for value in (0.00314, 0.0314, 0.314, 3.14159, 31.4159, 314.159)]
    ['3e-3', '0.031', '0.31', '3.14', '31.4', '314']
    >>> figure_of(-0.512), figure_of(31415.9), figure_of(0.0), figure_of(-np.inf)
    ('−0.51', '3e4', '0', '−∞')
    """
    size, sign = abs(value), "−" if value < 0.0 else ""
    if size == 0.0 or not np.isfinite(size):
        return sign + ("0" if size == 0.0 else "∞")
    if size < 0.00995 or size >= 9999.5:
        return sign + _power(size)
    digits = 3 if size < 0.0995 else 2 if size < 9.995 else 1 if size < 99.95 else 0
    return f"{sign}{size:.{digits}f}"


def one_of(name: str, value: object, known: Iterable[Any]) -> str:
    """A name that is known, or an error that says which are."""
    from difflib import get_close_matches

    names = list(map(str, known))
    if value in names:
        return str(value)
    near = get_close_matches(str(value), names, 1)
    hint = f": did you mean {near[0]!r}?" if near else "."
    listed = f"one of {', '.join(names)}" if names else "left out, as there is none"
    raise ArgumentError(f"{name} must be {listed}, got {value!r}{hint}")


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
    """The metric, if quotients of it compare laws; else it is refused."""
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
