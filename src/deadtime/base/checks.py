"""Validation at the edge: each function returns a clean value or raises ArgumentError."""

from __future__ import annotations

import math
from collections.abc import Callable
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from deadtime.base.errors import ArgumentError

_FILL = "fill them (.filled) or leave them out (.compressed)"
_REMEDIES = {  # by the kind of a NumPy type
    "c": " Pass its .real if the imaginary part is round-off.",
    "U": " Convert text with float.",
}
_LONGEST = 200  # characters of a value in a message


def number(name: str, value: object) -> float:
    """A finite real number."""
    if isinstance(value, (str, bytes)):  # float would convert some of them
        raise ArgumentError(
            f"{name} must be a number, got {brief(value)}, a {type(value).__name__}: pass it "
            "without quotes, or convert it with float."
        )
    if isinstance(value, np.ndarray):  # float would convert arrays of one entry, and masked ones
        if np.ma.is_masked(value):
            raise ArgumentError(f"{name} must be a number, got a masked one: {_FILL}.")
        if value.ndim:
            raise ArgumentError(f"{name} must be one number, got an array of shape {value.shape}.")
    if isinstance(value, (complex, np.complexfloating)):
        raise ArgumentError(f"{name} must be a real number, got {brief(value)}.{_REMEDIES['c']}")
    try:
        result = float(value)  # pyright: ignore[reportArgumentType]
    except OverflowError:
        raise ArgumentError(f"{name} must be below 1.8e308 in size, got {brief(value)}.") from None
    except (TypeError, ValueError):
        raise ArgumentError(
            f"{name} must be a number, got {brief(value)}, a {type(value).__name__}."
        ) from None
    if not math.isfinite(result):
        raise ArgumentError(f"{name} must be finite, got {_as_given(value, result)}.")
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
        raise ArgumentError(f"{name} must be an integer in 0..{count - 1}, got {brief(value)}.")
    if not 0 <= value < count:
        counted = f"{name}s" if name in ("input", "channel", "output") else "modes"
        raise ArgumentError(
            f"{name} must be in 0..{count - 1}, got {brief(value)}: {counted} count from 0."
        )
    return int(value)


def instance(name: str, value: object, kind: type) -> None:
    """Refuse a value that is no instance of a class."""
    if not isinstance(value, kind):
        raise ArgumentError(f"{name} must be a {kind.__name__}, got {type(value).__name__}.")


def reporter(name: str, value: Callable[[str], None] | None) -> Callable[[str], None]:
    """A function that takes messages about progress; for None, one that ignores them."""
    if value is None:
        return lambda _: None
    if not callable(value):
        raise ArgumentError(
            f"{name} must be a function that takes a few words, got {value!r}: leave it out for "
            "no messages."
        )
    return value


