"""Arguments of a controller."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import as_floats, bound, count
from deadtime.base.errors import ArgumentError


def limits_of(
    limits: tuple[ArrayLike, ArrayLike] | None, m: int
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    if limits is None:
        return np.full(m, -math.inf), np.full(m, math.inf)
    try:
        low, high = limits
    except (TypeError, ValueError):
        raise ArgumentError(f"limits must be (low, high), got {limits!r}.") from None
    low, high = bound("limits, low", low, m), bound("limits, high", high, m)
    if (low >= high).any():
        raise ArgumentError(f"limits must have low < high, got {low.tolist()} and {high.tolist()}.")
    return low, high


def require_state(state: Any, own: dict[str, Any], modes: int) -> None:
    """Refuse what is no state of the controller whose state is `own`."""
    if not isinstance(state, Mapping):
        raise ArgumentError(f"state must be what `Controller.state` gave, got {state!r}.")
    for name in ("law", "step", "taps"):
        if state.get(name) != own[name]:
            raise ArgumentError(
                f"state must come from a controller of the same {name} = {own[name]}, got "
                f"{state.get(name)}."
            )
    for name, value in own.items():
        if name not in state or np.shape(state[name]) != np.shape(value):
            raise ArgumentError(
                f"state[{name!r}] must have shape {np.shape(value)}: pass what "
                "`Controller.state` gave."
            )
        # A clock that has not begun is NaN, as is a state that was missing.
        if name in ("law", "clock", "belief_x"):
            continue
        if not np.isfinite(as_floats(f"state[{name!r}]", state[name], "finite")).all():
            raise ArgumentError(f"state[{name!r}] must be finite, got {state[name]}.")
    for name in ("mode", "age", "samples", "refused", "late"):
        count(f"state[{name!r}]", state[name], -1 if name == "mode" else 0)
    if state["mode"] >= modes:
        raise ArgumentError(f"state['mode'] must be in -1..{modes - 1}, got {state['mode']}.")


def vector(name: str, value: ArrayLike, size: int) -> np.ndarray:
    """A float vector of the right size; its entries need not be finite."""
    array = as_floats(name, value, f"shape ({size},)")
    if array.shape != (size,):
        raise ArgumentError(f"{name} must have shape ({size},), got {array.shape}.")
    return array
