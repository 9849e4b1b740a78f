"""Arguments of a controller: limits, periods by the clock, and where its plant rests."""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import as_floats, bound, count, instance, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.feedback import Law
from deadtime.plant import OperatingPoint

_MOST = 100_000  # periods between two calls; a later time is out of order


class Status(enum.IntEnum):
    """The outcome of a controller's last `update`."""

    OK = 0
    SATURATED = 1  # the command exceeds the limits
    BAD_STATE = 2  # x is not finite: the last input is held; y: the observer predicts
    BAD_MODE = 3  # the mode is not one of the plant's: the last input is held
    BAD_APPLIED = 4  # the applied input is not finite: the last input is held
    OVERFLOW = 5  # the command is not finite: the last input is held
    BAD_REFERENCE = 6  # the reference is not finite: the last one is kept
    LATE = 7  # periods passed without a call: their input counts as held, or as `applied`
    OUT_OF_ORDER = 8  # the period of `time` has had its call: nothing is done


class Clock:
    """Counts the periods between calls by their times.

    A call belongs to the period nearest to its time: t_k + j with |j| < h/2 is sample k.

    Attributes
    ----------
    state : (2,)
        The time of sample 0 (NaN before the first call with a time), and the last sample.
    """

    def __init__(self, step: float) -> None:
        self._step = step
        self.state = np.array([math.nan, -1.0])

    def reset(self) -> None:
        """Start at the next call."""
        self.state[:] = math.nan, -1.0

    def periods(self, time: Any) -> int:
        """How many periods have begun since the last call; 0: none, the call is out of order."""
        if time is None:
            self.state[1] += 1.0
            return 1
        try:
            now = float(time)
        except (TypeError, ValueError):
            raise ArgumentError(f"time must be a number, in seconds, got {time!r}.") from None
        origin, last = self.state.tolist()
        if not math.isfinite(now):
            return 0
        if math.isnan(origin):
            # Earlier calls had no time: they are assumed to have come on time.
            self.state[0] = now - (last + 1.0) * self._step
            self.state[1] += 1.0
            return 1
        ahead = (now - origin) / self._step - last
        if not 0.5 <= ahead <= _MOST:
            return 0
        periods = math.floor(ahead + 0.5)
        self.state[1] += periods
        return periods


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
    """Refuse a state that cannot be one of the controller whose state is `own`."""
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
        # NaN is the clock before its first time, and a measurement that was missing.
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


class RestValues(NamedTuple):
    """The operating point in the arguments of a call: a law works on deviations from it."""

    given: Float[np.ndarray, " measured"]  # x₀, or y₀ = C x₀
    u: Float[np.ndarray, " m"]
    reference: Float[np.ndarray, " r"]  # H y₀
    z: Float[np.ndarray, " law"]  # the vector that the law's rows multiply

    @classmethod
    def of(
        cls,
        law: Law,
        size: int,
        tracked: Float[np.ndarray, "r p"] | None,
        point: OperatingPoint | None,
    ) -> RestValues:
        """Of a law whose rows multiply `size` numbers beside past inputs; 0 without a point.

        tracked : H, of the outputs that follow a reference; None of a law without an observer
        """
        n, m = law.plant.states, law.plant.inputs
        if point is None:
            point = OperatingPoint(np.zeros(n), np.zeros(m))
        instance("operating_point", point, OperatingPoint)
        x = require_shape("operating_point.x", point.x, (n,), "(n,)")
        u = require_shape("operating_point.u", point.u, (m,), "(m,)")
        given, reference = x, np.zeros(0)
        if law.outputs is not None:
            each = law.outputs[:, :, :n] @ x
            if not np.allclose(each, each[0], rtol=1e-9, atol=0.0):
                raise ArgumentError(
                    "operating_point must have the same outputs in every mode, got "
                    f"{each.tolist()}: where the sensors differ by mode, give the controller "
                    "deviations, and no operating point."
                )
            given = each[0]
        if tracked is not None:
            reference = tracked @ given
        between = np.zeros(size - n - reference.size)  # estimated disturbances, sums of errors
        return cls(given, u, reference, np.concatenate((x, between, reference)))