def count(name: str, value: object, least: int = 1) -> int:
    """An integer of at least `least`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise ArgumentError(f"{name} must be an integer of at least {least}, got {brief(value)}.")
    return int(value)


def real_array(name: str, value: ArrayLike, form: str, ndim: int) -> np.ndarray:
    """A read-only, C-contiguous float64 array with `ndim` axes and finite entries.

    `form` is how the message writes the expected shape, such as ``(modes, n, n)``.
    """
    raw = _raw_array(name, value, "hold real numbers", f"have shape {form}")
    if raw.ndim != ndim:
        raise ArgumentError(
            f"{name} must have shape {form}, got {raw.shape}{_hint(raw, ndim, form)}."
        )
    if raw.size == 0:
        raise ArgumentError(f"{name} must have shape {form}, got the empty shape {raw.shape}.")
    result = _floats(raw)
    bad = np.argwhere(~np.isfinite(result))
    if bad.size:
        where, place = ", ".join(map(str, bad[0])), tuple(bad[0])
        given = _as_given(raw[place], float(result[place]))
        raise ArgumentError(f"{name}[{where}] must be finite, got {given}.")
    result.flags.writeable = False
    return result


def as_floats(name: str, value: ArrayLike, form: str) -> np.ndarray:
    """An array of floats of any shape; NaN and infinity pass."""
    wanted = f"hold real numbers, {form}"
    return _floats(_raw_array(name, value, wanted, wanted))


def _raw_array(name: str, value: object, reals: str, shape: str) -> np.ndarray:
    """`value` as an array of real numbers; messages say that it must `reals` and `shape`."""
    require_unmasked(name, value)
    try:
        raw = np.asarray(value)
        if raw.dtype.kind == "O" and raw.size and all(isinstance(x, Real) for x in raw.flat):
            raw = raw.astype(np.float64)  # such as integers beyond 64 bits
    except OverflowError:
        raise ArgumentError(
            f"{name} must {reals}, got an entry of 1.8e308 or more, which floats do not hold."
        ) from None
    except ValueError:
        raise ArgumentError(
            f"{name} must {shape}, got rows of different lengths: "
            "give every row, and every matrix, as many numbers as the others."
        ) from None
    if raw.dtype.kind not in "biuf":
        remedy = _REMEDIES.get(raw.dtype.kind, "")
        raise ArgumentError(f"{name} must {reals}, got an array of {raw.dtype}.{remedy}")
    return raw


def require_unmasked(name: str, value: Any) -> Any:
    """A value without masked entries, whose mask `numpy.asarray` would ignore."""
    if _is_masked(value):
        raise ArgumentError(f"{name} must be whole, got masked entries: {_FILL}.")
    return value


def _floats(raw: np.ndarray) -> np.ndarray:
    """A C-contiguous copy in double precision; infinite where that does not hold a number."""
    with np.errstate(over="ignore"):
        return np.array(raw, dtype=np.float64, order="C")


def _is_masked(value: object) -> bool:
    """Whether entries are masked, also in lists of arrays."""
    if isinstance(value, (list, tuple)):
        return any(map(_is_masked, value))
    return isinstance(value, np.ma.MaskedArray) and bool(np.ma.is_masked(value))


def _as_given(value: object, result: float) -> str:
    """The text of a number that is not finite as a float: a longdouble may be larger."""
    beyond = isinstance(value, np.floating) and np.isfinite(value) and not math.isfinite(result)
    return f"{value!s}, which is beyond 1.8e308" if beyond else str(result)


def brief(value: object) -> str:
    """A value as messages print it: one line of at most 200 characters."""
    try:
        text = repr(value)
    except ValueError:  # Python refuses to print integers of more than some 4300 digits
        return "an integer of thousands of digits"
    text = " ".join(text.split())
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"


def bound(name: str, value: ArrayLike, size: int) -> np.ndarray:
    """A limit for each of m = `size` inputs, a number for all; infinite for none."""
    array = as_floats(name, value, f"one or (m,) = ({size},)")
    whole = np.full(size, array) if array.ndim == 0 else array
    return require_shape(name, not_nan(name, whole), (size,), "(m,)")


def not_nan(name: str, array: np.ndarray) -> np.ndarray:
    """An array without NaN."""
    if np.isnan(array).any():
        raise ArgumentError(f"{name} must not be NaN, got {array.tolist()}.")
    return array


def share(name: str, value: object) -> float:
    """A number above 0 and below 1."""
    part = number(name, value)
    if not 0.0 < part < 1.0:
        raise ArgumentError(f"{name} must be above 0 and below 1, got {part:g}.")
    return part


def require_probabilities(name: str, values: np.ndarray) -> None:
    """Refuse numbers that are negative, or whose sum is not 1."""
    total = float(values.sum())
    if values.min() < 0.0 or abs(total - 1.0) > 1e-9:
        raise ArgumentError(
            f"{name} must be probabilities, ≥ 0 with sum 1, got {values.tolist()} with sum "
            f"{total:.10g}: if none is negative, divide them by their sum."
        )


def read_only(array: np.ndarray) -> np.ndarray:
    """A contiguous view that cannot be written through."""
    # Numba compiles a function for writable and read-only arrays separately: all get the latter.
    view = np.ascontiguousarray(array).view()
    view.flags.writeable = False
    return view


def _hint(raw: np.ndarray, ndim: int, form: str) -> str:
    """Advice about an array that lacks axes, or has one too many."""
    if raw.ndim in (1, 2) and ndim == 3:
        example = "[[[1, 2]], …] for rows" if "m, n" in form else "[[[0], [1]], …] for columns"
        return f": stack one matrix per mode ([M] for a single mode, {example})"
    if raw.ndim == 3 and ndim == 2:
        return ": give one matrix, not one per mode"
    return ""


def require_shape(name: str, array: np.ndarray, shape: tuple[int, ...], form: str) -> np.ndarray:
    """An array of the expected shape."""
    if array.shape != shape:
        hint = ""
        if array.ndim >= 2 and array.shape[:-2] + array.shape[:-3:-1] == shape:
            hint = ": pass the transpose"
        raise ArgumentError(f"{name} must have shape {form} = {shape}, got {array.shape}{hint}.")
    return array


def require_semidefinite(
    name: str, matrix: np.ndarray, tolerance: float = 1e-9, strict: bool = False
) -> np.ndarray:
    """A symmetric matrix, positive semidefinite or definite if `strict`; others are refused.

    The tolerance is that of `correlations`, so that units do not decide what counts as round-off.
    Only rows that are 0 up to the round-off of the largest entry, as of a computed CᵀQC, become 0.
    """
    kind = "positive definite" if strict else "positive semidefinite"
    floor = 0.0 if strict else 4.0 * len(matrix) * np.finfo(float).eps * np.abs(matrix).max()
    diagonal = np.diagonal(matrix)
    least = diagonal.min()
    if least < -floor or (strict and least == 0.0):
        raise ArgumentError(f"{name} must be {kind}, got {least:.4g} on its diagonal.")
    # Round-off of this size in a 0 on the diagonal hides the square of an entry beside it.
    unit = np.sqrt(np.where(diagonal > 0.0, diagonal, floor))
    within, beside = np.outer(unit, unit), np.minimum.outer(diagonal, diagonal) <= 0.0
    if (np.abs(matrix - matrix.T) > np.where(beside, 1.0, tolerance) * within).any():
        raise ArgumentError(f"{name} must be symmetric: pass (M + M.T) / 2.")
    if (np.abs(matrix) > within)[beside].any():
        raise ArgumentError(
            f"{name} must be {kind}, got an entry other than 0 beside a 0 on its diagonal."
        )
    matrix = np.where(beside, 0.0, (matrix + matrix.T) / 2.0)
    least = np.linalg.eigvalsh(correlations(matrix))[0]
    if least < -tolerance * len(matrix):
        noise = np.abs(matrix).max(axis=1) <= floor
        matrix = np.where(np.logical_or.outer(noise, noise), 0.0, matrix)
        least = np.linalg.eigvalsh(correlations(matrix))[0]
    if least < -tolerance * len(matrix) or (strict and least <= 0.0):
        raise ArgumentError(
            f"{name} must be {kind}, got an eigenvalue {least:.4g} when scaled to a unit diagonal."
        )
    return matrix


def correlations(covariance: np.ndarray) -> np.ndarray:
    """A covariance scaled to a unit diagonal; rows with a variance of 0 stay 0."""
    unit = np.sqrt(np.diagonal(covariance))
    back = np.divide(1.0, unit, out=np.zeros_like(unit), where=unit > 0.0)
    return 0.5 * (covariance + covariance.T) * back[:, None] * back


def python_control(what: str) -> Any:
    """python-control; `what` needs it, in the plural."""
    try:
        import control
    except ModuleNotFoundError:
        raise ArgumentError(
            f"{what} need python-control, and it is not installed: "
            'pip install ".[control]" in a clone of deadtime.'
        ) from None
    return control
