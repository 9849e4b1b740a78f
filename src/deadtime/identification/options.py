"""What `identify` is given beside the log, checked."""

from __future__ import annotations

import numpy as np

from deadtime.base.checks import number
from deadtime.base.errors import ArgumentError


def require_switches(switches: object) -> None:
    """Refuse what is none of the values that there are."""
    if switches not in ("anywhere", "samples"):
        raise ArgumentError(f'switches must be "anywhere" or "samples", got {switches!r}.')


def choice(name: str, value: object) -> bool | None:
    """True, False, or None, which leaves it to the log."""
    if value is None:
        return None
    if isinstance(value, bool | np.bool_):
        return bool(value)
    raise ArgumentError(
        f"{name} must be True, False, or None to find out from the log, got {value!r}."
    )


def range_of_delays(delay: object) -> tuple[float, float]:
    """The range of delays."""
    try:
        low, high = delay  # pyright: ignore[reportGeneralTypeIssues]
    except (TypeError, ValueError):
        raise ArgumentError(
            f"delay must be the range (low, high) to look in, in seconds, got {delay!r}."
        ) from None
    low, high = number("delay[0]", low), number("delay[1]", high)
    if not 0.0 <= low < high:
        raise ArgumentError(
            f"delay must be a range 0 ≤ low < high, in seconds, got ({low:g}, {high:g})."
        )
    return low, high


def require_order_for(zeros: object, outputs: object, C: object) -> None:
    """Refuse what only outputs alone have."""
    if zeros is not None:
        raise ArgumentError("zeros is of outputs alone: give order, too, or leave zeros out.")
    if outputs is not None and C is None:
        raise ArgumentError(
            "outputs needs order, how many states each has, or C, what they are of the states; "
            "columns that are the states are states=[…]."
        )
