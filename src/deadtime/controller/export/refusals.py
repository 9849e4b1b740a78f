"""What has no C, or a name that cannot be, is refused."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from deadtime.base.errors import ArgumentError
from deadtime.controller.export.belief_code import require_bounded
from deadtime.controller.export.observer_code import require_schedule

if TYPE_CHECKING:
    from deadtime.controller.running import RunningLaw

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
    """Refuse what has no C."""
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
    if controller.believing is not None:
        if precision == "float":
            raise ArgumentError(
                f"precision must be 'double' of {type(controller.law).__name__}: its filter tells "
                "modes apart by small differences of states, which single precision rounds away."
            )
        require_bounded(controller.believing)


def require_limits(controller: RunningLaw, most: float) -> None:
    """Refuse limits that leave nothing of what the C can count."""
    if (controller.low > most).any() or (controller.high < -most).any():
        raise ArgumentError(
            f"limits must leave inputs within {most:.0e}, the bound of the C, got "
            f"{controller.low.tolist()} and {controller.high.tolist()}."
        )
