"""The engine: tables of laws along signals, eight scenarios to a vector (`scenarios.lane_loop`)."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import read_only
from deadtime.feedback import Feedback
from deadtime.feedback.belief import BankForm, Belief
from deadtime.feedback.memory import Memory
from deadtime.imperfections import Sizes
from deadtime.imperfections.sensors_and_actuators import InputLimits
from deadtime.numerics.lanes import LANES, KnownNumbers
from deadtime.scenarios.batch_loop import Loop
from deadtime.scenarios.belief_memory import belief_lanes
from deadtime.scenarios.lane_loop import FIGURES, run_scenarios, work_of
from deadtime.scenarios.lane_types import (
    Dense,
    Factored,
    Hearing,
    LoopSizes,
    PlantLanes,
    RunLanes,
)
from deadtime.scenarios.model_ahead import ModelAhead
from deadtime.scenarios.observer_memory import ObserverLanes, OutputLanes
from deadtime.scenarios.preview_lanes import KnownSignalModel, PreviewLanes
from deadtime.scenarios.records import Laid
from deadtime.scenarios.scenario_sums import Path, ScenarioSums
from deadtime.scenarios.side_by_side import groups
from deadtime.scenarios.window_form import WindowForm, window_form
from deadtime.switching import SignalBatch

_NOTHING = np.zeros(0)
PERFECT = Hearing()


class EngineTable(NamedTuple):
    """A law as `scenarios.lane_loop` takes it: one of three, its memory or belief, its window.

    `taps` is how many inputs it reads, and `feedback` what its rows are, where it has some and goes
    by the modes that it is told; `outputs` the plant's C where these are measured, and `gains`
    (rows, m, n) what its rows make of the state where a belief weighs them.
    """

    shape: LoopSizes
    factored: Factored | None
    dense: Dense | None
    model: KnownSignalModel | None
    memory: Memory | None
    belief: Belief | None
    bank: BankForm | None
    taps: int
    feedback: Feedback | None
    outputs: np.ndarray | None = None
    gains: np.ndarray | None = None

    @property
    def measured(self) -> int:
        """How many numbers the law measures."""
        return self.shape.seen


class Engine:
    """Runs tables along signals that are laid on a loop; holds nothing that changes."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        x0, root = read_only(loop.x0), read_only(loop.root.ravel())  # one type
        self._run = RunLanes(loop.whole + 1, loop.rest / loop.step, loop.late, x0, root)
        limits = InputLimits.of(loop.actuators, Sizes.of(loop.plant, loop.step))
        self._limits = limits if limits.relative.size else None
        n, m, wide = loop.plant.states, loop.plant.inputs, loop.acting.wide
        inputs = loop.acting.lags.size * m
        sizes = n, m, n + m, inputs, wide - n, wide, 2 * m, wide - n - inputs, n, n
        self._shape = LoopSizes(*sizes)

    def table(self, feedback: Feedback) -> EngineTable:
        """A law's rows as the compiled loop reads them."""
        form, taps = window_form(feedback), feedback.taps
        _, m, n = feedback.state_gain.shape
        if form is None:
            shape = replace(self._shape, head=m * (n + m))
            return EngineTable(
                shape, None, _dense(feedback), None, None, None, None, taps, feedback
            )
        rows, _, q = form.out.shape
        block = form.transition.shape[1]
        shape = replace(self._shape, b=q, block=block, rows=rows * m)
        own = _factored(feedback, form)
        return EngineTable(shape, own, None, None, None, None, None, taps, feedback)

    def remember(
        self, feedback: Feedback, memory: Memory, outputs: Float[np.ndarray, "mode p n"]
    ) -> EngineTable:
        """The rows of a law on what it remembers of y = C_σ x, `outputs` being the plant's C."""
        table, (_, p, _) = self.table(feedback), outputs.shape
        z = memory.start.size
        shape = replace(
            table.shape, both=z + self._loop.plant.inputs, seen=p, known=z, kept=z, output=p
        )
        taps = max(table.taps, int(memory.lag.max()))
        sizes: Any = KnownNumbers(memory.sizes._asdict())
        return table._replace(
            shape=shape, memory=memory._replace(sizes=sizes), taps=taps, outputs=outputs
        )

    def believe(self, feedback: Feedback, belief: Belief) -> EngineTable:
        """The rows of a law weighed by a belief."""
        gains = feedback.state_gain
        return self.table(feedback)._replace(belief=belief, feedback=None, gains=gains)

    def estimate(
        self, feedback: Feedback, bank: BankForm, outputs: Float[np.ndarray, "mode p n"]
    ) -> EngineTable:
        """The rows of a law weighed by a belief from y = C_σ x, `outputs` being the plant's C."""
        table, (_, p, n) = self.believe(feedback, bank.chain), outputs.shape
        shape = replace(table.shape, seen=p, output=p, kept=n)
        return table._replace(shape=shape, bank=bank, outputs=outputs)

    def foresee(self, ahead: ModelAhead, signals: SignalBatch) -> EngineTable:
        """What a law that knows these signals does, of each of them."""
        return self._foreseeing(ahead, ahead.lay(signals))

    def along(self, law: EngineTable | ModelAhead, signals: SignalBatch) -> EngineTable:
        """What a law does, along signals."""
        return law if isinstance(law, EngineTable) else self.foresee(law, signals)

    def compile(self, law: EngineTable | ModelAhead) -> None:
        """Compile the loop under a law that hears everything: run it along no signals."""
        table = law if isinstance(law, EngineTable) else self._foreseeing(law, law.lay_nothing())
        self.run(table, self._loop.lay_nothing())

    def _foreseeing(self, ahead: ModelAhead, model: KnownSignalModel) -> EngineTable:
        entering = model.lags.size * self._loop.plant.inputs
        shape = replace(self._shape, entering=entering)
        taps = ahead.loop.sampled.longest_lag
        return EngineTable(shape, None, None, model, None, None, None, taps, None)

    def run(
        self,
        table: EngineTable,
        laid: Laid,
        first: int = 0,
        count: int | None = None,
        hearing: Hearing = PERFECT,
        force: np.ndarray | None = None,
    ) -> ScenarioSums:
        """Run a table along the scenarios first, …, first + count − 1 which hear and feel this."""
        count = laid.scenarios - first if count is None else count
        return self._run_kernel(table, laid, first, count, hearing, force, _NOTHING, 0)

    def path(
        self,
        table: EngineTable,
        laid: Laid,
        first: int,
        count: int,
        hearing: Hearing = PERFECT,
        force: np.ndarray | None = None,
        keep: int = 0,
        room: np.ndarray = _NOTHING,
    ) -> tuple[ScenarioSums, Path]:
        """The same with states and inputs from sample `keep` on, laid in `room` where that does.

        New memory costs about as much as a run of a few scenarios.
        """
        n, m = table.shape.x, table.shape.u
        shape = groups(count), self._run.samples - keep, n + m, LANES
        size = math.prod(shape)
        path = room[:size] if room.size >= size else np.empty(size)
        figures = self._run_kernel(table, laid, first, count, hearing, force, path, keep)
        return figures, Path(path.reshape(shape), count, n)

    def _run_kernel(
        self,
        table: EngineTable,
        laid: Laid,
        first: int,
        count: int,
        hearing: Hearing,
        force: np.ndarray | None,
        path: np.ndarray,
        keep: int,
    ) -> ScenarioSums:
        records, lags = laid.records, self._loop.acting.lags
        plant = PlantLanes(lags, laid.maps, *records[:4], laid.age)
        loop = plant, self._run, self._limits, *hearing, force
        law, shape, samples = table.factored, table.shape, self._run.samples
        carry = 0 if law is None else max(1, min(law.length, samples)) * shape.rows
        work = work_of(shape, plant, self._run, table.taps, carry, count)
        ahead = None if table.model is None else PreviewLanes.of(shape, table.model)
        kept = None if table.memory is None else ObserverLanes.of(table.memory)
        mind = None
        if table.belief is not None and table.gains is not None:
            mind = belief_lanes(shape, table.belief, table.bank, table.gains)
        outputs = None if table.outputs is None else OutputLanes.of(table.outputs)
        room = work, ahead, kept, mind, outputs
        run_scenarios(*table[:8], *loop, first, count, path, keep, *room)
        figures = work.figures.reshape(-1, FIGURES + 2, LANES).transpose(1, 0, 2)
        return ScenarioSums(*figures.reshape(FIGURES + 2, -1)[:FIGURES, :count])


