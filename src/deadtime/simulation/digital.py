"""The digital loop of a table law on a known signal, at once in compiled code."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from deadtime.base.checks import read_only
from deadtime.feedback import Law
from deadtime.imperfections import Disturbance, Sizes
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.plant.steps import snap
from deadtime.simulation.compiled import Arrays
from deadtime.simulation.forcing import Forcing
from deadtime.simulation.ideal.run import IdealRecord
from deadtime.simulation.imperfect import Told
from deadtime.simulation.initial_input import InitialInput, held_samples
from deadtime.simulation.record import DigitalRecord
from deadtime.switching import SwitchingSignal
from deadtime.switching.grid import cuts_of, modes_at

ModeAt = Callable[[np.ndarray], np.ndarray]
Drawn = Sequence[tuple[Disturbance, np.random.Generator]]  # disturbances and their streams


class Rows(NamedTuple):
    """The rows of a law's table for the compiled loop: F (contexts, m, n), G (contexts, m, taps·m)
    with the oldest input first, and the row of every sample.
    """

    F: np.ndarray
    G: np.ndarray
    row: np.ndarray


class Line(NamedTuple):
    """What goes into the delay line, (past + samples, m), u_k in row past + k.

    The law asks for `asked`, the plant is given `inputs`, and the law is `told` past inputs: all
    three are one array where what is asked for is applied.
    """

    past: int
    inputs: np.ndarray
    asked: np.ndarray
    told: np.ndarray


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
        sampled = SampledPlant(plant, step)
        samples = math.floor(snap(horizon / step)) + 1
        past = max(sampled.longest_lag, law.sampled_plant(step).longest_lag)
        inputs = np.zeros((past + samples, plant.inputs))
        longest = max(plant.delay, law.plant.delay)
        inputs[:past] = held_samples(u0, plant.inputs, past, step, longest)
        return cls(sampled, samples, past, inputs)

    @property
    def periods(self) -> int:
        """How many periods the plant is moved: on until nothing that is in flight is left."""
        return self.samples + self.sampled.longest_lag

    def acting(self, k: int, lag: np.ndarray) -> np.ndarray:
        """The inputs (m,) that act in period k, as many samples old as their lags say."""
        return self.inputs[self.past + k - lag, np.arange(lag.size)]


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a run leaves behind.

    Attributes
    ----------
    mode_at : callable
        σ with switches snapped to the instants that they are within round-off of.
    end : float or None
        Where the run ended before its horizon, seconds.
    diverged : bool
        Whether it ended because it diverged.
    note : str
        What else is worth knowing.
    told : Told or None
        What the law was told, where that is not the state.
    """

    record: DigitalRecord | IdealRecord
    signal: SwitchingSignal
    mode_at: ModeAt
    end: float | None
    diverged: bool = False
    note: str = ""
    told: Told | None = None


def run_table(
    law: Law,
    signal: SwitchingSignal,
    x0: np.ndarray,
    grid: Grid,
    imperfect: Arrays | None = None,
    disturbances: Drawn = (),
) -> Outcome:
    """Run a table law, or what imperfections make of it, along a signal."""
    from deadtime.simulation.kernel import closed_loop

    sampled, samples, past, inputs = grid.sampled, grid.samples, grid.past, grid.inputs
    step = sampled.step
    feedback = law.digital(step, signal, samples)
    cuts = cuts_of(signal, sampled.window)
    table = sampled.along(cuts, grid.periods)
    shift, forces = np.zeros((0, x0.size)), None
    if disturbances:
        forcing = Forcing(sampled, grid.periods, disturbances)
        shift, forces = forcing.along(table, cuts)

    def mode_at(time: np.ndarray) -> np.ndarray:
        return modes_at(signal, time, step)

    row = feedback.rows(mode_at(np.arange(samples) * step), initial_age(signal, step))
    rows = Rows(feedback.state_gain, read_only(feedback.oldest_first), row)
    arrays = imperfect or Arrays.of((), Sizes.of(sampled.plant, step), samples, "applied")
    asked = inputs.copy() if arrays.relative.size else inputs
    line = Line(past, inputs, asked, asked if arrays.commanded else inputs)
    kept, path = closed_loop(table, rows, line, arrays, shift, x0)
    record = DigitalRecord(
        sampled,
        cuts,
        table,
        read_only(path),
        read_only(inputs[: past + kept]),
        past,
        kept,
        forces,
    )
    diverged = kept < samples
    end = (kept - 1) * step if diverged else None
    told = None
    if imperfect is not None:
        measured = record.states[:kept] + (arrays.noise[:kept] if arrays.noise.size else 0.0)
        told = Told(measured, asked[past : past + kept])
    return Outcome(record, signal, mode_at, end, diverged, told=told)


def initial_age(signal: SwitchingSignal, step: float) -> int:
    """The age of the first mode at time 0, in samples."""
    return math.floor(snap(signal.initial_age / step))
