"""Checks of the arguments and the cost of a computation with one mode held.

The work grows with the square of W, the number of periods in the delay. A delay in milliseconds
taken for one in seconds has a thousand times as many periods, and a million times the work.
"""

from __future__ import annotations

import math
from typing import Literal

from deadtime.base.checks import index
from deadtime.base.errors import ArgumentError
from deadtime.feedback import Law
from deadtime.feedback.law import require_match
from deadtime.plant import SwitchedSystem


def require_constant(plant: SwitchedSystem, law: Law) -> None:
    """Refuse a plant and a law that do not make a loop with one mode held."""
    require_match(plant, law)
    if law.previewed is not None and law.previewed.switches:
        raise ArgumentError(
            "law must not assume a signal of its own that switches, when one mode is "
            "held: build the ExactPredictor without one."
        )


def check_mode(plant: SwitchedSystem, law: Law, mode: object) -> int:
    require_constant(plant, law)
    return index("mode", mode, plant.modes)


MOST = 10.0  # seconds, of a margin
_SEARCH = 600.0  # seconds, of a design
_FEW = 500.0  # inputs in flight, W m, up to which nothing takes long
# Seconds per mode and (W m)², measured on one core of a desktop with W from 500 to 5,000.
_UNIT = {"growth rate": 1.3e-7, "delay margin": 1.5e-7, "gain margin": 1.7e-6, "design": 1e-6}
Asked = Literal["growth rate", "delay margin", "gain margin", "design"]


def seconds_of(
    asked: Asked, plant: SwitchedSystem, law: Law, step: float | None, trials: int = 1
) -> float:
    """The estimated seconds of a computation, or of `trials` of them; 0 up to 500 inputs in flight.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[-0.5]]], [[[1.0]]], delay=250.0)
    >>> law = dt.SingleModePredictor(plant, [[[0.1]]], 0)
    >>> [round(seconds_of("delay margin", plant, law, step)) for step in (0.01, 1.0)]
    [94, 0]
    """
    values = 0.0 if step is None else _longest(plant, law) / step * plant.inputs
    return _UNIT[asked] * plant.modes * trials * values * values if values > _FEW else 0.0


def why_left_out(asked: Asked, plant: SwitchedSystem, law: Law, step: float | None) -> str:
    """The reason to leave a computation out, and what to do; empty if it takes seconds at most.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[-0.5]]], [[[1.0]]], delay=250.0)
    >>> law = dt.SingleModePredictor(plant, [[[0.1]]], 0)
    >>> print(why_left_out("delay margin", plant, law, 0.01))
    the delay margin was left out: the delay of 250 s holds D/h = 25,000 periods of 0.01 s, with \
which it takes about 2 min; check their units, or give a longer step, 0.04 s
    """
    why = _too_long(asked, plant, law, step)
    return why and f"the {asked} was left out: {why}"


def require_affordable(
    asked: Asked, plant: SwitchedSystem, law: Law, step: float | None, trials: int = 1
) -> None:
    """Refuse a computation that would take long.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[-0.5]]], [[[1.0]]], delay=250.0)
    >>> law = dt.SingleModePredictor(plant, [[[0.1]]], 0)
    >>> require_affordable("delay margin", plant, law, 0.01)
    Traceback (most recent call last):
    deadtime.ArgumentError: step must be longer for a delay margin, got 0.01 s: the delay \
of 250 s holds D/h = 25,000 periods of 0.01 s, with which it takes about 2 min; check their units, \
or give a longer step, 0.04 s.
    """
    why = _too_long(asked, plant, law, step, trials)
    if why:
        raise ArgumentError(f"step must be longer for a {asked}, got {step:g} s: {why}.")


def _too_long(
    asked: Asked, plant: SwitchedSystem, law: Law, step: float | None, trials: int = 1
) -> str:
    """Why a computation takes long, and the step that avoids it; empty if it does not."""
    seconds = seconds_of(asked, plant, law, step, trials)
    most = _SEARCH if asked == "design" else MOST
    if step is None or seconds <= most:
        return ""
    delay = _longest(plant, law)
    least = delay * plant.inputs * math.sqrt(_UNIT[asked] * plant.modes * trials / most)
    periods = delay / step
    count = f"{periods:,.0f}" if periods < 1e9 else f"{periods:.3g}"
    return (
        f"the delay of {delay:g} s holds D/h = {count} periods of {step:g} s, with "
        f"which it takes about {_time(seconds)}; check their units, or give a longer step, "
        f"{_round_up(least):g} s"
    )


def _longest(plant: SwitchedSystem, law: Law) -> float:
    return max(plant.longest_delay, law.plant.longest_delay)


def _time(seconds: float) -> str:
    if seconds < 7200.0:
        return f"{seconds:.0f} s" if seconds < 60.0 else f"{math.ceil(seconds / 60.0)} min"
    return f"{seconds / 3600.0:,.0f} h"


def _round_up(value: float) -> float:
    """To one digit."""
    unit = 10.0 ** math.floor(math.log10(value))
    return round(math.ceil(value / unit - 1e-9) * unit, 12)
