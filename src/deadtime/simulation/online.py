"""The digital loop step by step: for a plant that switches by its state, or a law without a table.

The plant follows a signal or a rule; the law is called once a period. A rule's switches are noted
as they come and handed on as the switching signal that they turned out to be. A plant that
chatters has no trajectory from there on: the run ends, and for the mismatch before its end alone
the mode is held.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np

from deadtime.errors import ChatteringError
from deadtime.laws.base import Law, Update
from deadtime.plant import SwitchedSystem
from deadtime.simulation.digital import Grid, Outcome, initial_age
from deadtime.simulation.record import DigitalRecord, PhaseTable
from deadtime.steps import TOLERANCE, Cuts, Window, modes_at, snap
from deadtime.switching import SwitchingSignal
from deadtime.switching.motion import Chatter
from deadtime.switching.rules import Rule

_SAME = 1e-10  # of a step: switches that close are one
_FAR = 1e200  # a diverged run is only moved on, whatever the rule says


class Truth(ABC):
    """The plant of a run, moved phase by phase.

    Attributes
    ----------
    mode : int
        σ(t_k), once phase 0 of step k is run.
    chatter : Chatter or None
        When the plant began to chatter; from there on its mode is held.
    """

    mode: int
    chatter: Chatter | None = None

    @abstractmethod
    def move(self, k: int, phase: int, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """x at the end of phase 0 or 1 of step k, from x at its start."""

    @abstractmethod
    def signal(self, end: float) -> SwitchingSignal:
        """The plant's switching signal, known up to `end`."""

    @abstractmethod
    def cuts(self) -> Cuts:
        """Its switches, laid on the steps."""


class KnownTruth(Truth):
    """A plant along a given signal."""

    def __init__(
        self, plant: SwitchedSystem, signal: SwitchingSignal, window: Window, steps: int
    ) -> None:
        self._signal, self._cuts = signal, Cuts.of(signal, window)
        self._table = PhaseTable.of(plant, window, self._cuts, steps)
        self._modes = modes_at(signal, np.arange(steps) * window.step, window.step)

    def move(self, k: int, phase: int, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        self.mode = int(self._modes[k])
        entry = self._table.index[k, phase]
        return self._table.Phi[entry] @ x + self._table.Gamma[entry] @ u

    def signal(self, end: float) -> SwitchingSignal:
        return self._signal

    def cuts(self) -> Cuts:
        return self._cuts


class RuleTruth(Truth):
    """A plant that switches by a rule."""

    def __init__(self, plant: SwitchedSystem, rule: Rule, window: Window, x0: np.ndarray) -> None:
        self._window = window
        self._motion = rule.motion(plant, (window.phase, window.step - window.phase))
        self._place = self._motion.place_of(x0)
        self._steps: list[int] = []
        self._offsets: list[float] = []
        self._modes = [self._motion.mode_of(self._place)]

    def move(self, k: int, phase: int, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        h, begin = self._window.step, self._window.phase if phase else 0.0
        if phase == 0:
            self.mode = self._modes[-1]
        elif begin == h:
            return x
        if self.chatter is not None or not np.abs(x).max() <= _FAR:
            return self._motion.hold(phase, x, self._place, u)
        move = self._motion.advance(phase, x, self._place, u)
        self._place = move.place
        for time, mode in zip(move.times.tolist(), move.modes.tolist(), strict=True):
            offset = begin + time
            self._steps.append(k if offset < h else k + 1)
            self._offsets.append(offset if offset < h else 0.0)
            self._modes.append(mode)
            # A switch within 1e-9 h after a sample counts as at it.
            if phase == 0 and offset <= TOLERANCE * h:
                self.mode = mode
        if move.chatter is not None:
            # Within 1e-9 h of a sample it begins there, as `DigitalRecord.locate` has it.
            time = k * h + begin + move.chatter.time
            ratio = snap(time / h)
            time = ratio * h if ratio == np.floor(ratio) else time
            self.chatter = move.chatter._replace(time=time)
        return move.x

    def signal(self, end: float) -> SwitchingSignal:
        h = self._window.step
        times, modes = [0.0], self._modes[:1]
        for k, offset, mode in zip(self._steps, self._offsets, self._modes[1:], strict=True):
            time = k * h + offset
            if time - times[-1] <= _SAME * h:
                modes[-1] = mode
            elif time < end:
                times.append(time)
                modes.append(mode)
        return SwitchingSignal(times, modes, end if end > times[-1] else np.inf)

    def cuts(self) -> Cuts:
        return Cuts(
            np.array(self._steps, np.int64),
            np.array(self._offsets, np.float64),
            np.array(self._modes, np.int64),
        )


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
    update: Update | None = None,
) -> Outcome:
    """Run a law along a signal or under a rule, period by period; `update` in its place."""
    window = grid.window
    if isinstance(switching, SwitchingSignal):
        age = initial_age(switching, window.step)
        truth = KnownTruth(plant, switching, window, grid.samples + window.count)
    else:
        age = 0
        truth = RuleTruth(plant, switching, window, x0)
    update = law.online(window.step) if update is None else update
    with np.errstate(over="ignore", invalid="ignore"):
        kept, states, at_phase, stop = _run(truth, update, age, x0, horizon, grid)
    total = kept + window.count - 1
    known = total * window.step + window.phase if truth.chatter is None else truth.chatter.time
    signal, cuts = truth.signal(known), truth.cuts()
    record = DigitalRecord(
        plant,
        window,
        cuts,
        PhaseTable.of(plant, window, cuts, total),
        states,
        at_phase,
        grid.inputs[: grid.past + kept],
        grid.past,
        kept,
    )
    end, diverged, note = (None, False, "") if stop is None else stop
    if truth.chatter is not None:
        note = _joined(note, truth, end)
    return Outcome(
        record, signal, lambda time: modes_at(signal, time, window.step), end, diverged, note
    )


def _run(
    truth: Truth, update: Update, age: int, x0: np.ndarray, horizon: float, grid: Grid
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
        if 0 < k < kept and not np.linalg.norm(x / LIMIT) <= 1.0:
            kept, stop = k, _Stop((k - 1) * h, True, "")
            continue
        at_phase[k] = truth.move(k, 0, x, inputs[now - ahead])
        if k < kept:
            age = age if last is None else age + 1 if truth.mode == last else 0
            last = truth.mode
            try:
                inputs[now] = update(x, inputs[:now], last, age)
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


def _joined(note: str, truth: Truth, end: float | None) -> str:
    """What to say about a plant that chatters, after what there is to say already."""
    time, _, reason = truth.chatter or (0.0, (), "")
    chattering = f"chattering at t = {time:.12g} s: {reason}"
    if time == end:
        return f"{chattering}; the run ends there."
    after = f"{chattering}; from there on the mismatch takes mode {truth.mode} to last."
    return f"{note} {after}".strip()
