"""The package's own imperfections as sections of a problem file: of sensors, inputs, plant."""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from deadtime.imperfections import (
    ColouredDisturbance,
    Dropout,
    Jitter,
    LateSamples,
    MeasurementDelay,
    ModeDelay,
    Noise,
    RateLimit,
    Saturation,
    StepDisturbance,
    WhiteDisturbance,
    WrongMode,
)
from deadtime.problems.imperfection_registry.entry import (
    ImperfectionAxis,
    ImperfectionSection,
    PerSignal,
    Slider,
)
from deadtime.problems.toml import Shape
from deadtime.problems.toml.sections import Count, Matrices, Matrix, Probability, Vector


class NoiseSection(ImperfectionSection):
    """White measurement noise."""

    made: ClassVar = Noise
    axis: ClassVar = ImperfectionAxis(
        name="noise",
        label="measurement noise",
        unit="x",
        description="Standard deviation of measurements.",
        keys=lambda value: {"std": value},
    )
    slider: ClassVar = Slider("Measurement noise (std)", "std", reach=0.3, steps=300)

    kind: Literal["noise"]
    std: PerSignal = Field(description="Standard deviation, a number or one per state.")


class MeasurementDelaySection(ImperfectionSection):
    """A measurement delay beside the input delay."""

    made: ClassVar = MeasurementDelay
    axis: ClassVar = ImperfectionAxis(
        name="measurement_delay",
        label="measurement delay",
        unit="s",
        description="Seconds.",
        keys=lambda value: {"delay": value},
    )

    kind: Literal["measurement-delay"]
    delay: float = Field(description="Seconds.")


class JitterSection(ImperfectionSection):
    """Samples taken early."""

    made: ClassVar = Jitter
    axis: ClassVar = ImperfectionAxis(
        name="jitter",
        label="jitter",
        unit="s",
        description="Samples are up to this early, seconds.",
        keys=lambda value: {"most": value},
    )

    kind: Literal["jitter"]
    most: float = Field(description="How early at most, seconds, at most a period.")


class LateSamplesSection(ImperfectionSection):
    """Samples that come late."""

    made: ClassVar = LateSamples

    kind: Literal["late-samples"]
    periods: int = Field(description="How late, in periods.")
    probability: float = Field(1.0, description="Of each sample.")


class DropoutSection(ImperfectionSection):
    """Lost samples."""

    made: ClassVar = Dropout
    axis: ClassVar = ImperfectionAxis(
        name="dropout",
        label="samples lost",
        unit="",
        description="Probability to lose a sample.",
        keys=lambda value: {"probability": value},
        values=Probability,
    )

    kind: Literal["dropout"]
    probability: float = Field(description="Of each sample.")


class ModeDelaySection(ImperfectionSection):
    """Late mode detection."""

    made: ClassVar = ModeDelay
    axis: ClassVar = ImperfectionAxis(
        name="mode_delay",
        label="late modes",
        unit="periods",
        description="Periods by which modes are reported late.",
        keys=lambda value: {"periods": value},
        values=Count,
    )

    kind: Literal["mode-delay"]
    periods: int = Field(description="How late, in periods.")


class WrongModeSection(ImperfectionSection):
    """Wrong mode detection."""

    made: ClassVar = WrongMode
    axis: ClassVar = ImperfectionAxis(
        name="wrong_mode",
        label="wrong modes",
        unit="",
        description="Probability of a wrong mode.",
        keys=lambda value: {"probability": value},
        values=Probability,
    )

    kind: Literal["wrong-mode"]
    probability: float = Field(description="Of each sample.")


class SaturationSection(ImperfectionSection):
    """Limits of the input."""

    made: ClassVar = Saturation
    axis: ClassVar = ImperfectionAxis(
        name="saturation",
        label="input limit",
        unit="u",
        description="Inputs stay within plus and minus this; 0: no limit.",
        keys=lambda value: {"low": -value, "high": value},
    )
    slider: ClassVar = Slider("Input limit (0: none)", "high", reach=100.0, steps=200)

    kind: Literal["saturation"]
    low: PerSignal = Field(description="A number or one per input.")
    high: PerSignal = Field(description="A number or one per input.")


class RateLimitSection(ImperfectionSection):
    """A limit of the input's rate."""

    made: ClassVar = RateLimit
    axis: ClassVar = ImperfectionAxis(
        name="rate_limit",
        label="input rate limit",
        unit="u/s",
        description="Inputs move by so much a second; 0: no limit.",
        keys=lambda value: {"rate": value},
    )

    kind: Literal["rate-limit"]
    rate: PerSignal = Field(description="Units of the input per second.")


def _without_default(schema: dict[str, Any]) -> None:
    """JSON has no infinity."""
    del schema["default"]


class WhiteDisturbanceSection(ImperfectionSection):
    """White process noise."""

    made: ClassVar = WhiteDisturbance
    axis: ClassVar = ImperfectionAxis(
        name="disturbance",
        label="disturbance intensity",
        unit="x^2/s",
        description="Intensity of a white disturbance on every state.",
        keys=lambda value: {"intensity": value},
    )

    kind: Literal["white-disturbance"]
    intensity: Annotated[
        float | Vector | Matrix | Matrices,
        Shape("a number, (n,), (n, n), or (n, n) for each mode", [0.1, 0.1]),
    ] = Field(
        description="W in units of x² per second: a number, a diagonal, an n × n matrix, or one "
        "for every mode."
    )


class ColouredDisturbanceSection(ImperfectionSection):
    """Process noise with a correlation time."""

    made: ClassVar = ColouredDisturbance

    kind: Literal["coloured-disturbance"]
    std: PerSignal = Field(description="Standard deviation of each source.")
    time_constant: PerSignal = Field(description="Correlation time of each source, seconds.")
    force: Annotated[Vector | Matrix, Shape("(n,) or (n, q)", [0.0, 1.0])] = Field(
        description="How the sources act on dx/dt, n or n × q."
    )


class StepDisturbanceSection(ImperfectionSection):
    """A constant force on dx/dt."""

    made: ClassVar = StepDisturbance

    kind: Literal["step-disturbance"]
    force: Annotated[Vector | Matrix, Shape("(n,) or (modes, n)", [0.0, 1.0])] = Field(
        description="Units of x per second; or a row for every mode."
    )
    start: float = Field(0.0, description="Seconds.")
    end: float = Field(math.inf, description="Seconds.", json_schema_extra=_without_default)
