"""Laws that rely on a model of the switching."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from deadtime.base.figure_style import GREEN, OLIVE
from deadtime.feedback import Law
from deadtime.laws import ExpectedPredictor, OptimalPredictor
from deadtime.plant import Weight
from deadtime.problems.law_registry.entry import InputWeight, LawSection, Named, Square
from deadtime.problems.law_registry.law_setting import LawSetting


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
    ages: int | None = Field(None, description="Most ages (samples) that the table tells apart.")

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
