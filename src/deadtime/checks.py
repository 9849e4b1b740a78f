"""Validation at the edge: each function returns a clean value or raises ArgumentError."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from deadtime.errors import ArgumentError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


def number(name: str, value: object) -> float:
    """A finite real number."""
    if isinstance(value, (str, bytes)):  # float would read some of them, and comparisons none
        raise ArgumentError(
            f"{name} must be a number, got {value!r}, a {type(value).__name__}: pass it without "
            "quotes, or convert it with float."
        )
    try:
        result = float(value)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError):
        raise ArgumentError(
            f"{name} must be a number, got {value!r}, a {type(value).__name__}."
        ) from None
    if not math.isfinite(result):
        raise ArgumentError(f"{name} must be finite, got {result}.")
    return result


def positive(name: str, value: object, unit: str = "s") -> float:
    """A finite number above zero."""
    result = number(name, value)
    if result <= 0.0:
        raise ArgumentError(f"{name} must be positive, in {unit}, got {result:g}.")
    return result


def index(name: str, value: object, count: int) -> int:
    """An integer in 0, …, count − 1."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise ArgumentError(f"{name} must be an integer in 0..{count - 1}, got {value!r}.")
    if not 0 <= value < count:
        raise ArgumentError(f"{name} must be in 0..{count - 1}, got {value}: modes count from 0.")
    return int(value)


def instance(name: str, value: object, kind: type) -> None:
    """Refuse a value that is not of a kind."""
    if not isinstance(value, kind):
        raise ArgumentError(f"{name} must be a {kind.__name__}, got {type(value).__name__}.")


def count(name: str, value: object, least: int = 1) -> int:
    """An integer of at least `least`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise ArgumentError(f"{name} must be an integer of at least {least}, got {value!r}.")
    return int(value)


def real_array(name: str, value: ArrayLike, form: str, ndim: int) -> np.ndarray:
    """A read-only, C-contiguous float64 array with `ndim` axes and finite entries.

    `form` is how the message writes the expected shape, such as ``(modes, n, n)``.
    """
    try:
        raw = np.asarray(value)
    except ValueError:
        raise ArgumentError(
            f"{name} must have shape {form}, got rows of different lengths: "
            "give every mode the same number of states and inputs."
        ) from None
    if raw.dtype.kind not in "biuf":
        raise ArgumentError(f"{name} must hold real numbers, got an array of {raw.dtype}.")
    if raw.ndim != ndim:
        raise ArgumentError(f"{name} must have shape {form}, got {raw.shape}{_hint(raw, ndim)}.")
    if raw.size == 0:
        raise ArgumentError(f"{name} must have shape {form}, got the empty shape {raw.shape}.")
    bad = np.argwhere(~np.isfinite(raw))
    if bad.size:
        where = ", ".join(map(str, bad[0]))
        raise ArgumentError(f"{name}[{where}] must be finite, got {raw[tuple(bad[0])]}.")
    result = np.array(raw, dtype=np.float64, order="C")
    result.flags.writeable = False
    return result


def as_floats(name: str, value: ArrayLike, form: str) -> np.ndarray:
    """An array of floats of any shape; NaN and infinity pass."""
    try:
        raw = np.asarray(value)
    except ValueError:
        raw = np.empty(0, object)
    if raw.dtype.kind not in "biuf":
        raise ArgumentError(f"{name} must hold real numbers, {form}, got {value!r}.")
    return raw.astype(float)


def bound(name: str, value: ArrayLike, size: int) -> np.ndarray:
    """A limit for each of m = `size` inputs, a number for all; infinite for none."""
    array = as_floats(name, value, f"one or (m,) = ({size},)")
    whole = np.full(size, array) if array.ndim == 0 else array
    if np.isnan(whole).any():
        raise ArgumentError(f"{name} must not be NaN, got {whole.tolist()}.")
    return shaped(name, whole, (size,), "(m,)")


def read_only(array: np.ndarray) -> np.ndarray:
    """A contiguous view that cannot be written through: one type for the compiled functions."""
    view = np.ascontiguousarray(array).view()
    view.flags.writeable = False
    return view


def _hint(raw: np.ndarray, ndim: int) -> str:
    """What to do about an array that lacks exactly one axis."""
    if raw.ndim == 2 and ndim == 3:
        return ": stack one matrix per mode ([M] for a single mode, [[[0], [1]], …] for columns)"
    if raw.ndim == 3 and ndim == 2:
        return ": give one matrix, not one per mode"
    return ""


def shaped(name: str, array: np.ndarray, shape: tuple[int, ...], form: str) -> np.ndarray:
    """The same array, when its shape is the expected one."""
    if array.shape != shape:
        hint = ""
        if array.ndim >= 2 and array.shape[:-2] + array.shape[:-3:-1] == shape:
            hint = ": pass the transpose"
        raise ArgumentError(f"{name} must have shape {form} = {shape}, got {array.shape}{hint}.")
    return array
