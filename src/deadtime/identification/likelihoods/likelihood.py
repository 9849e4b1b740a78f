"""The likelihood of a log: value, score and information over unknowns that begin with a plant's."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.frozen import Frozen
from deadtime.identification.cells import cells_of
from deadtime.identification.log.recording import Recording
from deadtime.identification.parameters import Layout
from deadtime.identification.scoring import GAIN, Evaluate


@dataclass(frozen=True, eq=False)
class Likelihood(Frozen, ABC):
    """The likelihood of a recording, over a vector that begins with the unknowns of `layout`.

    within : whether the mode may change within periods
    bounds : of the delays, seconds
    nodes : of interpolation, for uneven samples
    gain : the rise of log likelihood that is worth a step
    profiled : whether it is quick enough to be maximised at many delays, for a profile
    """

    recording: Recording
    layout: Layout
    within: bool
    bounds: tuple[float, float]
    nodes: Float[np.ndarray, " node"] = field(repr=False)

    gain: ClassVar[float] = GAIN
    profiled: ClassVar[bool] = True

    @property
    @abstractmethod
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """The least and the largest value of every unknown, delays aside."""

    @abstractmethod
    def stride(self, vector: Float[np.ndarray, " size"]) -> Float[np.ndarray, " size"]:
        """How far each unknown may go at a time that does next to nothing where it is."""

    @abstractmethod
    def told(
        self, vector: Float[np.ndarray, " size"], F: Float[np.ndarray, "size size"]
    ) -> Int[np.ndarray, " told"]:
        """The places of unknowns that an information is of."""

    @abstractmethod
    def evaluate_in(self, low: float, high: float) -> Callable[[np.ndarray], Evaluate]:
        """The likelihood for delays between two, seconds; of even rows in cells of theirs.

        What is usable of a log depends on these, so likelihoods compare between the same ones only.
        """

    def cells(self, theta: Float[np.ndarray, " size"]) -> Int[np.ndarray, " delay"]:
        """The cells that delays lie in."""
        return cells_of(theta[self.layout.at_delays], self.recording.step)


@dataclass(frozen=True, eq=False)
class PlantLikelihood(Likelihood):
    """A likelihood whose unknowns are those of the plant alone: what noise adds is eliminated."""

    @property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        return np.full(self.layout.size, -np.inf), np.full(self.layout.size, np.inf)

    def stride(self, vector: Float[np.ndarray, " size"]) -> Float[np.ndarray, " size"]:
        return np.full(vector.size, np.inf)

    def told(
        self, vector: Float[np.ndarray, " size"], F: Float[np.ndarray, "size size"]
    ) -> Int[np.ndarray, " told"]:
        return np.arange(self.layout.size)
