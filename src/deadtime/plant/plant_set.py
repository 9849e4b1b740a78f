"""Sets of plants that a certificate covers, and plants that are not known exactly."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from deadtime.base.frozen import Frozen
from deadtime.plant.switched_system import SwitchedSystem


def norm_of_entries(parts: np.ndarray) -> Float[np.ndarray, "*entries"]:
    """(Σ_i parts_i²)^½ of each entry, rounded up."""
    # Scaled by the largest part, so that squares neither overflow nor underflow.
    largest = np.abs(parts).max(axis=0, initial=0.0)
    unit = np.where(largest > 0.0, largest, 1.0)
    return unit * np.sqrt(((parts / unit) ** 2).sum(axis=0)) * (1.0 + 1e-12)


@dataclass(frozen=True, eq=False)
class PlantSet(Frozen, ABC):
    """A set that contains the true plant, which may be another one in each period (immutable).

    It is the polytope of the vertices A (vertices, modes, n, n) and B (vertices, modes, n, m), or a
    subset of [A B] + Σ z_i directions_i with |z| ≤ 1 about a single vertex. The modes share the
    point of the polytope, and z.
    """

    kind: ClassVar[str]  # its name in sentences
    keys: ClassVar[tuple[str, ...]] = ()  # names of its arrays besides A and B, in files
    products: ClassVar[int] = 0  # of order n k, to enclose the effect of z on an n × k matrix

    A: Float[np.ndarray, "vertex mode n n"]
    B: Float[np.ndarray, "vertex mode n m"]

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Modes, n, m."""
        return self.A.shape[1], self.A.shape[2], self.B.shape[3]

    @property
    def directions(self) -> Float[np.ndarray, "d mode n nm"]:
        """The change of [A B] by each z_i; empty for a polytope."""
        modes, n, m = self.sizes
        return np.zeros((0, modes, n, n + m))

    @property
    def radius(self) -> Float[np.ndarray, "mode n nm"]:
        """The largest change of each entry of [A B] by z, rounded up."""
        return norm_of_entries(self.directions)

    @property
    def in_polytope(self) -> bool:
        """Whether every plant is in the polytope of the vertices."""
        return not len(self.directions)

    @property
    def known(self) -> bool:
        """Whether it is a single plant."""
        return self.in_polytope and len(self.A) == 1

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """Its arrays besides A and B, by their names in files."""
        return {name: getattr(self, name) for name in self.keys}

    @property
    @abstractmethod
    def in_words(self) -> tuple[str, str]:
        """The plants, for a sentence; and kind and size of the set, empty for a single plant."""

    def entries(self, mode: int) -> Float[np.ndarray, "vertex n nm"]:
        """[A B] of a mode at each vertex."""
        return np.concatenate((self.A[:, mode], self.B[:, mode]), axis=2)

    def with_inputs(self, count: int) -> PlantSet:
        """This set with the first `count` inputs only."""
        return replace(self, B=self.B[..., :count])

    def misfit(self) -> str:
        """The reason why `arrays` and vertices form no set of this kind; empty if they do."""
        return ""

    def moved(self, plant: SwitchedSystem, z: np.ndarray) -> SwitchedSystem:
        """The plant plus Σ z_i directions_i."""
        change, n = np.tensordot(z, self.directions, 1), plant.states
        return plant.like(plant.A + change[..., :n], plant.B + change[..., n:])

    def farthest(self, gradient: np.ndarray) -> np.ndarray:
        """The z in the set that maximises a linear function, up to 1e-9 towards the inside."""
        return gradient / float(np.linalg.norm(gradient)) * (1.0 - 1e-9)

    def has_vertex(self, A: np.ndarray, B: np.ndarray) -> bool:
        """Whether a vertex has exactly these matrices."""
        vertices = zip(self.A, self.B, strict=True)
        return any(np.array_equal(A, own) and np.array_equal(B, its) for own, its in vertices)

    def covers(self, other: PlantSet) -> bool:
        """Whether the changes of a vertex by z include those of another set."""
        return other.in_polytope

    def lacks(self, other: PlantSet) -> str:
        """The reason why a proof for this set does not cover another one; empty if it does."""
        if not all(map(self.has_vertex, other.A, other.B)):
            return "a plant with other matrices"
        same = isinstance(self, type(other))
        lacking = f"another {other.kind}" if same else f"no {other.kind} of plants"
        return "" if other.in_polytope or self.covers(other) else lacking


class Polytope(PlantSet):
    """The plants Σ λ_k [A_k B_k], λ_k ≥ 0 and Σ λ_k = 1, with one λ for all modes (immutable)."""

    kind: ClassVar[str] = "polytope"

    @classmethod
    def of(cls, plants: Sequence[SwitchedSystem]) -> Polytope:
        """The polytope of plants of the same sizes; of one plant, that plant."""
        return cls(np.stack([one.A for one in plants]), np.stack([one.B for one in plants]))

    @property
    def in_words(self) -> tuple[str, str]:
        if self.known:
            return "the plant", ""
        any_of = "any plant in the polytope of the given ones (constant within each period)"
        return any_of, f"a polytope of {len(self.A)} plants"


class PlantUncertainty(Frozen, ABC):
    """A plant that is not known exactly; `plant` is the most likely one, or the centre."""

    in_words: ClassVar[tuple[str, str]]  # the regions of A and B, and of the delays
    file_keys: ClassVar[dict[str, tuple[str, Any, str]]]  # of [uncertainty]: shape, example, text

    plant: SwitchedSystem

    @abstractmethod
    def plant_set(self) -> PlantSet:
        """The set of plants for which `certify` proves a loop stable."""

    @abstractmethod
    def delay_range(self) -> tuple[Any, Any] | None:
        """The range of each delay, (low, high) as for `certify`; None if the delays are known."""

    @abstractmethod
    def draw(self, count: int, seed: int = 0) -> tuple[SwitchedSystem, ...]:
        """Random plants."""
