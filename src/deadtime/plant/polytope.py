"""A polytope of plants, one plant among them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from deadtime.plant.plant_set import PlantSet
from deadtime.plant.switched_system import SwitchedSystem


class Polytope(PlantSet):
    """The plants Σ λ_k [A_k B_k], λ_k ≥ 0 and Σ λ_k = 1, of all modes with one λ (immutable)."""

    kind: ClassVar[str] = "polytope"

    @classmethod
    def of(cls, plants: Sequence[SwitchedSystem]) -> Polytope:
        """The polytope of some plants of the same sizes, or the one plant."""
        return cls(np.stack([one.A for one in plants]), np.stack([one.B for one in plants]))

    @property
    def in_words(self) -> tuple[str, str]:
        """As of every set."""
        if self.known:
            return "the plant", ""
        any_of = "any plant in the polytope of the given ones (constant within each period)"
        return any_of, f"a polytope of {len(self.A)} plants"
