"""Sets of plants: what a certificate is proved for where the plant is not known exactly."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from deadtime.base.frozen import Frozen
from deadtime.plant.switched_system import SwitchedSystem


def norm_of_entries(parts: np.ndarray) -> Float[np.ndarray, "*entries"]:
    """(Σ_i parts_i²)^½ of each entry, rounded up."""
    largest = np.abs(parts).max(axis=0, initial=0.0)
    unit = np.where(largest > 0.0, largest, 1.0)
    return unit * np.sqrt(((parts / unit) ** 2).sum(axis=0)) * (1.0 + 1e-12)


@dataclass(frozen=True, eq=False)
class PlantSet(Frozen, ABC):
    """Plants of which the true one may be any, and another in each period (immutable).

    They are the polytope of the vertices A (vertices, modes, n, n) and B (vertices, modes, n, m);
    or, of one vertex, all are among [A B] + Σ z_i directions_i with |z| ≤ 1. All modes have one
    point of the polytope, and one z.
    """

    kind: ClassVar[str]  # what sentences call it
    keys: ClassVar[tuple[str, ...]] = ()  # its arrays besides A and B, as in files
    products: ClassVar[int] = 0  # of order n k, to enclose what z does to a step's n × k matrix

    A: Float[np.ndarray, "vertex mode n n"]
    B: Float[np.ndarray, "vertex mode n m"]

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Modes, n, m."""
        return self.A.shape[1], self.A.shape[2], self.B.shape[3]

    @property
    def directions(self) -> Float[np.ndarray, "d mode n nm"]:
        """[A B] of each; none of a polytope."""
        modes, n, m = self.sizes
        return np.zeros((0, modes, n, n + m))

    @property
    def radius(self) -> Float[np.ndarray, "mode n nm"]:
        """How far z moves each entry of [A B] at most, rounded up."""
        return norm_of_entries(self.directions)

    @property
    def in_polytope(self) -> bool:
        """Whether every plant is in the polytope of the vertices."""
        return not len(self.directions)

    @property
    def known(self) -> bool:
        """Whether it is one plant alone."""
        return self.in_polytope and len(self.A) == 1

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """Its arrays besides A and B, by their names in files."""
        return {name: getattr(self, name) for name in self.keys}

    @property
    @abstractmethod
    def in_words(self) -> tuple[str, str]:
        """Which plants, for a sentence; and its kind and size, nothing of one plant."""

    def entries(self, mode: int) -> Float[np.ndarray, "vertex n nm"]:
        """[A B] of a mode at each vertex."""
        return np.concatenate((self.A[:, mode], self.B[:, mode]), axis=2)

    def with_inputs(self, count: int) -> PlantSet:
        """This set with its first inputs alone."""
        return replace(self, B=self.B[..., :count])

    def misfit(self) -> str:
        """Why `arrays` and the vertices make no set of this kind; empty if they do."""
        return ""

    def moved(self, plant: SwitchedSystem, z: np.ndarray) -> SwitchedSystem:
        """A plant moved by z."""
        by, n = np.tensordot(z, self.directions, 1), plant.states
        return plant.like(plant.A + by[..., :n], plant.B + by[..., n:])

    def farthest(self, gradient: np.ndarray) -> np.ndarray:
        """The z of a plant of the set at which a linear function of z is about largest."""
        return gradient / float(np.linalg.norm(gradient)) * (1.0 - 1e-9)

    def has_vertex(self, A: np.ndarray, B: np.ndarray) -> bool:
        """Whether this plant, number by number, is a vertex."""
        known = zip(self.A, self.B, strict=True)
        return any(np.array_equal(A, one) and np.array_equal(B, its) for one, its in known)

    def covers(self, asked: PlantSet) -> bool:
        """Whether z moves a vertex to all plants that another set's z moves it to."""
        return asked.in_polytope

    def lacks(self, asked: PlantSet) -> str:
        """Why a proof for this set is none for another one; empty if it is."""
        if not all(map(self.has_vertex, asked.A, asked.B)):
            return "a plant with other matrices"
        same = isinstance(self, type(asked))
        lacking = f"another {asked.kind}" if same else f"no {asked.kind} of plants"
        return "" if asked.in_polytope or self.covers(asked) else lacking


class PlantUncertainty(Frozen, ABC):
    """A plant that is not known exactly: the likeliest one, or the middle, is `plant`."""

    in_words: ClassVar[tuple[str, str]]  # where A and B are, and where the delays are
    file_keys: ClassVar[dict[str, tuple[str, Any, str]]]  # of [uncertainty]: shape, example, words

    plant: SwitchedSystem

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
