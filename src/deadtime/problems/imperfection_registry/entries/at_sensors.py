"""What the law is told: noise, and samples that are late, early or lost."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from deadtime.imperfections import (
    Dropout,
    Jitter,
    LateSamples,
    MeasurementDelay,
    ModeDelay,
    Noise,
    WrongMode,
)
from deadtime.problems.imperfection_registry.entry import (
    ImperfectionAxis,
    ImperfectionSection,
    PerSignal,
    Slider,
)
from deadtime.problems.toml.sections import Count, Probability


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
        description="Periods by which modes are known late.",
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
