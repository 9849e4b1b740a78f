"""The package's own laws as sections of a problem file."""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from deadtime.base.checks import real_array
from deadtime.base.errors import ArgumentError
from deadtime.base.figure_style import (
    BLUE,
    BROWN,
    GREEN,
    GREY,
    OLIVE,
    ORANGE,
    PINK,
    PURPLE,
    SKY,
    VERMILION,
)
from deadtime.estimation import BeliefPredictor
from deadtime.feedback import Law
from deadtime.laws import (
    AveragedPredictor,
    DelayedStateFeedback,
    ExactPredictor,
    ExpectedPredictor,
    MeanPredictor,
    OptimalPredictor,
    SingleModePredictor,
    StateDependentPredictor,
)
from deadtime.plant import SwitchedSystem, Weight
from deadtime.problems.law_registry.entry import (
    COLUMN,
    SQUARE,
    InputWeight,
    LawSection,
    LawSetting,
    Named,
    Square,
)
from deadtime.problems.toml import Shape
from deadtime.problems.toml.sections import Matrix, Mode, Vector

_DWELL_TIME = "Predict the current mode for the rest of this dwell time, seconds."


class AveragedLaw(LawSection):
    """Average of the modes' exact predictor feedbacks."""

    names: ClassVar = (
        Named(
            name="averaged",
            knows="nothing",
            colour=BLUE,
            noun="averaged law",
            in_files=True,
            in_studies=True,
        ),
        Named(
            name="averaged, minimax",
            keys={"weights": "minimax"},
            knows="nothing",
            colour=PINK,
            on_page=False,
        ),
        Named(
            name="averaged, one-gain minimax",
            keys={"weights": "minimax", "common_gain": True},
            knows="nothing",
            colour=PURPLE,
            on_page=False,
        ),
        Named(
            name="averaged, dwell-aware",
            knows="the dwell time",
            colour=SKY,
            several=True,
            in_studies=True,
        ),
    )

    kind: Literal["averaged"]
    weights: Annotated[
        Vector | Literal["minimax"] | None, Shape('(modes,) or "minimax"', [0.5, 0.5])
    ] = Field(
        None,
        description='Probability of each mode; equal by default; "minimax" finds those with the '
        "least growth rate of the worst mode.",
    )
    common_gain: bool = Field(
        False, description="With minimax weights: one gain for all modes, tuned as well."
    )
    dwell_time: float | None = Field(None, description=_DWELL_TIME)

    def law(self, setting: LawSetting) -> Law:
        if self.weights == "minimax":
            plant, allow = setting.plant, setting.allow_unstable
            arrays = (_hashable(plant.A), _hashable(plant.B), _hashable(setting.gains))
            tuned = (setting.period, self.common_gain, self.dwell_time, allow)
            return _minimax(*arrays, tuple(map(tuple, plant.delays.tolist())), *tuned)
        if self.common_gain:
            raise ArgumentError('common_gain = true goes with weights = "minimax" only.')
        return AveragedPredictor(
            setting.plant,
            setting.gains,
            self.weights,
            self.dwell_time,
            allow_unstable=setting.allow_unstable,
        )


def _hashable(array: np.ndarray) -> tuple:
    """A three-dimensional array as nested tuples."""
    return tuple(tuple(map(tuple, matrix)) for matrix in array.tolist())


@lru_cache(maxsize=64)
def _minimax(
    A: tuple,
    B: tuple,
    gains: tuple,
    delays: tuple,
    step: float,
    common_gain: bool,
    dwell_time: float | None,
    allow_unstable: bool,
) -> Law:
    """The law of minimax weights, cached: cells of one plant share it, whatever their switching."""
    return AveragedPredictor.minimax(
        SwitchedSystem(np.array(A), np.array(B), np.array(delays)),
        np.array(gains),
        step,
        common_gain=common_gain,
        dwell_time=dwell_time,
        allow_unstable=allow_unstable,
    )


class SingleLaw(LawSection):
    """Exact predictor feedback of one mode."""

    names: ClassVar = (
        Named(name="mode {mode} only", knows="nothing", several=True, in_files=True),
    )

    kind: Literal["single"]
    mode: Mode = Field(description="Its number, or its name in [plant].")

    def law(self, setting: LawSetting) -> Law:
        return SingleModePredictor(
            setting.plant, setting.gains, self.mode, allow_unstable=setting.allow_unstable
        )


