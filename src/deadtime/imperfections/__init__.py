"""What plants, sensors and actuators do to a law.

A run takes a list of imperfections (`simulate(..., imperfections=[...], seed=0)`): disturbances
that act on the plant, and, in the order of the list, what the sensors do to what the law is told
of x(t_k) and σ(t_k), and the actuators to what it asks for. The plant stays exact between samples.
Each draws from a stream of its own, made from the seed, its kind and how many of its kind come
before: adding one changes nothing that the others draw.
"""

from deadtime.imperfections.actuators import RateLimit, Saturation
from deadtime.imperfections.base import (
    ActuatorImperfection,
    Additive,
    Disturbance,
    Imperfection,
    Limiting,
    Limits,
    Seen,
    SensorImperfection,
    Sizes,
    TimingImperfection,
    require,
    streams,
)
from deadtime.imperfections.disturbances import (
    ColouredDisturbance,
    StepDisturbance,
    WhiteDisturbance,
)
from deadtime.imperfections.sensors import Dropout, LateSamples, ModeDelay, Noise, WrongMode
from deadtime.imperfections.timing import Jitter, MeasurementDelay

__all__ = [
    "ActuatorImperfection",
    "Additive",
    "ColouredDisturbance",
    "Disturbance",
    "Dropout",
    "Imperfection",
    "Jitter",
    "LateSamples",
    "Limiting",
    "Limits",
    "MeasurementDelay",
    "ModeDelay",
    "Noise",
    "RateLimit",
    "Saturation",
    "Seen",
    "SensorImperfection",
    "Sizes",
    "StepDisturbance",
    "TimingImperfection",
    "WhiteDisturbance",
    "WrongMode",
    "require",
    "streams",
]
