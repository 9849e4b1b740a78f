"""The digital loop period by period: a rule switches the plant, or Python must be called.

That is a law without a table, or a sensor or actuator written by the user: an `ImperfectLaw` senses
and acts through these. A rule's switches are recorded as they occur and make the run's switching
signal; while the plant slides along a boundary, the mode is the one before. A plant that chatters
has no trajectory from there on: the run ends, and the mode is held only for the mismatch before.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from deadtime.base.errors import ChatteringError
from deadtime.feedback.belief import UpdateWithBelief
from deadtime.feedback.law import Update, UpdateWithEstimates, require_input
from deadtime.feedback.table import age_after
from deadtime.imperfections import (
    ActuatorImperfection,
    Imperfection,
    Seen,
    SensorImperfection,
    Sizes,
)
from deadtime.loop.received_samples import MeasurementLags, is_held, lags_of_run, tells_commands
from deadtime.plant.discretisation import snap
from deadtime.simulation.digital import LawSignals, RunOutcome
from deadtime.simulation.digital_record import slides_in_words
from deadtime.simulation.loop_arrays import LIMIT
from deadtime.simulation.truth import Truth


class ImperfectLaw:
    """An `Update` that senses and acts through imperfections.

    Where nothing usable arrives and the law returns no number, the last command is held. Mode 0 is
    assumed until a mode is reported. The law's past inputs are those applied, or with
    predict = "commanded" its commands. A law on outputs receives y = C_σ x, C = `outputs`.

    Attributes
    ----------
    update : Update
        The law.
    lags : MeasurementLags or None
        How long before each sample its state is measured.
    measured : (samples, n) or (samples, p)
        x or y as received, NaN where nothing arrived.
    commanded : (samples, m)
    """

    def __init__(
        self,
        update: Update,
        sizes: Sizes,
        pairs: Sequence[tuple[Imperfection, np.random.Generator]],
        predict: str,
        samples: int,
        outputs: np.ndarray | None = None,
    ) -> None:
        self._tells_commands = tells_commands(predict)
        self._outputs = outputs
        self._sensors = [
            each.sensor(sizes, rng) for each, rng in pairs if isinstance(each, SensorImperfection)
        ]
        self._actuators = [
            each.actuator(sizes) for each, _ in pairs if isinstance(each, ActuatorImperfection)
        ]
        self.lags = MeasurementLags.of_run(pairs, sizes, samples)
        self.update = update
        self._line: np.ndarray | None = None
        self._mode, self._age = -1, 0
        self.measured: list[np.ndarray] = []
        self.commanded: list[np.ndarray] = []

    def __call__(self, x: np.ndarray, past: np.ndarray, mode: int, age: int) -> np.ndarray:
        seen = Seen(x if self._outputs is None else self._outputs[mode] @ x, mode)
        for sense in self._sensors:
            seen = sense(seen)
        # The age first: it is counted from the mode of the sample before.
        self._age = age if self._mode < 0 else age_after(self._mode, self._age, seen.mode)
        self._mode = self._mode if seen.mode < 0 else seen.mode
        if self._line is None:
            self._line = past.copy()
        known = self._line if self._tells_commands else past
        u = require_input(self.update(seen.x, known, max(self._mode, 0), self._age), past.shape[1])
        if is_held(seen.x, u):
            u = self.commanded[-1] if self.commanded else known[-1].copy()
        # Before the actuators: with predict = "commanded" the law reads its own commands.
        self._line[:-1] = self._line[1:]
        self._line[-1] = u
        self.measured.append(seen.x)
        self.commanded.append(u)
        for act in self._actuators:
            u = act(u, past[-1])
        return u

    def record(self, kept: int) -> LawSignals:
        """The measurements and commands at the first `kept` samples."""
        estimates = self.update.estimates if isinstance(self.update, UpdateWithEstimates) else None
        return LawSignals(
            np.array(self.measured[:kept]),
            np.array(self.commanded[:kept]),
            None if estimates is None else np.array(estimates[:kept]),
        )


class _Stop(NamedTuple):
    """Why and when a run ended before its horizon."""

    end: float
    diverged: bool
    note: str


def run_online(update: Update, truth: Truth, x0: np.ndarray, horizon: float) -> RunOutcome:
    """Run a law, or an `ImperfectLaw` around it, along a signal or under a rule, by periods."""
    imperfect = update if isinstance(update, ImperfectLaw) else None
    law = update if imperfect is None else imperfect.update
    sampled, step = truth.grid.sampled, truth.grid.sampled.step
    with np.errstate(over="ignore", invalid="ignore"):
        kept, path, stop = _run(
            truth, update, None if imperfect is None else imperfect.lags, x0, horizon
        )
    # The signal is known as long as no mode reads an input that is missing.
    known = (kept + sampled.windows[0].count - 1) * step + sampled.windows[0].phase
    record = truth.record(np.array(path), kept)
    end, diverged, note = (None, False, "") if stop is None else stop
    if record.slides is not None:
        slid = slides_in_words(record.slides.slides(step, horizon if end is None else end))
        note = f"{note} {slid}".strip()
    if truth.chatter is not None:
        known, _, reason = truth.chatter
        chattering = f"chattering at t = {known:.12g} s: {reason}"
        if known == end:
            note = f"{chattering}; the run ends there."
        else:
            after = f"from there on the mismatch takes mode {truth.mode} to last."
            note = f"{note} {chattering}; {after}".strip()
    return RunOutcome(
        record,
        truth.signal(known),
        end,
        diverged,
        note,
        None if imperfect is None else imperfect.record(kept),
        np.array(law.beliefs[:kept]) if isinstance(law, UpdateWithBelief) else None,
    )


def _run(
    truth: Truth, update: Update, lags: MeasurementLags | None, x0: np.ndarray, horizon: float
) -> tuple[int, list[np.ndarray], _Stop | None]:
    """Run over the samples and on until an input is missing, as `closed_loop` does.

    It calls Python at every sample, so that there is nothing to compile, and steps of `loop/` run
    within `update`.
    """
    grid, age = truth.grid, truth.age
    h, kept, past, inputs = grid.sampled.step, grid.samples, grid.past, grid.inputs
    path, first = [x0], [0]
    measured = None
    if lags is not None:
        measured = [part.tolist() for part in lags_of_run(np.arange(kept), lags, h)]
    stop, last = None, None
    for k in range(grid.periods):
        x, now = path[-1], past + k
        if 0 < k < kept and not x @ x <= LIMIT * LIMIT:
            kept, stop = k, _Stop((k - 1) * h, True, "")
        for piece, acting in enumerate(truth.lags(k)):
            if k - acting.min() >= kept:
                return kept, path, stop
            path.append(truth.move(k, piece, path[-1], grid.acting(k, acting)))
            # After the first piece, in which this sample's input does not act, as D > 0: a rule may
            # switch within 1e-9 of a period after the sample, which counts as at the sample.
            if piece == 0 and k < kept:
                age = age_after(-1 if last is None else last, age, truth.mode)
                last = truth.mode
                seen = x
                if measured is not None:
                    j, offset = k - measured[0][k], measured[1][k]
                    if j > k:
                        seen = np.full(x.size, np.nan)
                    else:
                        seen = truth.within(j, offset, path) if offset else path[first[j]]
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
            kept = min(kept, int(snap(truth.chatter.time / h)) + 1)
            stop = _Stop(truth.chatter.time, False, "")
    return kept, path, stop
