"""What a proof asks of the steps of a plant in one period, however its delays are known."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from deadtime.base.frozen import Frozen


@dataclass(frozen=True, eq=False)
class Steps(Frozen, ABC):
    """A plant, or a polytope of plants, at a period: the steps that it can take in one.

    Attributes
    ----------
    A : (vertices, modes, n, n), B : (vertices, modes, n, m)
        The corners of the polytope; one for a plant.
    step : float
        h.
    axes : (d, modes, n, n + m), optional
        Half axes of an ellipsoid of plants about the one given, [A B] + Σ z_i axes_i with |z| ≤ 1.
    """

    A: Float[np.ndarray, "vertex mode n n"]
    B: Float[np.ndarray, "vertex mode n m"]
    step: float
    axes: Float[np.ndarray, "axis mode n nm"] | None = field(default=None, kw_only=True)

    @property
    def vary(self) -> bool:
        """Whether the plant is not known: a polytope, or an ellipsoid."""
        return len(self.A) > 1 or self.axes is not None

    @cached_property
    def reads(self) -> tuple[tuple[int, int], ...]:
        """The past inputs that the plant reads, (lag, input), the oldest first."""
        return tuple(sorted(self._heard(), key=lambda read: (-read[0], read[1])))

    @abstractmethod
    def _heard(self) -> set[tuple[int, int]]:
        """The past inputs that some mode reads, (lag, input)."""

    @abstractmethod
    def ends(self, order: Any) -> Sequence[float | tuple[float, ...]]:
        """The corners of the delays that a step depends on."""

    @abstractmethod
    def switches(self, order: Any) -> bool:
        """Whether a step has a switch; a full step has none."""

    @abstractmethod
    def sample(
        self, order: Any, u: float = 0.0, f: Any = 0.0, weights: np.ndarray | None = None
    ) -> Float[np.ndarray, "n k"]:
        """The plant's rows E of x⁺ = E y at one point of the parameters, in floating point.

        Without weights in the middle of the polytope.
        """

    def corners(self, order: Any, instants: np.ndarray) -> np.ndarray:
        """Samples at the given u, at the ends of the delays, and the corners of the polytope.

        Returns (samples, n, k): what a search for a certificate looks at before the proof.
        """
        us = instants if self.switches(order) else np.zeros(1)
        ends, points = self.ends(order), np.eye(len(self.A))
        return np.stack([self.sample(order, u, f, w) for u in us for f in ends for w in points])

    def _weights(self, weights: np.ndarray | None) -> np.ndarray:
        """The point of the polytope: its middle by default."""
        return np.full(len(self.A), 1.0 / len(self.A)) if weights is None else weights
