from .base import (
    ActuatorImperfection as ActuatorImperfection,
    Disturbance as Disturbance,
    Imperfection as Imperfection,
    Limiting as Limiting,
    Limits as Limits,
    Seen as Seen,
    SensorImperfection as SensorImperfection,
    Sizes as Sizes,
    Stacked as Stacked,
    TimingImperfection as TimingImperfection,
    require as require,
    streams as streams,
)
from .disturbances import (
    ColouredDisturbance as ColouredDisturbance,
    StepDisturbance as StepDisturbance,
    WhiteDisturbance as WhiteDisturbance,
)
from .received import Additive as Additive, ReceivedData as ReceivedData, Relaying as Relaying
from .sensors_and_actuators import (
    Dropout as Dropout,
    Jitter as Jitter,
    LateSamples as LateSamples,
    MeasurementDelay as MeasurementDelay,
    ModeDelay as ModeDelay,
    Noise as Noise,
    RateLimit as RateLimit,
    Saturation as Saturation,
    WrongMode as WrongMode,
)
