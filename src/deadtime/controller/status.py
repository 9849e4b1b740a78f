"""What becomes of a period, and which period a call belongs to."""

from __future__ import annotations

import enum
import math

import numpy as np

from deadtime.base.errors import ArgumentError

_MOST = 100_000  # periods that a call may be ahead of the last one


class Status(enum.IntEnum):
    """What became of a controller's last `update`."""

    OK = 0
    SATURATED = 1  # the law asked for more than the limits allow
    BAD_STATE = 2  # x is not finite: the last input is held; y: nothing is corrected
    BAD_MODE = 3  # the mode is none of the plant's: the last input is held
    BAD_APPLIED = 4  # the applied input is not finite: the last input is held
    OVERFLOW = 5  # the law's answer is not finite: the last input is held
    BAD_REFERENCE = 6  # the reference is not finite: the last one goes on
    LATE = 7  # whole periods went by without a call: their input counts as held
    OUT_OF_ORDER = 8  # the period of this call has been served: nothing is done


class Clock:
    """Counts the periods between calls, by the time of day that they bring with them.

    A call belongs to the period nearest to its time: t_k + j with |j| < h/2 is sample k.

    Attributes
    ----------
    state : (2,)
        The time of sample 0 (NaN before a call brought a time), and the last sample served.
    """

    def __init__(self, step: float) -> None:
        self._step = step
        self.state = np.array([math.nan, -1.0])

    def reset(self) -> None:
        """Begin anew at the next call."""
        self.state[:] = math.nan, -1.0

    def periods(self, time: float | None) -> int:
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
            # As if the calls without a time had come on time.
            self.state[0] = now - (last + 1.0) * self._step
            self.state[1] += 1.0
            return 1
        ahead = (now - origin) / self._step - last
        if not 0.5 <= ahead <= _MOST:
            return 0
        periods = math.floor(ahead + 0.5)
        self.state[1] += periods
        return periods
