"""Words for the axes of a grid: their labels, and what a value on them is called."""

from __future__ import annotations

from collections.abc import Iterable
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
    """What readers call an axis: its long name."""
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
    """A number by its first digit and its power of ten."""
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
