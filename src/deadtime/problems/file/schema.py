"""The schema of problem files: pydantic models, and their JSON Schema.

Only names and types are checked here; the package itself checks the numbers.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, Union

import numpy as np
from pydantic import Field, create_model, model_validator

from deadtime.plant.plant_set import PlantUncertainty
from deadtime.plant.uncertainties import UNCERTAINTIES as KINDS
from deadtime.problems.file.estimators import ModeFilterSection, ObserverSection
from deadtime.problems.file.servo import ServoSection
from deadtime.problems.imperfection_registry import ENTRIES as IMPERFECTIONS, ImperfectionSection
from deadtime.problems.law_registry import ENTRIES, LawSection
from deadtime.problems.law_registry.entry import (
    SQUARE,
    UNIT,
    Delays,
    InputMatrices,
    InputWeight,
    ModelSection,
    Plants,
    Square,
)
from deadtime.problems.switching_registry import ENTRIES as MODELS, SwitchingSection
from deadtime.problems.switching_registry.entry import Times
from deadtime.problems.toml import Shape
from deadtime.problems.toml.sections import (
    First,
    Matrices,
    Matrix,
    Mode,
    Poles,
    PolesPerMode,
    Section,
    Texts,
    Vector,
)

# Keys that are lists: their shape, and an example.
Gains = Annotated[Matrices | None, Shape("(modes, m, n)", [[[-1.0, -2.0]], [[-1.0, -2.0]]])]
State = Annotated[Vector, Shape("(n,)", [1.0, 0.0])]
Names = Annotated[Texts, Shape("a list of texts", ["position", "speed"])]
Allowed = Annotated[Matrix | None, Shape("(modes, modes)", [[0, 1], [1, 0]])]
Seconds = Annotated[Vector, Shape("(count,)", [0.0, 0.7])]
NESTED: Any = float, Vector, Matrix, Matrices
Instants = Literal["anywhere", "samples"]
AT = "Where modes may change: anywhere, or at the samples of the run."
Modes = Annotated[list[Mode], First(), Shape("a list of modes, by number or by name", [0, 1])]
MODE = "Its number, or its name in [plant]."


class PlantSection(Section):
    """The plant dx/dt = A_σ x + B_σ u(t − delay)."""

    delay: Delays = Field(
        description="Input delay D, seconds: one for all, one per input, or a row of them per mode."
    )
    A: Plants = Field(description="One n × n matrix per mode.")
    B: InputMatrices = Field(description="One n × m matrix per mode.")
    states: Names = Field([], description="Names of the states, for figures.")
    inputs: Names = Field([], description="Names of the inputs, for figures.")
    modes: Names = Field([], description="Names of the modes, for figures.")
    units: dict[str, str] = Field(
        {}, description='Units of states, inputs and outputs, by name: { position = "m" }.'
    )


def uncertainty_section(kind: type[PlantUncertainty]) -> type[Section]:
    """The section of a kind of uncertainty, with its keys."""
    keys: dict[str, Any] = {
        name: (Annotated[NESTED[np.ndim(value)], Shape(form, value)], Field(description=words))
        for name, (form, value, words) in kind.file_keys.items()
    }
    about = "Uncertainty of [plant], as `deadtime identify` writes it."
    return create_model(f"{kind.__name__}Section", __base__=Section, __doc__=about, **keys)


# The class of each section.
UNCERTAINTIES = {uncertainty_section(kind): kind for kind in KINDS}


class OperatingPointSection(Section):
    """An equilibrium of the plant; all states and inputs of the file are deviations from it."""

    x: Annotated[Vector, Shape("(n,)", [0.0, 0.0])] = Field(description="In units of the states.")
    u: Annotated[Vector, Shape("(m,)", [0.0])] = Field(description="In units of the inputs.")


class LqrSection(Section):
    """Weights of ∫ xᵀQx + uᵀRu."""

    Q: Square
    R: InputWeight


class GainsSection(Section):
    """Gains of u = +K x, given or designed: exactly one of K, poles, lqr."""

    K: Gains = Field(None, description="One m × n matrix per mode.")
    poles: Annotated[
        Poles | PolesPerMode | None,
        Shape("a list of poles, or one for each mode", [-1.0, "-1+2j", "-1-2j"]),
    ] = Field(
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


class CostSection(Section):
    """Weights of the cost ∫ xᵀQx + uᵀRu that compares laws; ∫|x|² + |u|² by default."""

    Q: Annotated[float | Vector | Matrix, Shape("a number, (n,) or (n, n)", [1.0, 1.0])] = Field(
        1.0, description="Of the states: a number, a diagonal or an n × n matrix."
    )
    R: Annotated[float | Vector | Matrix, Shape("a number, (m,) or (m, m)", [1.0])] = Field(
        1.0, description="Of the inputs: a number, a diagonal or an m × m matrix."
    )


class ConstantSignal(Section):
    """A constant switching signal."""

    kind: Literal["constant"]
    mode: Mode = Field(description=MODE)


class PeriodicSignal(Section):
    """The modes in turn, over and over."""

    kind: Literal["periodic"]
    sojourns: Seconds = Field(description="Seconds in each mode.")
    modes: Modes = Field(description="Numbers, or names in [plant].")
    at: Instants = Field("anywhere", description=AT)
    dwell_time: float | None = Field(None, description="Dwell time to check, seconds.")


class RandomSignal(Section):
    """Random sojourns with a minimum or an average dwell time."""

    kind: Literal["random"]
    dwell_time: Times = Field(
        None, description="Sojourns are this plus exponential, s; or one per mode."
    )
    maximum_dwell: Times = Field(
        None, description="No sojourn is longer, s; or one per mode, inf for none."
    )
    transitions: Allowed = Field(
        None, description="1 where a mode (row) may switch to a mode (column); all by default."
    )
    at: Instants = Field("anywhere", description=AT)
    average_dwell_time: float | None = Field(None, description="Instead of dwell_time, s.")
    mean_sojourn: float | None = Field(None, description="Mean sojourn, s.")
    chatter: int = Field(2, description="Switches that an average dwell time allows at once.")
    seed: int = 0


class SwitchesSignal(Section):
    """Switching instants and the mode from each on."""

    kind: Literal["switches"]
    times: Seconds = Field(description="Starts of the sojourns, the first 0, seconds.")
    modes: Modes = Field(description="Numbers, or names in [plant].")
    at: Instants = Field("anywhere", description=AT)
    end: float | None = Field(None, description="End of the known signal, seconds.")
    dwell_time: float | None = Field(None, description="Dwell time to check, seconds.")


class LogSignal(Section):
    """A CSV log with columns t (or time) and mode."""

    kind: Literal["log"]
    file: str = Field(description="Path, relative to the problem file.")
    labels: dict[str, Mode] | None = Field(None, description="Mode of each text in the log.")
    unit: Literal["s", "ms", "us", "ns"] | None = Field(
        None, description="Unit of the log's times; seconds by default."
    )
    at: Instants = Field("anywhere", description=AT)
    end: float | None = Field(None, description="End of the known log, on its own clock.")
    dwell_time: float | None = Field(None, description="Dwell time to check, seconds.")


class ModelSignal(Section):
    """A signal drawn from the file's [switching] model."""

    kind: Literal["model"]
    seed: int = 0


