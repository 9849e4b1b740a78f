"""What the digital loop reads and fills: its grid, the rows of its law, and its delay line."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from deadtime.feedback import Law
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.plant.discretisation import snap
from deadtime.simulation.imperfection_arrays import Arrays
from deadtime.simulation.initial_input import InitialInput, held_samples

LIMIT = 1e100  # of |x|, beyond which a run has diverged


class Rows(NamedTuple):
    """The rows of a law's table for the compiled loop: F (contexts, m, n), G (contexts, m, taps·m)
    with the oldest input first, the row of every sample, and the mode that a memory goes by.
    """

    F: np.ndarray
    G: np.ndarray
    row: np.ndarray
    mode: np.ndarray


class DelayLine(NamedTuple):
    """What goes into the delay line, (past + samples, m), u_k in row past + k, and comes before.

    The law asks for `asked`, the plant is given `inputs`, and the law is `told` past inputs: all
    three are one array where what is asked for is applied. What is `measured` (samples, n or p) is
    what reaches the law, and a law with a memory makes `estimates` (samples, z) of it, and one on a
    belief `beliefs` (samples, modes).
    """

    past: int
    inputs: np.ndarray
    asked: np.ndarray
    told: np.ndarray
    measured: np.ndarray
    estimates: np.ndarray
    beliefs: np.ndarray

    @classmethod
    def of(
        cls, grid: Grid, arrays: Arrays | None, measured: int, remembered: int, believed: int
    ) -> DelayLine:
        """A line before its run, for states or outputs, a memory and a belief of these sizes."""
        inputs, samples = grid.inputs, grid.samples
        limited = arrays is not None and arrays.limits.relative.size
        asked = inputs.copy() if limited else inputs
        told = asked if arrays is not None and arrays.commanded else inputs
        sizes = (samples, measured), (samples if remembered else 0, remembered), (samples, believed)
        return cls(grid.past, inputs, asked, told, *map(np.empty, sizes))


@dataclass(frozen=True, eq=False)
class Grid:
    """The samples of a run: how many, the plant at its period, and the inputs, history first.

    Attributes
    ----------
    inputs : (past + samples, m)
        u_k is inputs[past + k]; filled by the run from row `past` on.
    """

    sampled: SampledPlant
    samples: int
    past: int
    inputs: np.ndarray

    @classmethod
    def of(
        cls, plant: SwitchedSystem, law: Law, horizon: float, step: float, u0: InitialInput
    ) -> Grid:
        """The grid of a run on [0, horizon], its history read from `simulate`'s u0."""
        sampled = SampledPlant.of(plant, step)
        samples = math.floor(snap(horizon / step)) + 1
        past = max(sampled.longest_lag, law.sampled_plant(step).longest_lag)
        inputs = np.zeros((past + samples, plant.inputs))
        longest = max(plant.longest_delay, law.plant.longest_delay)
        inputs[:past] = held_samples(u0, plant.inputs, past, step, longest)
        return cls(sampled, samples, past, inputs)

    @property
    def periods(self) -> int:
        """How many periods the plant is moved: on until nothing that is in flight is left."""
        return self.samples + self.sampled.longest_lag

    def acting(self, k: int, lag: np.ndarray) -> np.ndarray:
        """The inputs that act in period k, as many samples old as their lags say.

        Lags (m,), or those of several modes side by side (`deadtime.plant.sampled_plant`).
        """
        return self.inputs[self.past + k - lag, np.arange(lag.size) % self.inputs.shape[1]]
