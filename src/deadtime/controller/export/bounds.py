"""Bounds of the exported state, and refused exports: no C, no such name, no bounds.

The C declares bounds of its state, and every update keeps them.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from deadtime.base.errors import ArgumentError
from deadtime.controller.export.belief_code import require_bounded
from deadtime.controller.export.forms import Form, Precision
from deadtime.controller.export.observer_code import require_schedule
from deadtime.feedback import Feedback

if TYPE_CHECKING:
    from deadtime.controller.running import RunningLaw


_LARGEST = {"double": float(np.finfo(np.float64).max), "float": float(np.finfo(np.float32).max)}
_WANTED = {"double": 2.0**332, "float": 2.0**40}  # 9e99, 1e12
_LEAST = 1e6  # in units of an input: a smaller bound would refuse ordinary numbers


def largest(precision: Precision) -> float:
    """The largest finite number."""
    return _LARGEST[precision]


def bounds(
    table: Feedback, form: Form, precision: Precision, rows: int = 1, more: float = 1.0
) -> dict[str, float]:
    """Bounds of all arguments and results, and of the sums over past inputs.

    `rows` is how many rows of the table are added up, `more` the largest gain of an observer or a
    prediction.

    Within these bounds no sum overflows; the bounds of sums are at least twice the largest sum over
    inputs within theirs. All are powers of two, which C and its contracts read alike.
    """
    if form.kind != "factorised":
        gains = _most(table.state_gain) * table.state_gain.shape[2]
        for array, _ in form.arrays.values():
            gains = max(gains, 1.0) * max(_most(array) * array.shape[-1], 1.0)
        return {"bound": _bound(max(gains * rows, more), precision)}
    S, gamma, whole, H, last = (array for array, _ in form.arrays.values())
    order, m = gamma.shape
    reach, column, power = np.zeros(order), gamma, H
    # The largest entries of S^b Γ and H S^b, which the C raises period by period, b < block.
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
    """The next power of two, at least 1e-20, which a float holds."""
    return float(2.0 ** np.ceil(np.log2(max(value, 1e-20))))


def _bound(gain: float, precision: Precision) -> float:
    """The power of two within which this gain cannot overflow."""
    room = np.floor(np.log2(_LARGEST[precision]) - np.log2(gain)) - 4.0
    bound = min(_WANTED[precision], float(2.0**room)) if np.isfinite(room) else 0.0
    if bound < _LEAST:
        raise ArgumentError(
            f'precision = "{precision}" cannot hold this law: its sums reach {gain:.0e} times an '
            "input; the delay is too long for this plant."
            + (' Use precision="double".' if precision == "float" else "")
        )
    return bound


_PRECISIONS = ("double", "float")
# `name.h` must hide no header of the standard library, and `name.c` not be main.c.
_TAKEN = frozenset(
    (
        "main",
        *("assert", "complex", "ctype", "errno", "fenv", "float", "inttypes", "iso646"),
        *("limits", "locale", "math", "setjmp", "signal", "stdalign", "stdarg", "stdatomic"),
        *("stdbool", "stddef", "stdint", "stdio", "stdlib", "stdnoreturn", "string", "tgmath"),
        *("threads", "time", "uchar", "wchar", "wctype"),
    )
)


def require_exportable(controller: RunningLaw, precision: str, name: str) -> None:
    """Refuse a controller, a precision or a name that has no C."""
    if precision not in _PRECISIONS:
        raise ArgumentError(f"precision must be 'double' or 'float', got {precision!r}.")
    if not re.fullmatch("[a-z][a-z0-9_]{0,30}", name):
        raise ArgumentError(
            f"name must be a C name of lower-case letters, digits and _, got {name!r}."
        )
    if name in _TAKEN:
        raise ArgumentError(f"name must not be {name!r}: C, or a file here, has it already.")
    if controller.observing is not None:
        require_schedule(controller.observing)
    if controller.mode_belief is not None:
        if precision == "float":
            raise ArgumentError(
                f"precision must be 'double' of {type(controller.law).__name__}: its filter tells "
                "modes apart by small differences of states, which single precision rounds away."
            )
        require_bounded(controller.mode_belief)


def require_limits(controller: RunningLaw, most: float) -> None:
    """Refuse limits that no input within the bound of the C satisfies."""
    if (controller.low > most).any() or (controller.high < -most).any():
        raise ArgumentError(
            f"limits must leave inputs within {most:.0e}, the bound of the C, got "
            f"{controller.low.tolist()} and {controller.high.tolist()}."
        )
