"""The sections of a file that say what is imperfect, and what they become."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import Field

from deadtime import imperfections as kinds
from deadtime.imperfections import Imperfection, Sizes
from deadtime.toml_file import Shape
from deadtime.toml_file import section as _section
from deadtime.toml_file.table import Matrix, Section, Vector

PerSignal = Annotated[float | Vector, Shape("a number, or one for each", [0.1, 0.2])]


def _without_default(schema: dict[str, Any]) -> None:
    """JSON has no infinity."""
    del schema["default"]


class NoiseSection(Section):
    """White measurement noise."""

    kind: Literal["noise"]
    std: PerSignal = Field(description="Standard deviation, a number or one per state.")


class MeasurementDelaySection(Section):
    """A measurement delay beside the input delay."""

    kind: Literal["measurement-delay"]
    delay: float = Field(description="Seconds.")


class JitterSection(Section):
    """Samples taken early."""

    kind: Literal["jitter"]
    most: float = Field(description="How early at most, seconds, at most a period.")


class LateSamplesSection(Section):
    """Samples that come late."""

    kind: Literal["late-samples"]
    periods: int = Field(description="How late, in periods.")
    probability: float = Field(1.0, description="Of each sample.")


class DropoutSection(Section):
    """Lost samples."""

    kind: Literal["dropout"]
    probability: float = Field(description="Of each sample.")


class ModeDelaySection(Section):
    """Late mode detection."""

    kind: Literal["mode-delay"]
    periods: int = Field(description="How late, in periods.")


class WrongModeSection(Section):
    """Wrong mode detection."""

    kind: Literal["wrong-mode"]
    probability: float = Field(description="Of each sample.")


class SaturationSection(Section):
    """Limits of the input."""

    kind: Literal["saturation"]
    low: PerSignal = Field(description="A number or one per input.")
    high: PerSignal = Field(description="A number or one per input.")


class RateLimitSection(Section):
    """A limit of the input's rate."""

    kind: Literal["rate-limit"]
    rate: PerSignal = Field(description="Units of the input per second.")


class WhiteDisturbanceSection(Section):
    """White process noise."""

    kind: Literal["white-disturbance"]
    intensity: Annotated[float | Vector | Matrix, Shape("a number, (n,) or (n, n)", [0.1, 0.1])] = (
        Field(description="W in units of x² per second: a number, a diagonal or an n × n matrix.")
    )


class ColouredDisturbanceSection(Section):
    """Process noise with a correlation time."""

    kind: Literal["coloured-disturbance"]
    std: PerSignal = Field(description="Standard deviation of each source.")
    time_constant: PerSignal = Field(description="Correlation time of each source, seconds.")
    force: Annotated[Vector | Matrix, Shape("(n,) or (n, q)", [0.0, 1.0])] = Field(
        description="How the sources act on dx/dt, n or n × q."
    )


class StepDisturbanceSection(Section):
    """A constant force on dx/dt."""

    kind: Literal["step-disturbance"]
    force: Annotated[Vector, Shape("(n,)", [0.0, 1.0])] = Field(
        description="Units of x per second."
    )
    start: float = Field(0.0, description="Seconds.")
    end: float = Field(math.inf, description="Seconds.", json_schema_extra=_without_default)


ImperfectionSection = Annotated[
    NoiseSection
    | MeasurementDelaySection
    | JitterSection
    | LateSamplesSection
    | DropoutSection
    | ModeDelaySection
    | WrongModeSection
    | SaturationSection
    | RateLimitSection
    | WhiteDisturbanceSection
    | ColouredDisturbanceSection
    | StepDisturbanceSection,
    Field(discriminator="kind"),
]


def build_imperfections(
    sections: Sequence[ImperfectionSection], sizes: Sizes, measured: int | None = None
) -> tuple[Imperfection, ...]:
    """The imperfections of a file, each checked against the sizes of its loop.

    `measured` is how many outputs a sensor gives, where it does not give the state.
    """
    sensors = sizes if measured is None else sizes._replace(states=measured)
    built = []
    for i, one in enumerate(sections):
        with _section("imperfection", i):
            name = type(one).__name__.removesuffix("Section")
            made = getattr(kinds, name)(**one.model_dump(exclude={"kind"}))
            kinds.require(made, sensors if isinstance(made, kinds.SensorImperfection) else sizes)
            built.append(made)
    return tuple(built)
