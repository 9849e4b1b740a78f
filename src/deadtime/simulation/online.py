"""The digital loop step by step: for a plant that switches by its state, or a law without a table.

The plant follows a signal or a rule; the law is called once a period. A rule's switches are noted
as they come and handed on as the switching signal that they turned out to be; while the plant
slides along a boundary, the mode is the one that it came from. A plant that chatters
has no trajectory from there on: the run ends, and for the mismatch before its end alone the mode
is held.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deadtime.base.checks import read_only
from deadtime.base.errors import ChatteringError
from deadtime.feedback import Law
from deadtime.feedback.law import Update
from deadtime.plant import SwitchedSystem
from deadtime.plant.steps import snap
from deadtime.simulation.digital import Drawn, Grid, Outcome, initial_age
from deadtime.simulation.imperfect import ImperfectLaw, Lags
from deadtime.simulation.record import DigitalRecord, PhaseTable
from deadtime.simulation.slides import told
from deadtime.simulation.truth import KnownTruth, RuleTruth, Truth
from deadtime.switching import Rule, SwitchingSignal
from deadtime.switching.grid import modes_at


class _Stop(NamedTuple):
    """Why and when a run ended before its horizon."""

    end: float
    diverged: bool
    note: str


def run_online(
    plant: SwitchedSystem,
    law: Law,
    switching: SwitchingSignal | Rule,
    x0: np.ndarray,
    horizon: float,
    grid: Grid,
    imperfect: ImperfectLaw | None = None,
    disturbances: Drawn = (),
) -> Outcome:
    """Run a law, or what imperfections make of it, along a signal or under a rule, by periods."""
    window, steps = grid.window, grid.samples + grid.window.count
    if isinstance(switching, SwitchingSignal):
        age = initial_age(switching, window.step)
        truth = KnownTruth(plant, switching, window, steps, disturbances)
    else:
        age = 0
        truth = RuleTruth(plant, switching, window, x0, steps, disturbances)
    update = law.online(window.step) if imperfect is None else imperfect
    lag = None if imperfect is None else imperfect.lag
    with np.errstate(over="ignore", invalid="ignore"):
        kept, states, at_phase, stop = _run(truth, update, lag, age, x0, horizon, grid)
    total = kept + window.count - 1
    known = total * window.step + window.phase if truth.chatter is None else truth.chatter.time
    signal, cuts = truth.signal(known), truth.cuts()
    record = DigitalRecord(
        plant,
        window,
        cuts,
        PhaseTable.of(plant, window, cuts, total),
        read_only(states),
        read_only(at_phase),
        read_only(grid.inputs[: grid.past + kept]),
        grid.past,
        kept,
        truth.forces,
        truth.slides if truth.slides and truth.slides.steps else None,
    )
    end, diverged, note = (None, False, "") if stop is None else stop
    if record.slides is not None:
        slid = told(record.slides.slides(window.step, horizon if end is None else end))
        note = f"{note} {slid}".strip()
    if truth.chatter is not None:
        note = _joined(note, truth, end)
    return Outcome(
        record,
        signal,
        lambda time: modes_at(signal, time, window.step),
        end,
        diverged,
        note,
        None if imperfect is None else imperfect.told(kept),
    )


def _run(
    truth: Truth,
    update: Update,
    lag: Lags | None,
    age: int,
    x0: np.ndarray,
    horizon: float,
    grid: Grid,
) -> tuple[int, np.ndarray, np.ndarray, _Stop | None]:
    """Run over the samples and on until the pipe is empty, as `kernel.closed_loop` does."""
    from deadtime.simulation.kernel import LIMIT

    h, ahead = grid.window.step, grid.window.count
    kept, past, inputs = grid.samples, grid.past, grid.inputs
    states = np.empty((kept + ahead, x0.size))
    at_phase = np.empty_like(states)
    states[0] = x0
    stop, last, k = None, None, 0
    while k < kept + ahead - 1:
        x, now = states[k], past + k
        if 0 < k < kept and not x @ x <= LIMIT * LIMIT:
            kept, stop = k, _Stop((k - 1) * h, True, "")
            continue
        at_phase[k] = truth.move(k, 0, x, inputs[now - ahead])
        if k < kept:
            age = age if last is None else age + 1 if truth.mode == last else 0
            last = truth.mode
            seen = x if lag is None else _before(truth, k, *lag(), states, grid)
            try:
                inputs[now] = update(seen, inputs[:now], last, age)
            except ChatteringError as error:
                inputs[now] = inputs[now - 1]
                note = f"{error} The run ends at t = {k * h:g} s, its last input held over."
                kept, stop = k + 1, _Stop(k * h, False, note)
        states[k + 1] = truth.move(k, 1, at_phase[k], inputs[now - ahead + 1])
        if k < kept and stop is None and truth.chatter and truth.chatter.time < horizon:
            # It may begin at the next sample, which then belongs to the run.
            last = int(snap(truth.chatter.time / h))
            kept, stop = min(kept, last + 1), _Stop(truth.chatter.time, False, "")
        k += 1
    # The run may end between samples: a delay later falls into one phase more.
    truth.move(k, 0, states[k], inputs[past + k - ahead])
    return kept, states[: kept + ahead], at_phase[: kept + ahead - 1], stop


def _before(
    truth: Truth, k: int, late: float, early: float, states: np.ndarray, grid: Grid
) -> np.ndarray:
    """x(t_k − late − early), at time 0 at least; NaN while nothing has arrived."""
    ratio = max(0.0, snap(k - (late + early) / grid.window.step))
    if snap(k - late / grid.window.step) < 0.0:
        return np.full(states.shape[1], np.nan)
    j = int(np.floor(ratio))
    if ratio == j:
        return states[j]
    first = grid.past + j - grid.window.count
    return truth.within(
        j, (ratio - j) * grid.window.step, states[j], grid.inputs[first : first + 2]
    )


def _joined(note: str, truth: Truth, end: float | None) -> str:
    """What to say about a plant that chatters, after what there is to say already."""
    time, _, reason = truth.chatter or (0.0, (), "")
    chattering = f"chattering at t = {time:.12g} s: {reason}"
    if time == end:
        return f"{chattering}; the run ends there."
    after = f"{chattering}; from there on the mismatch takes mode {truth.mode} to last."
    return f"{note} {after}".strip()
