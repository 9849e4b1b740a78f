"""What a growth rate or a margin costs to compute, before it is computed.

The work grows with the square of W, the periods that a delay holds. A delay in milliseconds taken
for one in seconds has a thousand times as many, and a million times the work.
"""

from __future__ import annotations

import math
from typing import Literal

from deadtime.laws.base import Law
from deadtime.plant import SwitchedSystem

MOST = 10.0  # seconds
_FEW = 500.0  # inputs in flight, W m: up to there nothing takes long
# Seconds per mode and (W m)², measured on one core of a desktop with W from 500 to 5,000.
_UNIT = {"growth rate": 1.3e-7, "delay margin": 1.5e-7, "gain margin": 1.7e-6}
Asked = Literal["growth rate", "delay margin", "gain margin"]


def seconds_of(asked: Asked, plant: SwitchedSystem, law: Law, step: float | None) -> float:
    """About how long an answer takes; 0 where that is no question.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[-0.5]]], [[[1.0]]], delay=250.0)
    >>> law = dt.SingleModePredictor(plant, [[[0.1]]], 0)
    >>> [round(seconds_of("delay margin", plant, law, step)) for step in (0.01, 1.0)]
    [94, 0]
    """
    values = 0.0 if step is None else _longest(plant, law) / step * plant.inputs
    return _UNIT[asked] * plant.modes * values**2 if values > _FEW else 0.0


def left_out(asked: Asked, plant: SwitchedSystem, law: Law, step: float | None) -> str:
    """Why an answer is left out, and what to do; empty where it takes seconds at most.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[-0.5]]], [[[1.0]]], delay=250.0)
    >>> law = dt.SingleModePredictor(plant, [[[0.1]]], 0)
    >>> print(left_out("delay margin", plant, law, 0.01))
    the delay margin was left out: the delay of 250 s holds D/h = 25,000 periods of 0.01 s, with \
which it takes about 2 min; check their units, or give a longer step, 0.04 s
    """
    seconds = seconds_of(asked, plant, law, step)
    if step is None or seconds <= MOST:
        return ""
    delay = _longest(plant, law)
    return (
        f"the {asked} was left out: the delay of {delay:g} s holds D/h = {delay / step:,.0f} "
        f"periods of {step:g} s, with which it takes about {_time(seconds)}; check their units, "
        f"or give a longer step, {_rounded_up(step * math.sqrt(seconds / MOST)):g} s"
    )


def _longest(plant: SwitchedSystem, law: Law) -> float:
    return max(plant.delay, law.plant.delay)


def _time(seconds: float) -> str:
    if seconds < 7200.0:
        return f"{seconds:.0f} s" if seconds < 60.0 else f"{math.ceil(seconds / 60.0)} min"
    return f"{seconds / 3600.0:,.0f} h"


def _rounded_up(value: float) -> float:
    """To one digit."""
    unit = 10.0 ** math.floor(math.log10(value))
    return round(math.ceil(value / unit - 1e-9) * unit, 12)
