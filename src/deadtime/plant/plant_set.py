"""Sets of plants: what a certificate is proved for where the plant is not known exactly."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from jaxtyping import Float

from deadtime.base.frozen import Frozen
from deadtime.plant.switched_system import SwitchedSystem


@dataclass(frozen=True, eq=False)
class PlantSet(Frozen, ABC):
    """Plants of which the true one may be any, and another in each period (immutable).

    They are the polytope of the vertices, or of one vertex all are among [A B] + Σ z_i directions_i
    with |z| ≤ 1; all modes with one point of the polytope, and one z.

    Attributes
    ----------
    A : (vertices, modes, n, n), B : (vertices, modes, n, m)
        The vertices; one alone is the plant that is known, or the middle.
    """

    kind: ClassVar[str]  # what sentences call it
    keys: ClassVar[tuple[str, ...]] = ()  # arrays that it has besides A and B, as in files
    products: ClassVar[int] = 0  # of order n k, to enclose what z does to a step's n × k matrix

    A: Float[np.ndarray, "vertex mode n n"]
    B: Float[np.ndarray, "vertex mode n m"]

    @property
    def vertices(self) -> int:
        """How many."""
        return len(self.A)

    @property
    def modes(self) -> int:
        """How many."""
        return self.A.shape[1]

    @property
    def states(self) -> int:
        """n."""
        return self.A.shape[2]

    @property
    def inputs(self) -> int:
        """m."""
        return self.B.shape[3]

    @property
    def directions(self) -> Float[np.ndarray, "d mode n nm"]:
        """[A B] of each; none of the polytope alone."""
        return np.zeros((0, self.modes, self.states, self.states + self.inputs))

    @property
    def radius(self) -> Float[np.ndarray, "mode n nm"]:
        """How far z moves each entry of [A B] at most, rounded up."""
        return np.zeros((self.modes, self.states, self.states + self.inputs))

    @property
    def in_polytope(self) -> bool:
        """Whether every plant is in the polytope of the vertices."""
        return not len(self.directions)

    @property
    def known(self) -> bool:
        """Whether it is one plant alone."""
        return self.vertices == 1 and self.in_polytope

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """The arrays that it has besides A and B, by their names in files."""
        return {name: getattr(self, name) for name in self.keys}

    @property
    def subject(self) -> str:
        """Which plants, for a sentence."""
        return "the plant"

    @property
    def short(self) -> str:
        """Its kind and size, for a list; empty of one plant."""
        return ""

    def entries(self, mode: int) -> Float[np.ndarray, "vertex n nm"]:
        """[A B] of a mode at each vertex."""
        return np.concatenate((self.A[:, mode], self.B[:, mode]), axis=2)

    def with_inputs(self, count: int) -> Self:
        """The same, of its first inputs alone."""
        return replace(self, B=self.B[..., :count])

    def farthest(self, gradient: np.ndarray) -> np.ndarray:
        """The z of a plant of the set at which a linear function of z is about largest."""
        return gradient / float(np.linalg.norm(gradient)) * (1.0 - 1e-9)

    def moved(self, plant: SwitchedSystem, z: np.ndarray) -> SwitchedSystem:
        """A plant moved by z."""
        by = np.tensordot(z, self.directions, 1)
        n = self.states
        return plant.like(plant.A + by[..., :n], plant.B + by[..., n:])

    def has_vertex(self, A: np.ndarray, B: np.ndarray) -> bool:
        """Whether this plant, number by number, is a vertex."""
        known = zip(self.A, self.B, strict=True)
        return any(np.array_equal(A, one) and np.array_equal(B, its) for one, its in known)

    def lacks(self, asked: PlantSet) -> str:
        """Why a proof for this set is none for another one; empty if it is."""
        if not all(map(self.has_vertex, asked.A, asked.B)):
            return "a plant with other matrices"
        if asked.in_polytope or self.covers(asked):
            return ""
        same = isinstance(self, type(asked))
        return f"another {asked.kind}" if same else f"no {asked.kind} of plants"

    def covers(self, asked: PlantSet) -> bool:
        """Whether all that z does to the plants of another set it does to those of this one."""
        return False

    def misfit(self) -> str:
        """Why its arrays do not make a set, but for their shapes; empty if they do."""
        return ""

    def expected_shapes(self) -> dict[str, tuple[int, ...]]:
        """The shapes of `arrays` that fit A and B."""
        return {}


class PlantUncertainty(Frozen, ABC):
    """A plant that is not known exactly, as it is measured or given.

    Attributes
    ----------
    plant : SwitchedSystem
        The likeliest plant, or the middle.
    """

    plant: SwitchedSystem
    in_words: ClassVar[str]  # where A and B are
    delays_in_words: ClassVar[str]  # where the delays are

    @abstractmethod
    def plant_set(self) -> PlantSet:
        """The plants that `certify` proves a loop for."""

    @abstractmethod
    def delay_range(self) -> tuple[Any, Any] | None:
        """The range of each delay, (low, high) as `certify` takes it; None if it is known."""

    @abstractmethod
    def corners(self) -> tuple[SwitchedSystem, ...]:
        """The corners of a polytope that holds A and B."""

    @abstractmethod
    def draw(self, count: int, seed: int = 0) -> tuple[SwitchedSystem, ...]:
        """Plants that it may be, at random."""
