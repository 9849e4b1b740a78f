"""Laws that read how likely each mode is, where nobody measures it."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from deadtime.base.figure_style import BROWN
from deadtime.estimation import BeliefPredictor
from deadtime.feedback import Law
from deadtime.problems.law_registry.entries.distribution_laws import ExpectedLaw, OptimalLaw
from deadtime.problems.law_registry.entry import LawSection, Named
from deadtime.problems.law_registry.law_setting import LawSetting


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
        "expected", description="The law whose rows are weighed by the belief."
    )

    def law(self, setting: LawSetting) -> Law:
        assert setting.mode_filter is not None
        told = {"expected": ExpectedLaw, "optimal": OptimalLaw}[self.of]
        law = told.model_validate({"kind": self.of}).law(setting)
        return BeliefPredictor(law, setting.mode_filter(setting.plant))
