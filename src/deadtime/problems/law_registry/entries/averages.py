"""Laws that predict with fixed plants: each mode's, their average, the mean, or one of them."""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from deadtime.base.checks import real_array
from deadtime.base.errors import ArgumentError
from deadtime.base.figure_style import BLUE, ORANGE, PINK, PURPLE, SKY, VERMILION
from deadtime.feedback import Law
from deadtime.laws import AveragedPredictor, MeanPredictor, SingleModePredictor
from deadtime.plant import SwitchedSystem
from deadtime.problems.law_registry.entry import COLUMN, SQUARE, LawSection, Named
from deadtime.problems.law_registry.law_setting import LawSetting
from deadtime.problems.toml import Shape
from deadtime.problems.toml.sections import Matrix, Vector

_DWELL_TIME = "Trust the current mode for the rest of this dwell time, seconds."


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
    """An array of three dimensions as something that can be looked up."""
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
    """The same in all cells of a study with this plant: it depends on no switching."""
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
    mode: int

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
