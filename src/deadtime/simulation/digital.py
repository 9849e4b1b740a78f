"""The digital loop of a table law on a known signal, at once in compiled code."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from deadtime.base.checks import read_only
from deadtime.feedback import Law
from deadtime.feedback.memory import Tables
from deadtime.feedback.table import OLDEST
from deadtime.imperfections import Disturbance, Sizes
from deadtime.imperfections.sensors_and_actuators import InputLimits
from deadtime.loop.belief_steps import BeliefState
from deadtime.loop.observer_steps import ObserverState
from deadtime.loop.received_samples import rows_of_run
from deadtime.plant.discretisation import snap
from deadtime.simulation.digital_record import DigitalRecord
from deadtime.simulation.forcing import Forcing
from deadtime.simulation.ideal.ideal_run import IdealRecord
from deadtime.simulation.loop_arrays import Along, Arrays, DelayLine, Grid, PreviewLaw, Rows, Sight
from deadtime.switching import SwitchingSignal
from deadtime.switching.grid import cuts_of, modes_at

ModeAt = Callable[[np.ndarray], np.ndarray]
Drawn = Sequence[tuple[Disturbance, np.random.Generator]]  # disturbances and their streams


class Told(NamedTuple):
    """The data that a law received at the samples of a run, and its answers.

    measured : (samples, n) or (samples, p), x or y, NaN where nothing arrived
    commanded : (samples, m), what it asked for
    estimates : (samples, states), of a law with a memory, what it took the state to be
    """

    measured: np.ndarray
    commanded: np.ndarray
    estimates: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class RunOutcome:
    """The record, the signal and the end of a run.

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
        The measurements that the law received, where those are not the state.
    belief : (samples, modes) or None
        The probability of each mode in a law that does not receive the mode.
    """

    record: DigitalRecord | IdealRecord
    signal: SwitchingSignal
    mode_at: ModeAt
    end: float | None
    diverged: bool = False
    note: str = ""
    told: Told | None = None
    belief: np.ndarray | None = None


def run_table(
    law: Law,
    tables: Tables,
    signal: SwitchingSignal,
    x0: np.ndarray,
    grid: Grid,
    arrays: Arrays | None = None,
    disturbances: Drawn = (),
) -> RunOutcome:
    """Run a law by its tables, or what imperfections make of it, along a signal."""
    from deadtime.simulation.digital_kernel import closed_loop

    sampled, samples, past = grid.sampled, grid.samples, grid.past
    step, memory, belief = sampled.step, tables.memory, tables.belief
    cuts = cuts_of(signal, sampled)
    table = sampled.along(cuts, grid.periods)
    shift, forces, through = np.zeros((0, x0.size)), None, None
    if disturbances:
        forcing = Forcing(sampled, grid.periods, disturbances)
        shift, forces = forcing.along(table, cuts)
        through = forcing.through

    def mode_at(time: np.ndarray) -> np.ndarray:
        return modes_at(signal, time, step)

    modes = mode_at(np.arange(samples) * step)
    rows = _rows(tables, modes, initial_age(signal, step), arrays)
    sight = Sight.of(arrays, sampled, table, cuts, forces, through, law.outputs, modes)
    measured = x0.size if law.outputs is None else law.outputs.shape[1]
    remembered = 0 if memory is None else memory.start.size
    believed = 0 if belief is None else len(belief.start)
    line = DelayLine.of(grid, arrays, measured, remembered, believed)
    limits = arrays.limits if arrays else InputLimits.of((), Sizes.of(sampled.plant, step))
    along = Along(sampled, signal, table)
    preview = PreviewLaw.of(tables.foresight, samples, along) if tables.foresight else None
    state = observer = None
    if memory is not None:
        observer = ObserverState.of(memory)
        observer.z[:] = memory.start
    if belief is not None:
        state = BeliefState.of(belief, rows.F.shape[0])
    known = memory, observer, belief, state, preview
    kept, path = closed_loop(table, rows, *known, line, sight, limits, shift, x0)
    record = DigitalRecord(
        sampled,
        cuts,
        table,
        read_only(path),
        read_only(grid.inputs[: past + kept]),
        past,
        kept,
        forces,
        through=through,
    )
    diverged = kept < samples
    end = (kept - 1) * step if diverged else None
    told = None
    if arrays is not None or law.outputs is not None:
        estimates = None if memory is None else line.estimates[:kept]
        told = Told(line.measured[:kept], line.asked[past : past + kept], estimates)
    trace = None if state is None else line.beliefs[:kept]
    return RunOutcome(record, signal, mode_at, end, diverged, told=told, belief=trace)


def _rows(tables: Tables, modes: np.ndarray, age: int, arrays: Arrays | None) -> Rows:
    """The rows of a run in which the plant has these modes at the samples."""
    feedback, assumed = tables.feedback, modes
    if feedback is None:
        none = read_only(np.zeros((1, 1, 0)))
        return Rows(none, none, read_only(np.zeros(modes.size, np.int64)), read_only(modes))
    row = None
    if arrays is not None:
        reported = arrays.heard.modes(modes)
        assumed = rows_of_run(reported, modes, age)
        if feedback.context != "step":
            row = rows_of_run(reported, modes, age, feedback.apart, feedback.ages)
    if row is None:
        row = feedback.rows(modes, age)
    F, G = feedback.state_gain, read_only(feedback.oldest_first)
    return Rows(F, G, row, read_only(assumed))


def initial_age(signal: SwitchingSignal, step: float) -> int:
    """The age of the first mode at time 0, in samples; no table tells apart older than OLDEST."""
    return math.floor(snap(min(signal.initial_age / step, OLDEST)))
