"""What the plant is given: limits of the input and of its rate."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from deadtime.imperfections import RateLimit, Saturation
from deadtime.problems.imperfection_registry.entry import (
    ImperfectionAxis,
    ImperfectionSection,
    PerSignal,
    Slider,
)


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
