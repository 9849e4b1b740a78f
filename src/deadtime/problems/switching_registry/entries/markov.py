"""A Markov process in continuous time."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from deadtime.problems.switching_registry.entry import PerMode, Promise, SwitchingSection
from deadtime.switching import SwitchingModel
from deadtime.switching.models.markov import Markov


class MarkovSwitching(SwitchingSection):
    """A Markov process of the mode."""

    kind: Literal["markov"]
    rates: PerMode = Field(description="Rates from mode (row) to mode (column), 1/s.")

    def build(self, modes: int, folder: Path) -> SwitchingModel:
        return Markov(self.rates)

    def promise(self, model: SwitchingModel) -> Promise:
        return None, None, model.transitions
