"""What a problem file may say: the pydantic models behind it, and their JSON Schema.

Only names and types are checked here; what the numbers mean is checked by the package itself.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Vector = list[float]
Matrix = list[Vector]
Matrices = list[Matrix]
Poles = list[float | str]


class Section(BaseModel):
    """A table that refuses keys it does not know."""

    model_config = ConfigDict(extra="forbid", strict=False, title=None)


class PlantSection(Section):
    """The plant dx/dt = A_σ x + B_σ u(t − delay)."""

    delay: float = Field(description="Input delay D, seconds.")
    A: Matrices = Field(description="One n × n matrix per mode.")
    B: Matrices = Field(description="One n × m matrix per mode.")
    states: list[str] = Field([], description="Names of the states, for figures.")
    modes: list[str] = Field([], description="Names of the modes, for figures.")


class LqrSection(Section):
    """Weights of ∫ xᵀQx + uᵀRu."""

    Q: Matrix
    R: Matrix


class GainsSection(Section):
    """Gains of u = +K x: given, or how to design them. Exactly one of K, poles, lqr."""

    K: Matrices | None = Field(None, description="One m × n matrix per mode.")
    poles: Poles | list[Poles] | None = Field(
        None,
        description='Closed-loop poles for all modes, or a list per mode, 1/s; "-1+2j" is complex.',
    )
    lqr: LqrSection | None = None
    allow_unstable: bool = Field(False, description="Accept gains that leave a mode unstable.")

    @model_validator(mode="after")
    def _one_way(self) -> GainsSection:
        if sum(value is not None for value in (self.K, self.poles, self.lqr)) != 1:
            raise ValueError("give exactly one of K, poles and lqr")
        return self


class ModelSection(Section):
    """The law's own model, where it differs from the plant."""

    delay: float | None = None
    A: Matrices | None = None
    B: Matrices | None = None


class LawSection(Section):
    """What all laws share."""

    name: str | None = Field(None, description="Name in tables and figures.")
    model: ModelSection = Field(default_factory=ModelSection)


class AveragedLaw(LawSection):
    """Average of the modes' exact predictor feedbacks."""

    kind: Literal["averaged"]
    weights: Vector | None = Field(None, description="Probability of each mode; equal by default.")


class SingleLaw(LawSection):
    """Exact predictor feedback of one mode."""

    kind: Literal["single"]
    mode: int


class MeanLaw(LawSection):
    """Exact predictor feedback of the mean plant; its gain is designed like the others."""

    kind: Literal["mean"]
    gain: Matrix | None = Field(None, description="K̄, m × n; needed when gains are given as K.")
    A: Matrix | None = Field(None, description="Ā; the element-wise mean by default.")
    B: Matrix | None = Field(None, description="B̄; the element-wise mean by default.")


class ExactLaw(LawSection):
    """The oracle, which knows the signal."""

    kind: Literal["exact"]


class DelayedLaw(LawSection):
    """State feedback that ignores the delay."""

    kind: Literal["delayed"]


class ConstantSignal(Section):
    """One mode for ever."""

    kind: Literal["constant"]
    mode: int


class PeriodicSignal(Section):
    """The modes in turn, over and over."""

    kind: Literal["periodic"]
    sojourns: Vector = Field(description="Seconds in each mode.")
    modes: list[int]
    dwell_time: float | None = Field(None, description="Checked, seconds.")


class RandomSignal(Section):
    """Random sojourns with a minimum or an average dwell time."""

    kind: Literal["random"]
    dwell_time: float | None = Field(None, description="Sojourns are this plus exponential, s.")
    average_dwell_time: float | None = Field(None, description="Instead of dwell_time, s.")
    mean_sojourn: float | None = Field(None, description="Mean sojourn, s.")
    chatter: int = Field(2, description="Switches that an average dwell time allows at once.")
    seed: int = 0


class SwitchesSignal(Section):
    """Switching instants and the mode from each on."""

    kind: Literal["switches"]
    times: Vector = Field(description="Starts of the sojourns, the first 0, seconds.")
    modes: list[int]
    end: float | None = Field(None, description="Up to when the signal is known, seconds.")
    dwell_time: float | None = Field(None, description="Checked, seconds.")


class LogSignal(Section):
    """A CSV log with columns time and mode."""

    kind: Literal["log"]
    file: str = Field(description="Path, relative to the problem file.")
    labels: dict[str, int] | None = Field(None, description="Mode of each text in the log.")
    end: float | None = Field(None, description="Up to when the log is known, on its own clock.")
    dwell_time: float | None = Field(None, description="Checked, seconds.")


class RunSection(Section):
    """The simulation."""

    x0: Vector = Field(description="State at time 0.")
    horizon: float = Field(description="Length of the run, seconds.")
    step: float | Literal["ideal"] = Field(
        0.01, description='Sampling period, seconds; "ideal" updates the law continuously.'
    )
    u0: float | Vector = Field(0.0, description="Constant input before time 0.")


Law = Annotated[
    AveragedLaw | SingleLaw | MeanLaw | ExactLaw | DelayedLaw, Field(discriminator="kind")
]
Signal = Annotated[
    ConstantSignal | PeriodicSignal | RandomSignal | SwitchesSignal | LogSignal,
    Field(discriminator="kind"),
]


class ProblemFile(Section):
    """A deadtime problem."""

    title: str = ""
    source: str = Field("", description="Where the numbers come from.")
    plant: PlantSection
    gains: GainsSection
    law: list[Law] = Field([], description="Laws to run, in order; all of the paper's by default.")
    signal: Signal
    run: RunSection


def json_schema() -> dict[str, Any]:
    """The JSON Schema of problem files, for editors."""
    return ProblemFile.model_json_schema()
