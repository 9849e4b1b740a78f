"""A Markov chain of the mode at samples."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from deadtime.problems.switching_registry.entry import Promise, SwitchingSection
from deadtime.problems.toml import Shape
from deadtime.problems.toml.sections import Matrix
from deadtime.switching import SwitchingModel
from deadtime.switching.models.markov_chain import MarkovChain


class MarkovChainSwitching(SwitchingSection):
    """A Markov chain of the mode, which switches at samples only."""

    kind: Literal["markov-chain"]
    P: Annotated[Matrix, Shape("(modes, modes)", [[0.9, 0.1], [0.1, 0.9]])] = Field(
        description="Probabilities from mode (row) to mode (column) in a step; rows sum to 1."
    )
    step: float = Field(description="Period of the chain, seconds: that of [run], or a part of it.")

    def build(self, modes: int, folder: Path) -> SwitchingModel:
        return MarkovChain(self.P, self.step)

    def promise(self, model: SwitchingModel) -> Promise:
        return self.step, None, model.transitions
