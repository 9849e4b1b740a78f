"""The package's own switching models as sections of a problem file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from deadtime.problems.switching_registry.entry import (
    PerMode,
    Probabilities,
    Promise,
    SwitchingSection,
    Times,
)
from deadtime.problems.toml import Shape
from deadtime.problems.toml.sections import DistributionSection, Matrix, Mode, Texts, frozen
from deadtime.switching import SwitchingModel, SwitchingSignal
from deadtime.switching.models.markov import Markov
from deadtime.switching.models.markov_chain import MarkovChain
from deadtime.switching.models.semi_markov import SemiMarkov


class MarkovSwitching(SwitchingSection):
    """A Markov process of the mode."""

    kind: Literal["markov"]
    rates: PerMode = Field(description="Rates from mode (row) to mode (column), 1/s.")

    def build(self, modes: int, folder: Path) -> SwitchingModel:
        return Markov(self.rates)

    def promise(self, model: SwitchingModel) -> Promise:
        return None, None, model.transitions


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


Sojourn = float | DistributionSection


class SemiMarkovSwitching(SwitchingSection):
    """Random sojourns, then a random next mode."""

    kind: Literal["semi-markov"]
    sojourn: Sojourn | list[Sojourn] = Field(
        description="Seconds in a mode: a number, or { distribution = …, … }; or one per mode."
    )
    transition: Probabilities = Field(
        None, description="Probabilities of the next mode; uniform by default."
    )
    dwell_time: Times = Field(None, description="No sojourn drawn is shorter, s; or one per mode.")
    maximum_dwell: Times = Field(
        None, description="No sojourn drawn is longer, s; or one per mode, inf for none."
    )

    def build(self, modes: int, folder: Path) -> SwitchingModel:
        given = self.sojourn
        sojourn = (
            [_sojourn(f"sojourn[{i}]", item) for i, item in enumerate(given)]
            if isinstance(given, list)
            else _sojourn("sojourn", given)
        )
        one = not isinstance(given, list) and self.transition is None
        return SemiMarkov(
            sojourn,
            self.transition,
            modes=modes if one else None,
            dwell_time=self.dwell_time,
            maximum_dwell=self.maximum_dwell,
        )

    def promise(self, model: SwitchingModel) -> Promise:
        return self.dwell_time, self.maximum_dwell, model.transitions


class FittedSwitching(SwitchingSection):
    """A semi-Markov model fitted from logs."""

    kind: Literal["fitted"]
    logs: Annotated[Texts, Shape("a list of texts", ["log.csv"])] = Field(
        description="CSV logs, paths relative to the problem file."
    )
    family: str | Texts = Field("auto", description="Family of the sojourns, or one per mode.")
    first: Literal["whole", "drop"] = Field(
        "whole", description='"drop" if the logs begin in mid-sojourn.'
    )
    labels: dict[str, Mode] | None = Field(None, description="Mode of each text in the logs.")
    unit: Literal["s", "ms", "us", "ns"] | None = Field(
        None, description="Unit of the logs' times; seconds by default."
    )

    def build(self, modes: int, folder: Path) -> SwitchingModel:
        signals = [
            SwitchingSignal.from_csv(folder / log, modes=modes, labels=self.labels, unit=self.unit)
            for log in self.logs
        ]
        return SemiMarkov.fit(signals, family=self.family, modes=modes, first=self.first)

    def promise(self, model: SwitchingModel) -> Promise:
        """Nothing: a transition that the logs lack is still possible."""
        return None, None, None


def _sojourn(name: str, given: Sojourn) -> Any:
    """A number, or the frozen scipy.stats distribution that a section names."""
    return frozen(name, given) if isinstance(given, DistributionSection) else given