def _factored(feedback: Feedback, form: WindowForm) -> Factored:
    flat: list[Any] = [part.ravel() for part in (feedback.state_gain, *form)]
    state, out, transition, enter, last, ahead, behind = map(read_only, flat)  # one type
    length = form.ahead.shape[0]
    return Factored(length, state, out, last, transition, enter, ahead, behind)


def _dense(feedback: Feedback) -> Dense:
    """Dense rows, the latest input beside F, the others padded to whole vectors."""
    taps, (rows, m, _) = feedback.taps, feedback.state_gain.shape
    width = max(1, -(-(taps - 1) * m // LANES)) * LANES
    rest = _zeros_on_cache_lines(rows * m * width).reshape(rows, m, width)
    G = feedback.latest_first
    head = np.concatenate((feedback.state_gain, G[:, :, :m]), axis=2)
    rest[:, :, : (taps - 1) * m] = G[:, :, m:]
    return Dense(taps, head.ravel(), rest.ravel(), width, feedback.apart, feedback.ages)


def _zeros_on_cache_lines(size: int) -> np.ndarray:
    """Zeros of which every eighth begins a cache line: a vector across two costs twice as much."""
    room = np.zeros(size + LANES)
    skip = -(room.ctypes.data // room.itemsize) % LANES
    return room[skip : skip + size]
