"""From which age on a mode may be left, and when in the period: sojourns as full steps.

`transitions` says what a full step is, and where these numbers come from.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

from deadtime.switching import SignalClass

READINGS = Fraction(1, 2**50)  # of a ratio of two numbers: decimals, and binary64, and between


def decimal(value: float) -> Fraction:
    """The decimal that prints as a number."""
    return Fraction(repr(float(value)))


def least_periods(dwell_time: float, step: float, tolerance: float) -> Fraction:
    """r: how many periods a dwell time has by the controller's clock, at the least."""
    part = (1 - decimal(tolerance)) * (1 - READINGS)
    return part * decimal(dwell_time) / decimal(step)


@dataclass(frozen=True)
class LeavingAges:
    """When a mode may be left, by its age in samples.

    Attributes
    ----------
    first : int
        The least age from which a step may switch.
    last : int
        The largest age that is told apart.
    ends : bool
        Whether the mode must be left at the age `last` (a maximum dwell time).
    earliest, latest : float
        The first instant of a switch at the age `first`, and the last at `last` where the mode must
        be left then: fractions of the period. An `earliest` of 1: every switch is at the end.
    """

    first: int
    last: int
    ends: bool = False
    earliest: float = 0.0
    latest: float = 1.0

    @classmethod
    def of(
        cls,
        dwell_time: float,
        maximum_dwell: float,
        step: float,
        signals: SignalClass,
        told: int,
    ) -> LeavingAges:
        """Of a mode's dwell time and maximum; `told` is the last age at which rows may change.

        A `first` of −1: one period may hold two switches.

        Examples
        --------
        >>> LeavingAges.of(0.25, math.inf, 0.1, SignalClass(0.25), 0)
        LeavingAges(first=1, last=2, ends=False, earliest=0.4999749999999977, latest=1.0)
        >>> LeavingAges.of(0.2, 0.35, 0.1, SignalClass(0.2, 0.35, at="samples"), 0)
        LeavingAges(first=1, last=2, ends=True, earliest=1.0, latest=1.0)
        """
        tolerance = signals.clock_tolerance
        r, R = least_periods(dwell_time, step, tolerance), None
        if math.isfinite(maximum_dwell):
            R = (1 + decimal(tolerance)) * (1 + READINGS) * decimal(maximum_dwell) / decimal(step)
        if signals.at == "samples":
            first = max(0, math.ceil(r) - 1)
            last = max(first, told) if R is None else math.floor(R) - 1
            return cls(first, last, R is not None, 1.0)
        first = math.floor(r) - 1
        earliest = max(0.0, math.nextafter(float(r - first - 1), 0.0))
        if R is None:
            # The last age stands for all later ones, at which a mode may be left at any instant.
            return cls(first, max(first + 1, told), False, earliest)
        last = math.ceil(R) - 1
        return cls(first, last, True, earliest, min(1.0, math.nextafter(float(R - last), 1.0)))
