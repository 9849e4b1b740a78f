"""What acts on the plant, whatever the law does."""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from deadtime.imperfections import ColouredDisturbance, StepDisturbance, WhiteDisturbance
from deadtime.problems.imperfection_registry.entry import (
    ImperfectionAxis,
    ImperfectionSection,
    PerSignal,
)
from deadtime.problems.toml import Shape
from deadtime.problems.toml.sections import Matrices, Matrix, Vector


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
