"""The digital loop of a table law on a known signal, at once in compiled code."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from deadtime.base.checks import read_only
from deadtime.feedback import Feedback, Law
from deadtime.imperfections import Disturbance, Sizes
from deadtime.plant import SwitchedSystem, Window
from deadtime.plant.steps import snap
from deadtime.simulation.compiled import Arrays
from deadtime.simulation.forcing import Forcing
from deadtime.simulation.ideal.run import IdealRecord
from deadtime.simulation.imperfect import Told
from deadtime.simulation.initial_input import InitialInput, held_samples
from deadtime.simulation.record import DigitalRecord, PhaseTable
from deadtime.switching import SwitchingSignal
from deadtime.switching.grid import Cuts, modes_at

ModeAt = Callable[[np.ndarray], np.ndarray]
Drawn = Sequence[tuple[Disturbance, np.random.Generator]]  # disturbances and their streams


@dataclass(frozen=True, eq=False)
class Grid:
    """The samples of a run: how many, the plant's window, and the inputs, history first.

    Attributes
    ----------
    inputs : (past + samples, m)
        u_k is inputs[past + k]; filled by the run from row `past` on.
    """

    window: Window
    samples: int
    past: int
    inputs: np.ndarray

    @classmethod
    def of(
        cls, plant: SwitchedSystem, law: Law, horizon: float, step: float, u0: InitialInput
    ) -> Grid:
        """The grid of a run on [0, horizon], its history read from `simulate`'s u0."""
        window = Window.of_plant(plant, step)
        samples = math.floor(snap(horizon / step)) + 1
        past = max(window.count, law.window(step).count)
        inputs = np.zeros((past + samples, plant.inputs))
        longest = max(plant.delay, law.plant.delay)
        inputs[:past] = held_samples(u0, plant.inputs, past, step, longest)
        return cls(window, samples, past, inputs)


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
    plant: SwitchedSystem,
    law: Law,
    signal: SwitchingSignal,
    x0: np.ndarray,
    grid: Grid,
    imperfect: Arrays | None = None,
    disturbances: Drawn = (),
) -> Outcome:
    """Run a table law, or what imperfections make of it, along a signal."""
    window, samples, past, inputs = grid.window, grid.samples, grid.past, grid.inputs
    step = window.step
    feedback = law.digital(step, signal, samples)
    cuts = Cuts.of(signal, window)
    table = PhaseTable.of(plant, window, cuts, samples + window.count)
    shift, forces = np.zeros((0, 2, plant.states)), None
    if disturbances:
        forcing = Forcing(plant, window, samples + window.count, disturbances)
        shift, forces = forcing.along(table, cuts)

    def mode_at(time: np.ndarray) -> np.ndarray:
        return modes_at(signal, time, step)

    rows = feedback.rows(mode_at(np.arange(samples) * step), initial_age(signal, step))
    arrays = imperfect or Arrays.of((), Sizes.of(plant, step), samples, "applied")
    asked = inputs.copy() if arrays.relative.size else inputs
    kept, states, at_phase = _run(table, feedback, rows, x0, grid, asked, arrays, shift)
    record = DigitalRecord(
        plant,
        window,
        cuts,
        table,
        read_only(states),
        read_only(at_phase),
        read_only(inputs[: past + kept]),
        past,
        kept,
        forces,
    )
    diverged = kept < samples
    end = (kept - 1) * step if diverged else None
    told = None
    if imperfect is not None:
        measured = states[:kept] + (arrays.noise[:kept] if arrays.noise.size else 0.0)
        told = Told(measured, asked[past : past + kept])
    return Outcome(record, signal, mode_at, end, diverged, told=told)


def initial_age(signal: SwitchingSignal, step: float) -> int:
    """The age of the first mode at time 0, in samples."""
    return math.floor(snap(signal.initial_age / step))


def _run(
    table: PhaseTable,
    feedback: Feedback,
    rows: np.ndarray,
    x0: np.ndarray,
    grid: Grid,
    asked: np.ndarray,
    imperfect: Arrays,
    shift: np.ndarray,
) -> tuple[int, np.ndarray, np.ndarray]:
    """Call the compiled loop with the rows of the table laid out for it, oldest input first."""
    from deadtime.simulation.kernel import closed_loop

    return closed_loop(
        table.index,
        table.Phi,
        table.Gamma,
        grid.window.count,
        feedback.state_gain,
        read_only(feedback.oldest_first),
        rows,
        x0,
        grid.past,
        grid.inputs,
        asked,
        asked if imperfect.commanded else grid.inputs,
        imperfect.noise,
        (imperfect.low, imperfect.high, imperfect.relative),
        shift,
    )