class MeanLaw(LawSection):
    """Exact predictor feedback of the mean plant; its gain is designed like the others."""

    names: ClassVar = (
        Named(
            name="mean",
            knows="nothing",
            colour=VERMILION,
            noun="mean law",
            several=True,
            in_files=True,
            in_studies=True,
        ),
        Named(
            name="mean, dwell-aware",
            knows="the dwell time",
            colour=ORANGE,
            several=True,
            in_studies=True,
        ),
    )

    kind: Literal["mean"]
    gain: Annotated[Matrix | None, Shape("(m, n)", [[-1.0, -2.0]])] = Field(
        None, description="K̄, m × n; needed when gains are given as K."
    )
    A: Annotated[Matrix | None, Shape("(n, n)", SQUARE)] = Field(
        None, description="Ā; the element-wise mean by default."
    )
    B: Annotated[Matrix | None, Shape("(n, m)", COLUMN)] = Field(
        None, description="B̄; the element-wise mean by default."
    )
    dwell_time: float | None = Field(None, description=_DWELL_TIME)

    def law(self, setting: LawSetting) -> Law:
        plant = setting.plant
        A, B = plant.mean().A[0], plant.mean().B[0]
        A = A if self.A is None else real_array("A", self.A, "(n, n)", 2)
        B = B if self.B is None else real_array("B", self.B, "(n, m)", 2)
        if self.gain is not None:
            gain = real_array("gain", self.gain, "(m, n)", 2)
        else:
            gain = setting.mean_gain(SwitchedSystem(A[None], B[None], plant.mean().delays))
        return MeanPredictor(
            plant,
            gain,
            setting.gains,
            self.dwell_time,
            (A, B),
            allow_unstable=setting.allow_unstable,
        )


class ExpectedLaw(LawSection):
    """Expected predictor feedback under the file's [switching] model."""

    names: ClassVar = (
        Named(
            name="expected",
            knows="the distribution",
            colour=GREEN,
            noun="expected law",
            in_files=True,
            in_studies=True,
        ),
    )
    needs: ClassVar = ("model",)

    kind: Literal["expected"]
    ages: int | None = Field(
        None, description="Largest number of ages (samples) that are distinguished, if age matters."
    )

    def law(self, setting: LawSetting) -> Law:
        assert setting.model is not None
        return ExpectedPredictor(
            setting.plant,
            setting.gains,
            setting.model,
            ages=self.ages,
            allow_unstable=setting.allow_unstable,
        )


class OptimalLaw(LawSection):
    """The best causal law under the file's [switching] model, for ∫ xᵀQx + uᵀRu."""

    names: ClassVar = (
        Named(name="optimal", knows="the distribution", colour=OLIVE, noun="optimal law"),
    )
    needs: ClassVar = ("model",)
    quick: ClassVar = 100
    follows: ClassVar = False

    kind: Literal["optimal"]
    Q: Square | None = Field(None, description="n × n; that of [cost] or [gains.lqr], or I.")
    R: InputWeight | None = Field(None, description="m × m; that of [cost] or [gains.lqr], or I.")

    def law(self, setting: LawSetting) -> Law:
        assert setting.model is not None
        plant = setting.plant
        weight = (setting.weight or Weight()).of(plant)
        return OptimalPredictor(plant, setting.model, self.Q or weight.Q, self.R or weight.R)


class ExactLaw(LawSection):
    """The oracle, which knows the signal."""

    names: ClassVar = (
        Named(
            name="oracle",
            knows="the future",
            colour=GREY,
            noun="oracle",
            in_files=True,
            in_studies=True,
        ),
    )
    needs: ClassVar = ("signal",)

    kind: Literal["exact"]

    def law(self, setting: LawSetting) -> Law:
        return ExactPredictor(setting.plant, setting.gains, allow_unstable=setting.allow_unstable)


class StateDependentLaw(LawSection):
    """Exact predictor feedback where the state decides the mode, by the rule in [signal]."""

    names: ClassVar = (Named(name="state-dependent", knows="nothing", in_files=True),)
    needs: ClassVar = ("rule",)
    follows: ClassVar = False

    kind: Literal["state-dependent"]

    def law(self, setting: LawSetting) -> Law:
        assert setting.rule is not None
        return StateDependentPredictor(
            setting.plant, setting.gains, setting.rule, allow_unstable=setting.allow_unstable
        )


class DelayedLaw(LawSection):
    """State feedback that ignores the delay."""

    names: ClassVar = (Named(name="delay ignored", knows="nothing", in_files=True),)

    kind: Literal["delayed"]

    def law(self, setting: LawSetting) -> Law:
        return DelayedStateFeedback(
            setting.plant, setting.gains, allow_unstable=setting.allow_unstable
        )


class BeliefLaw(LawSection):
    """A law under the file's [switching] model that reads the belief of [mode_filter]."""

    names: ClassVar = (
        Named(
            name="belief",
            knows="the distribution",
            colour=BROWN,
            noun="law on a belief",
            several=True,
            in_files=True,
        ),
    )
    needs: ClassVar = ("model", "mode_filter")
    follows: ClassVar = False

    kind: Literal["belief"]
    of: Literal["expected", "optimal"] = Field(
        "expected", description="The law whose rows the belief weights."
    )

    def law(self, setting: LawSetting) -> Law:
        assert setting.mode_filter is not None
        section = {"expected": ExpectedLaw, "optimal": OptimalLaw}[self.of]
        law = section.model_validate({"kind": self.of}).law(setting)
        return BeliefPredictor(law, setting.mode_filter(setting.plant))
