"""Bounds that no state leaves: declared in the C, re-established by each of its steps."""

from __future__ import annotations

import numpy as np

from deadtime.base.errors import ArgumentError
from deadtime.controller.export.forms import Form, Precision
from deadtime.feedback import Feedback

_LARGEST = {"double": float(np.finfo(np.float64).max), "float": float(np.finfo(np.float32).max)}
_WANTED = {"double": 2.0**332, "float": 2.0**40}  # 9e99, 1e12
_LEAST = 1e6


def largest(precision: Precision) -> float:
    """The largest finite number."""
    return _LARGEST[precision]


def bounds(
    table: Feedback, form: Form, precision: Precision, rows: int = 1, more: float = 1.0
) -> dict[str, float]:
    """Of every number that comes in or goes out, and of the sums over past inputs.

    `rows` is how many rows of the table are added up, and `more` by how much what runs beside the
    table may multiply a number.

    Sums within their bounds never overflow on the way; the bounds of sums are at least twice what
    inputs within theirs can reach. All are powers of two, which C and its contracts read alike.
    """
    if form.kind != "factorised":
        gains = _most(table.state_gain) * table.state_gain.shape[2]
        for array, _ in form.arrays.values():
            gains = max(gains, 1.0) * max(_most(array) * array.shape[-1], 1.0)
        return {"bound": _bound(max(gains * rows, more), precision)}
    S, gamma, whole, H, last = (array for array, _ in form.arrays.values())
    order, m = gamma.shape
    reach, column, power = np.zeros(order), gamma, H
    columns, powers = _most(gamma), _most(H)
    for _ in range(form.sizes["block"]):
        reach += np.abs(column).sum(axis=1)
        columns, powers = max(columns, _most(column)), max(powers, _most(power))
        column, power = S @ column, power @ S
    columns, powers, sums = (_up(value) for value in (columns, powers, 2.0 * float(reach.max())))
    step = order * _most(S) + m * (columns * 2.0 + _most(gamma)) / sums
    answer = order * (2.0 * powers * (1.0 + order * _most(whole)) + _most(H))
    terms = table.state_gain.shape[2] * _most(table.state_gain) + m * _most(last)
    worst = max(sums * max(step, 1.0, answer) + terms, 1.0)
    bound = _bound(max(worst * rows, more), precision)
    return {
        "bound": bound,
        "sum_bound": sums * bound,
        "column_bound": 2.0 * columns,
        "power_bound": 2.0 * powers,
    }


def _most(array: np.ndarray) -> float:
    return float(np.abs(array).max())


def _up(value: float) -> float:
    """The next power of two; not below what a float holds with ease."""
    return float(2.0 ** np.ceil(np.log2(max(value, 1e-20))))


def _bound(gain: float, precision: Precision) -> float:
    """The power of two within which a gain of so much cannot overflow."""
    room = np.floor(np.log2(_LARGEST[precision]) - np.log2(gain)) - 4.0
    bound = min(_WANTED[precision], float(2.0**room)) if np.isfinite(room) else 0.0
    if bound < _LEAST:
        raise ArgumentError(
            f'precision = "{precision}" cannot hold this law: its sums reach {gain:.0e} times an '
            "input; the delay is too long for this plant."
            + (' Use precision="double".' if precision == "float" else "")
        )
    return bound
