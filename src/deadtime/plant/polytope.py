"""A polytope of plants, one plant among them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from deadtime.plant.plant_set import PlantSet
from deadtime.plant.switched_system import SwitchedSystem


@dataclass(frozen=True, eq=False)
class Polytope(PlantSet):
    """The plants Σ λ_k [A_k B_k], λ_k ≥ 0 and Σ λ_k = 1, of all modes with one λ (immutable)."""

    kind: ClassVar[str] = "polytope"

    @classmethod
    def of(cls, plants: Sequence[SwitchedSystem]) -> Polytope:
        """The polytope of some plants of the same sizes, or the one plant."""
        return cls(np.stack([one.A for one in plants]), np.stack([one.B for one in plants]))

    @property
    def subject(self) -> str:
        """The plants, for a sentence."""
        if self.known:
            return "the plant"
        return "any plant in the polytope of the given ones (constant within each period)"

    @property
    def short(self) -> str:
        """Of several vertices their number."""
        return "" if self.known else f"a polytope of {self.vertices} plants"
