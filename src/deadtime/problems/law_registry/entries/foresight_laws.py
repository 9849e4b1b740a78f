"""Laws that know the mode in advance: from the signal, or from the rule that makes it."""

from __future__ import annotations

from typing import ClassVar, Literal

from deadtime.base.figure_style import GREY
from deadtime.feedback import Law
from deadtime.laws import ExactPredictor, StateDependentPredictor
from deadtime.problems.law_registry.entry import LawSection, Named
from deadtime.problems.law_registry.law_setting import LawSetting


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