class HalfSpaceSignal(Section):
    """Switching by the state: mode 1 where normal·x ≥ offset, mode 0 elsewhere."""

    kind: Literal["half-space"]
    normal: State
    offset: float = 0.0


class Region(Section):
    """Where H x ≤ h."""

    H: Annotated[Matrix, Shape("(rows, n)", [[1.0, 0.0]])]
    h: Annotated[Vector, Shape("(rows,)", [0.0])]
    mode: Mode = Field(description=MODE)


class PolyhedraSignal(Section):
    """Switching by the state: the mode of the region that contains it."""

    kind: Literal["polyhedra"]
    regions: list[Region] = Field(description="Together they must fill the space.")


class QuadraticSignal(Section):
    """Switching by the state: the mode whose form xᵀ S[i] x is the largest."""

    kind: Literal["quadratic"]
    S: Annotated[list[Matrix], Shape("(modes, n, n)", [UNIT, SQUARE])] = Field(
        description="A symmetric matrix per mode; −S for the smallest form."
    )


RULES = ("half-space", "polyhedra", "quadratic")  # kinds of signal that the state decides


class OffsetSection(Section):
    """A constant force in one mode: dx/dt = A_σ x + B_σ u(t − D) + force, as of a load."""

    mode: Mode = Field(description=MODE)
    force: Annotated[Vector, Shape("(n,)", [0.0, 1.0])] = Field(
        description="Units of x per second."
    )


class RunSection(Section):
    """The simulation."""

    x0: State = Field(description="State at time 0.")
    horizon: float = Field(description="Length of the run, seconds.")
    step: float | Literal["ideal"] = Field(
        0.01, description='Sampling period, seconds; "ideal" updates the law continuously.'
    )
    u0: Annotated[float | Vector, Shape("a number or (m,)", [0.0])] = Field(
        0.0, description="Constant input before time 0."
    )
    seed: int = Field(0, description="Seed of the imperfections.")
    predict: Literal["applied", "commanded"] = Field(
        "applied", description="Past inputs that laws receive where the actuator changes them."
    )


if TYPE_CHECKING:
    LawEntry = LawSection
    Switching = SwitchingSection
    ImperfectionEntry = ImperfectionSection
    UncertaintySection = Section
else:
    LawEntry = Annotated[Union[ENTRIES], Field(discriminator="kind")]  # noqa: UP007
    Switching = Annotated[Union[MODELS], Field(discriminator="kind")]  # noqa: UP007
    ImperfectionEntry = Annotated[Union[IMPERFECTIONS], Field(discriminator="kind")]  # noqa: UP007
    UncertaintySection = Union[tuple(UNCERTAINTIES)]  # noqa: UP007
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
    uncertainty: UncertaintySection | None = Field(
        None, description="Uncertainty of the plant, for `deadtime robustness`."
    )
    operating_point: OperatingPointSection | None = Field(
        None, description="Equilibrium; states and inputs are deviations from it."
    )
    gains: GainsSection
    cost: CostSection | None = Field(
        None, description="Cost that compares laws; ∫|x|² + |u|² by default."
    )
    law: list[LawEntry] = Field(
        [], description="Laws to run, in order; all of the paper's by default."
    )
    switching: Switching | None = Field(
        None, description="A stochastic model of the switching, for laws and signals that use one."
    )
    mode_filter: ModeFilterSection | None = Field(
        None, description="Mode belief of laws, where the mode is not measured."
    )
    observer: ObserverSection | None = Field(
        None, description="Run every law on the estimates of an observer."
    )
    servo: ServoSection | None = Field(
        None, description="Let outputs follow a reference; [gains] are then those of (x, q)."
    )
    signal: Signal
    run: RunSection
    truth: ModelSection | None = Field(
        None, description="The plant that is simulated, where it differs from [plant]."
    )
    offset: list[OffsetSection] = Field(
        [], description="Constant forces on the plant, mode by mode; none in modes without one."
    )
    imperfection: list[ImperfectionEntry] = Field(
        [], description="Disturbances, sensors and actuators, in order."
    )


def json_schema() -> dict[str, Any]:
    """The JSON Schema of problem files, for editors."""
    return ProblemFile.model_json_schema()
