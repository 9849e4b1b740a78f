"""From which age on a mode may be left, and when in the period: sojourns as full steps.

`transitions` says what a full step is, and where these numbers come from.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

from deadtime.switching.signal_class import Instants

READINGS = Fraction(1, 2**50)  # of a ratio of two numbers: decimals, and binary64, and between


def decimal(value: float) -> Fraction:
    """The decimal that prints as a number."""
    return Fraction(repr(float(value)))


def least_periods(dwell_time: float, step: float, tolerance: float) -> Fraction:
    """r: how many periods a dwell time has by the controller's clock, at the least."""
    part = (1 - decimal(tolerance)) * (1 - READINGS)
    return part * decimal(dwell_time) / decimal(step)


def most_periods(maximum_dwell: float, step: float, tolerance: float) -> Fraction:
    """R: how many periods a longest sojourn has by the controller's clock, at the most."""
    part = (1 + decimal(tolerance)) * (1 + READINGS)
    return part * decimal(maximum_dwell) / decimal(step)


def shortest(dwell_time: float, step: float, tolerance: float) -> tuple[int, float]:
    """(the fewest full steps of a sojourn, the earliest s'/h there), rounded down.

    −1 full steps: one period may hold two switches.

    Examples
    --------
    >>> shortest(0.2, 0.1, 1e-5), shortest(0.25, 0.1, 1e-5)
    ((0, 0.9999799999999981), (1, 0.4999749999999977))
    """
    periods = least_periods(dwell_time, step, tolerance)
    whole = math.floor(periods)
    return whole - 1, max(0.0, math.nextafter(float(periods - whole), 0.0))


def longest(maximum_dwell: float, step: float, tolerance: float) -> tuple[int, float]:
    """(the most full steps of a sojourn with a longest one, the latest s'/h there), rounded up."""
    periods = most_periods(maximum_dwell, step, tolerance)
    most = math.ceil(periods) - 1
    return most, min(1.0, math.nextafter(float(periods - most), 1.0))


def whole_steps(
    dwell_time: float, maximum_dwell: float, step: float, tolerance: float
) -> tuple[int, float]:
    """The fewest full steps of a sojourn that begins and ends at a sample, and the most.

    Examples
    --------
    >>> whole_steps(0.2, 0.35, 0.1, 1e-5), whole_steps(0.03, math.inf, 0.1, 1e-5)
    ((1, 2), (0, inf))
    """
    first = max(0, math.ceil(least_periods(dwell_time, step, tolerance)) - 1)
    if math.isinf(maximum_dwell):
        return first, math.inf
    return first, math.floor(most_periods(maximum_dwell, step, tolerance)) - 1


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
        tolerance: float,
        told: int,
        at: Instants = "anywhere",
    ) -> LeavingAges:
        """Of a dwell time and a maximum; `told` is the last age at which rows may change."""
        if at == "samples":  # at the end of a period, whatever the age
            first, most = whole_steps(dwell_time, maximum_dwell, step, tolerance)
            last = max(first, told) if math.isinf(most) else int(most)
            return cls(first, last, math.isfinite(most), 1.0)
        first, earliest = shortest(dwell_time, step, tolerance)
        if math.isfinite(maximum_dwell):
            last, latest = longest(maximum_dwell, step, tolerance)
            return cls(first, last, True, earliest, latest)
        # The last age stands for all later ones, at which a mode may be left at any instant.
        return cls(first, max(first + 1, told), False, earliest)
