"""The baseline: a law that does not predict."""

from __future__ import annotations

from typing import ClassVar, Literal

from deadtime.feedback import Law
from deadtime.laws import DelayedStateFeedback
from deadtime.problems.law_registry.entry import LawSection, Named
from deadtime.problems.law_registry.law_setting import LawSetting


class DelayedLaw(LawSection):
    """State feedback that ignores the delay."""

    names: ClassVar = (Named(name="delay ignored", knows="nothing", in_files=True),)

    kind: Literal["delayed"]

    def law(self, setting: LawSetting) -> Law:
        return DelayedStateFeedback(
            setting.plant, setting.gains, allow_unstable=setting.allow_unstable
        )
