"""The digital loop step by step, where a rule switches the plant or something must be called.

That is a law without a table, or a sensor or actuator that is a function of a user's own. A rule's
switches are noted as they come and handed on as the switching signal that they turned out to be;
while the plant slides along a boundary, the mode is the one that it came from. A plant that
chatters has no trajectory from there on: the run ends, and for the mismatch before its end alone
the mode is held.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deadtime.base.checks import read_only
from deadtime.base.errors import ChatteringError
from deadtime.feedback import Law
from deadtime.feedback.belief import Believing
from deadtime.feedback.law import Update, require_input
from deadtime.feedback.table import age_after
from deadtime.plant.steps import snap
from deadtime.simulation.digital import Drawn, RunOutcome, initial_age
from deadtime.simulation.digital_record import DigitalRecord
from deadtime.simulation.imperfect import ImperfectLaw
from deadtime.simulation.imperfection_arrays import MeasurementLags
from deadtime.simulation.loop_arrays import Grid
from deadtime.simulation.slides import slides_in_words
from deadtime.simulation.truth import KnownTruth, RuleTruth, Truth
from deadtime.switching import Rule, SwitchingSignal
from deadtime.switching.grid import modes_at


class _Stop(NamedTuple):
    """Why and when a run ended before its horizon."""

    end: float
    diverged: bool
    note: str


def run_online(
    law: Law,
    switching: SwitchingSignal | Rule,
    x0: np.ndarray,
    horizon: float,
    grid: Grid,
    imperfect: ImperfectLaw | None = None,
    disturbances: Drawn = (),
) -> RunOutcome:
    """Run a law, or what imperfections make of it, along a signal or under a rule, by periods."""
    sampled, step = grid.sampled, grid.sampled.step
    if isinstance(switching, SwitchingSignal):
        age = initial_age(switching, step)
        truth = KnownTruth(sampled, switching, grid.periods, disturbances)
    else:
        age = 0
        truth = RuleTruth(sampled, switching, x0, grid.periods, disturbances)
    update = law.online(step) if imperfect is None else imperfect
    lags = None if imperfect is None else imperfect.lags
    with np.errstate(over="ignore", invalid="ignore"):
        kept, path, stop = _run(truth, update, lags, age, x0, horizon, grid)
    total = kept + sampled.longest_lag - 1
    # Up to where no input is missing, in any mode.
    known = (kept + sampled.windows[0].count - 1) * step + sampled.windows[0].phase
    if truth.chatter is not None:
        known = truth.chatter.time
    signal, cuts = truth.signal(known), truth.cuts()
    table = sampled.along(cuts, total + 1)
    states, forces = truth.along(table, np.array(path))
    record = DigitalRecord(
        sampled,
        cuts,
        table,
        read_only(states),
        read_only(grid.inputs[: grid.past + kept]),
        grid.past,
        kept,
        forces,
        truth.slides if truth.slides and truth.slides.steps else None,
        truth.through,
    )
    end, diverged, note = (None, False, "") if stop is None else stop
    if record.slides is not None:
        slid = slides_in_words(record.slides.slides(step, horizon if end is None else end))
        note = f"{note} {slid}".strip()
    if truth.chatter is not None:
        note = _join(note, truth, end)
    return RunOutcome(
        record,
        signal,
        lambda time: modes_at(signal, time, step),
        end,
        diverged,
        note,
        None if imperfect is None else imperfect.record(kept),
        _belief(update if imperfect is None else imperfect.update, kept),
    )


def _belief(update: Update, kept: int) -> np.ndarray | None:
    """What a law that keeps a belief took each mode's probability to be, (samples, modes)."""
    return np.array(update.beliefs[:kept]) if isinstance(update, Believing) else None


def _run(
    truth: Truth,
    update: Update,
    lags: MeasurementLags | None,
    age: int,
    x0: np.ndarray,
    horizon: float,
    grid: Grid,
) -> tuple[int, list[np.ndarray], _Stop | None]:
    """Run over the samples and on until an input is missing, as `kernel.closed_loop` does."""
    from deadtime.simulation.loop_arrays import LIMIT

    h, kept, past, inputs = grid.sampled.step, grid.samples, grid.past, grid.inputs
    path, first = [x0], [0]
    measured = None if lags is None else [part.tolist() for part in lags.instants(h, kept)]
    stop, last = None, None
    for k in range(grid.periods):
        x, now = path[-1], past + k
        if 0 < k < kept and not x @ x <= LIMIT * LIMIT:
            kept, stop = k, _Stop((k - 1) * h, True, "")
        for piece, acting in enumerate(truth.lags(k)):
            if k - acting.min() >= kept:
                return kept, path, stop
            path.append(truth.move(k, piece, path[-1], grid.acting(k, acting)))
            if piece == 0 and k < kept:
                age = age_after(-1 if last is None else last, age, truth.mode)
                last = truth.mode
                seen = x
                if measured is not None:
                    seen = _measured(truth, *(part[k] for part in measured), path, first, grid)
                try:
                    asked = update(seen, inputs[:now], last, age)
                    inputs[now] = require_input(asked, inputs.shape[1])
                except ChatteringError as error:
                    inputs[now] = inputs[now - 1]
                    note = f"{error} The run ends at t = {k * h:g} s, its last input held over."
                    kept, stop = k + 1, _Stop(k * h, False, note)
        first.append(len(path) - 1)
        if k < kept and stop is None and truth.chatter and truth.chatter.time < horizon:
            # It may begin at the next sample, which then belongs to the run.
            last = int(snap(truth.chatter.time / h))
            kept, stop = min(kept, last + 1), _Stop(truth.chatter.time, False, "")
    return kept, path, stop


def _measured(
    truth: Truth, j: int, offset: float, path: list[np.ndarray], first: list[int], grid: Grid
) -> np.ndarray:
    """x at t_j + offset; NaN where j is −1, as nothing has arrived."""
    if j < 0:
        return np.full(path[0].size, np.nan)
    return path[first[j]] if offset == 0.0 else truth.within(j, offset, path, grid.acting)


def _join(note: str, truth: Truth, end: float | None) -> str:
    """What to say about a plant that chatters, after what there is to say already."""
    time, _, reason = truth.chatter or (0.0, (), "")
    chattering = f"chattering at t = {time:.12g} s: {reason}"
    if time == end:
        return f"{chattering}; the run ends there."
    after = f"{chattering}; from there on the mismatch takes mode {truth.mode} to last."
    return f"{note} {after}".strip()
