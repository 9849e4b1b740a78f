"""An entry of the registry: the [switching] section for a model.

class RenewalSwitching(SwitchingSection):
    "The description in editors."

    kind: Literal["renewal"]
    sojourn: float = Field(description="Seconds in a mode.")

    def build(self, modes: int, folder: Path) -> SwitchingModel:
        return Renewal(self.sojourn, modes)

    def promise(self, model: SwitchingModel) -> Promise:
        return self.sojourn, None, model.transitions
"""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path
from typing import Annotated, Any, final

from deadtime.base.errors import ArgumentError
from deadtime.problems.toml import Shape
from deadtime.problems.toml.sections import Matrix, Section, Vector, kinds_of
from deadtime.switching import SwitchingModel

PerMode = Annotated[Matrix, Shape("(modes, modes)", [[0.0, 0.5], [0.5, 0.0]])]
Probabilities = Annotated[Matrix | None, Shape("(modes, modes)", [[0.0, 1.0], [1.0, 0.0]])]
Times = Annotated[float | Vector | None, Shape("a number or (modes,)", [0.3, 0.6])]
Promise = tuple[Any, Any, Any]


class SwitchingSection(Section):
    """The base of entries. Each adds its `kind`, its keys, `build` and `promise`."""

    @abstractmethod
    def build(self, modes: int, folder: Path) -> SwitchingModel:
        """The model of the section; relative paths start at `folder`."""

    @final
    def model(self, modes: int, folder: Path) -> SwitchingModel:
        """The model of `build`; refused if it has another number of modes."""
        model = self.build(modes, folder)
        if model.modes != modes:
            kind = kinds_of(type(self))[0]
            raise ArgumentError(
                f"kind = {kind!r} describes {model.modes} modes, the plant has {modes}."
            )
        return model

    @abstractmethod
    def promise(self, model: SwitchingModel) -> Promise:
        """Of every signal: its dwell time and longest dwell, seconds, and transitions, or None."""
