"""The digital loop of a table law on a known signal, at once in compiled code."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from deadtime.base.checks import read_only
from deadtime.feedback import Law
from deadtime.feedback.memory import Tables
from deadtime.imperfections import Sizes
from deadtime.imperfections.sensors_and_actuators import InputLimits
from deadtime.loop.belief_steps import BeliefState
from deadtime.loop.observer_steps import ObserverState
from deadtime.loop.received_samples import DrawnImperfections, rows_of_run
from deadtime.simulation.digital_kernel import closed_loop
from deadtime.simulation.digital_record import DigitalRecord
from deadtime.simulation.ideal.ideal_run import IdealRecord
from deadtime.simulation.loop_arrays import DelayLine, MeasurementInstants, PreviewLaw, Rows
from deadtime.simulation.truth import KnownTruth
from deadtime.switching import SwitchingSignal


class LawSignals(NamedTuple):
    """Measurements that a law received at the samples of a run, and its commands.

    measured : (samples, n) or (samples, p), x or y, NaN where nothing arrived
    commanded : (samples, m), before limits
    estimates : (samples, states), of a law with an observer
    """

    measured: np.ndarray
    commanded: np.ndarray
    estimates: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class RunOutcome:
    """The record, the signal and the end of a run.

    Attributes
    ----------
    end : float or None
        Where the run ended before its horizon, seconds.
    diverged : bool
        Whether it ended because it diverged.
    note : str
        Sentences for the run's message.
    law_signals : LawSignals or None
        None where the law receives the state itself at every sample.
    belief : (samples, modes) or None
        The probability of each mode in a law to which the mode is not reported.
    """

    record: DigitalRecord | IdealRecord
    signal: SwitchingSignal
    end: float | None
    diverged: bool = False
    note: str = ""
    law_signals: LawSignals | None = None
    belief: np.ndarray | None = None


def run_table(
    law: Law,
    tables: Tables,
    truth: KnownTruth,
    x0: np.ndarray,
    drawn: DrawnImperfections | None = None,
) -> RunOutcome:
    """Run a law by its tables along a signal; `drawn` are its imperfections, None for none."""
    grid, memory, belief = truth.grid, tables.memory, tables.belief
    past, plant, step = grid.past, grid.sampled.plant, grid.sampled.step
    rows = _rows(tables, truth, drawn)
    instants = MeasurementInstants.of(drawn, truth, law.outputs)
    measured = x0.size if law.outputs is None else law.outputs.shape[1]
    line = DelayLine.of(
        grid,
        drawn,
        measured,
        0 if memory is None else memory.start.size,
        0 if belief is None else len(belief.start),
    )
    limits = drawn.limits if drawn else InputLimits.of((), Sizes.of(plant, step))
    preview = PreviewLaw.of(tables.preview, truth) if tables.preview else None
    state = None if belief is None else BeliefState.of(belief, rows.F.shape[0])
    observer = None
    if memory is not None:
        observer = ObserverState.of(memory)
        observer.z[:] = memory.start
    known = memory, observer, belief, state, preview
    kept, path = closed_loop(truth.table, rows, *known, line, instants, limits, truth.shift, x0)
    diverged, law_signals = kept < grid.samples, None
    if drawn is not None or law.outputs is not None:
        estimates = None if memory is None else line.estimates[:kept]
        law_signals = LawSignals(line.measured[:kept], line.asked[past : past + kept], estimates)
    return RunOutcome(
        truth.record(path, kept),
        truth.switching,
        (kept - 1) * step if diverged else None,
        diverged,
        law_signals=law_signals,
        belief=None if state is None else line.beliefs[:kept],
    )


def _rows(tables: Tables, truth: KnownTruth, drawn: DrawnImperfections | None) -> Rows:
    """The rows of a run; a law with a preview has none."""
    age, modes = truth.age, truth.modes[: truth.grid.samples]
    feedback, assumed = tables.feedback, modes
    if feedback is None:
        none = read_only(np.zeros((1, 1, 0)))
        return Rows(none, none, read_only(np.zeros(modes.size, np.int64)), read_only(modes))
    row = feedback.rows(modes, age)
    if drawn is not None:
        reported = drawn.received.modes(modes)
        assumed = rows_of_run(reported, modes, age)
        # The rows of a law that knows the signal follow the sample, whatever is reported.
        if feedback.context != "step":
            row = rows_of_run(reported, modes, age, feedback.apart, feedback.ages)
    F, G = feedback.state_gain, read_only(feedback.oldest_first)
    return Rows(F, G, row, read_only(assumed))
