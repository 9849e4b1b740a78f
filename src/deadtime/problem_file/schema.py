"""What a problem file may say: the pydantic models behind it, and their JSON Schema.

Only names and types are checked here; what the numbers mean is checked by the package itself.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, model_validator

from deadtime.problem_file.imperfections import ImperfectionSection
from deadtime.problem_file.observer import ObserverSection
from deadtime.problem_file.section import Matrices, Matrix, Poles, Section, Vector


class PlantSection(Section):
    """The plant dx/dt = A_σ x + B_σ u(t − delay)."""

    delay: float = Field(description="Input delay D, seconds.")
    A: Matrices = Field(description="One n × n matrix per mode.")
    B: Matrices = Field(description="One n × m matrix per mode.")
    states: list[str] = Field([], description="Names of the states, for figures.")
    inputs: list[str] = Field([], description="Names of the inputs, for figures.")
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
    """A plant that differs from [plant] in what is given here: the truth, or a law's own model."""

    delay: float | None = None
    A: Matrices | None = None
    B: Matrices | None = None


class LawSection(Section):
    """What all laws share."""

    name: str | None = Field(None, description="Name in tables and figures.")
    low_pass: float | Matrix | None = Field(
        None,
        description="Time constant of a low-pass filter on the law's input, seconds; a number, or "
        "m × m.",
    )
    model: ModelSection = Field(default_factory=ModelSection)


class AveragedLaw(LawSection):
    """Average of the modes' exact predictor feedbacks."""

    kind: Literal["averaged"]
    weights: Vector | Literal["minimax"] | None = Field(
        None,
        description='Probability of each mode; equal by default; "minimax" finds those with the '
        "least growth rate of the worst mode.",
    )
    common_gain: bool = Field(
        False, description="With minimax weights: one gain for all modes, tuned as well."
    )
    dwell_time: float | None = Field(
        None, description="Trust the current mode for the rest of this dwell time, seconds."
    )


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
    dwell_time: float | None = Field(
        None, description="Trust the current mode for the rest of this dwell time, seconds."
    )


class ExpectedLaw(LawSection):
    """Expected predictor feedback under the file's [switching] model."""

    kind: Literal["expected"]
    ages: int | None = Field(None, description="Most ages (samples) that the table tells apart.")


class OptimalLaw(LawSection):
    """The best causal law under the file's [switching] model, for ∫ xᵀQx + uᵀRu."""

    kind: Literal["optimal"]
    Q: Matrix | None = Field(None, description="n × n; that of [gains.lqr], or I, by default.")
    R: Matrix | None = Field(None, description="m × m; that of [gains.lqr], or I, by default.")


class ExactLaw(LawSection):
    """The oracle, which knows the signal."""

    kind: Literal["exact"]


class StateDependentLaw(LawSection):
    """Exact predictor feedback where the state decides the mode, by the rule in [signal]."""

    kind: Literal["state-dependent"]


class DelayedLaw(LawSection):
    """State feedback that ignores the delay."""

    kind: Literal["delayed"]


class SojournSection(Section):
    """A distribution of scipy.stats by its name there, with its parameters."""

    model_config = ConfigDict(extra="allow", strict=False, title=None)

    distribution: str = Field(description='Name in scipy.stats, such as "expon" or "gamma".')


Sojourn = float | SojournSection


class MarkovSwitching(Section):
    """A Markov process of the mode."""

    kind: Literal["markov"]
    rates: Matrix = Field(description="Rates from mode (row) to mode (column), 1/s.")


class SemiMarkovSwitching(Section):
    """Random sojourns, then a random next mode."""

    kind: Literal["semi-markov"]
    sojourn: Sojourn | list[Sojourn] = Field(
        description="Seconds in a mode: a number, or { distribution = …, … }; or one per mode."
    )
    transition: Matrix | None = Field(
        None, description="Probabilities of the next mode; uniform by default."
    )


class FittedSwitching(Section):
    """A semi-Markov model fitted from logs."""

    kind: Literal["fitted"]
    logs: list[str] = Field(description="CSV logs, paths relative to the problem file.")
    family: str | list[str] = Field("auto", description="Family of the sojourns, or one per mode.")
    first: Literal["whole", "drop"] = Field(
        "whole", description='"drop" if the logs begin in mid-sojourn.'
    )
    labels: dict[str, int] | None = Field(None, description="Mode of each text in the logs.")


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


class ModelSignal(Section):
    """A signal drawn from the file's [switching] model."""

    kind: Literal["model"]
    seed: int = 0


class HalfSpaceSignal(Section):
    """Switching by the state: mode 1 where normal·x ≥ offset, mode 0 elsewhere."""

    kind: Literal["half-space"]
    normal: Vector
    offset: float = 0.0


class Region(Section):
    """Where H x ≤ h."""

    H: Matrix
    h: Vector
    mode: int


class PolyhedraSignal(Section):
    """Switching by the state: the mode of the region that holds it."""

    kind: Literal["polyhedra"]
    regions: list[Region] = Field(description="Together they must fill the space.")


class QuadraticSignal(Section):
    """Switching by the state: the mode whose form xᵀ S[i] x is the largest."""

    kind: Literal["quadratic"]
    S: list[Matrix] = Field(description="A symmetric matrix per mode; −S for the smallest form.")


RULES = ("half-space", "polyhedra", "quadratic")  # kinds of signal that the state decides


class RunSection(Section):
    """The simulation."""

    x0: Vector = Field(description="State at time 0.")
    horizon: float = Field(description="Length of the run, seconds.")
    step: float | Literal["ideal"] = Field(
        0.01, description='Sampling period, seconds; "ideal" updates the law continuously.'
    )
    u0: float | Vector = Field(0.0, description="Constant input before time 0.")
    seed: int = Field(0, description="Of all that is random in the imperfections.")
    predict: Literal["applied", "commanded"] = Field(
        "applied", description="Which past inputs laws are told of where the actuator changes them."
    )


Law = Annotated[
    AveragedLaw
    | SingleLaw
    | MeanLaw
    | ExpectedLaw
    | OptimalLaw
    | ExactLaw
    | StateDependentLaw
    | DelayedLaw,
    Field(discriminator="kind"),
]
Switching = Annotated[
    MarkovSwitching | SemiMarkovSwitching | FittedSwitching, Field(discriminator="kind")
]
Signal = Annotated[
    ConstantSignal
    | PeriodicSignal
    | RandomSignal
    | SwitchesSignal
    | LogSignal
    | ModelSignal
    | HalfSpaceSignal
    | PolyhedraSignal
    | QuadraticSignal,
    Field(discriminator="kind"),
]


class ProblemFile(Section):
    """A deadtime problem."""

    title: str = ""
    source: str = Field("", description="Where the numbers come from.")
    plant: PlantSection
    gains: GainsSection
    law: list[Law] = Field([], description="Laws to run, in order; all of the paper's by default.")
    switching: Switching | None = Field(
        None, description="A stochastic model of the switching, for laws and signals that use one."
    )
    observer: ObserverSection | None = Field(
        None, description="Run every law on what an observer makes of measured outputs."
    )
    signal: Signal
    run: RunSection
    truth: ModelSection | None = Field(
        None, description="The plant that is simulated, where it differs from [plant]."
    )
    imperfection: list[ImperfectionSection] = Field(
        [], description="Disturbances, sensors and actuators, in order."
    )


def json_schema() -> dict[str, Any]:
    """The JSON Schema of problem files, for editors."""
    return ProblemFile.model_json_schema()
