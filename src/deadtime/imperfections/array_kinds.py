"""Which imperfections arrays say all of; the others are functions, to be called once a sample."""

from __future__ import annotations

from deadtime.imperfections.base import (
    ActuatorImperfection,
    Disturbance,
    Imperfection,
    Limiting,
    SensorImperfection,
    TimingImperfection,
)
from deadtime.imperfections.received import Relaying


def is_known(each: Imperfection) -> bool:
    """Whether a compiled loop can take all that it does: each part that it plays counts.

    A sensor or an actuator that is written anew in a subclass is a function again.

    Examples
    --------
    >>> from deadtime.imperfections import Noise
    >>> class Squared(Noise):
    ...     def sensor(self, sizes, rng):
    ...         return lambda seen: seen._replace(x=seen.x**2)
    >>> is_known(Noise(0.1)), is_known(Squared(0.1))
    (True, False)
    """
    if isinstance(each, SensorImperfection) and not (
        isinstance(each, Relaying) and type(each).sensor is Relaying.sensor
    ):
        return False
    return not isinstance(each, ActuatorImperfection) or (
        isinstance(each, Limiting) and type(each).actuator is Limiting.actuator
    )


def is_batched(each: Imperfection) -> bool:
    """Whether the engine of many scenarios can take all that it does."""
    if isinstance(each, Disturbance) and each.goes_by_mode:
        return False  # within a period that is cut it is no one force
    drawing = (Relaying, TimingImperfection, Disturbance)
    # One that draws as two of these shares a stream between them: no array is each part's alone.
    return is_known(each) and sum(isinstance(each, part) for part in drawing) <= 1
