"""The engine: tables of laws along signals, eight scenarios to a vector (`scenarios.lane_loop`).

Factorised rows are brought into the form that costs least per period. The factorisation
G_{c,j} = H_c S^{j−1} Γ_s leaves the basis open: H T, T⁻¹ S T, T⁻¹ Γ_s is the same table. In the
basis of its eigenvectors S is diagonal, or has 2 × 2 blocks for pairs of complex ones, which saves
most of the work. A basis is judged not by its condition number but by the taps that it gives, which
are compared with the table's own.

For a law that knows the signal its model is sampled along signals, up to the end of its preview.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import read_only
from deadtime.feedback import Factor, Feedback, Preview
from deadtime.feedback.belief import BankForm, Belief
from deadtime.feedback.law import Law
from deadtime.feedback.memory import Memory
from deadtime.imperfections import Sizes
from deadtime.imperfections.sensors_and_actuators import InputLimits
from deadtime.numerics.lanes import LANES, KnownNumbers
from deadtime.plant import SampledPlant
from deadtime.scenarios.batch_loop import Loop
from deadtime.scenarios.by_period import compose_cuts
from deadtime.scenarios.lane_loop import FIGURES, run_scenarios, work_of
from deadtime.scenarios.lane_types import (
    Dense,
    Factored,
    LoopSizes,
    MeasurementLanes,
    PlantLanes,
    RunLanes,
)
from deadtime.scenarios.law_lanes import KnownSignalModel, PreviewLanes
from deadtime.scenarios.periods import Records, SignalPeriods, compose, parts_of
from deadtime.scenarios.scenario_sums import Path, ScenarioSums
from deadtime.scenarios.side_by_side import groups
from deadtime.scenarios.state_lanes import ObserverLanes, OutputLanes, belief_lanes
from deadtime.switching import SignalBatch, SwitchingSignal

# Of the largest entry of a tap. Powers of S of a long window differ by a rounding per factor with
# the order of the products, so that a window of more than 900 inputs is given one per input.
ACCURACY, _PER_INPUT = 2e-13, float(np.finfo(float).eps)
_MOST_ROWS, _MOST_ORDER = 4, 48  # beyond, dense rows cost less than factorised straight-line code


class WindowForm(NamedTuple):
    """Factorised taps for a window of `length` = N − 1 inputs, and the last tap.

    out : H (rows, m, q);  transition : the blocks of S, (q / size, size, size);
    enter : Γ_s (q, m);  last : G_N (rows, m, m);
    ahead : S^{W−1−i} Γ_s (W, q, m);  behind : H S^r (W, rows, m, q);
    """

    out: Float[np.ndarray, "row m q"]
    transition: Float[np.ndarray, "block size size"]
    enter: Float[np.ndarray, "q m"]
    last: Float[np.ndarray, "row m m"]
    ahead: Float[np.ndarray, "W q m"]
    behind: Float[np.ndarray, "W row m q"]


def window_form(feedback: Feedback) -> WindowForm | None:
    """The cheapest form whose taps are the table's to `ACCURACY`; None if there is none.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> form = window_form(problem.laws["averaged"].digital(0.01))
    >>> form.transition.shape[1], form.out.shape, form.ahead.shape
    (1, (1, 1, 4), (99, 4, 1))
    """
    rows, taps, m, _ = feedback.input_gain.shape
    if feedback.context not in ("none", "mode") or rows > _MOST_ROWS:
        return None
    if taps == 1 or not feedback.input_gain.any():
        last = feedback.input_gain[:, -1]
        nothing = Factor(np.zeros((rows, m, 1)), np.zeros((1, 1)), np.zeros((1, m)), last)
        return _form(nothing, 1, 1)
    factor = feedback.factor
    if factor is None or factor.S.shape[0] > _MOST_ORDER:
        return None
    for candidate, size in _candidates(factor):
        form = _form(candidate, size, taps - 1)
        if _fits(form, feedback):
            return form
    return None


def _candidates(factor: Factor) -> list[tuple[Factor, int]]:
    """The factorisation in the modal and in its own basis, with the sizes of the blocks of S.

    The modal basis is first: its blocks are the smallest, where round-off lets it pass.
    """
    S, q = factor.S, factor.S.shape[0]
    sizes = [size for size in range(1, q + 1) if q % size == 0]
    size = next(s for s in sizes if not (S * (1.0 - _blocks_of_ones(q, s))).any())
    modal = _modal(factor)
    return [(factor, size)] if modal is None else [modal, (factor, size)]


def _blocks_of_ones(q: int, size: int) -> np.ndarray:
    return np.kron(np.eye(q // size), np.ones((size, size)))


def _modal(factor: Factor) -> tuple[Factor, int] | None:
    """The factorisation in the real eigenvectors of S, complex pairs as real and imaginary part."""
    values, vectors = np.linalg.eig(factor.S)
    real, imaginary = np.real(vectors), np.imag(vectors)
    single, pairs = np.flatnonzero(np.imag(values) == 0.0), np.flatnonzero(np.imag(values) > 0.0)
    if pairs.size == 0:
        size, basis = 1, real
    # With blocks of two for complex pairs, real eigenvalues must pair up as well.
    elif single.size % 2 == 0:
        size = 2
        columns = [real[:, single], *(np.stack((real[:, p], imaginary[:, p]), 1) for p in pairs)]
        basis = np.column_stack(columns)
    else:
        return None
    try:
        inverse = np.linalg.inv(basis)
    except np.linalg.LinAlgError:
        return None
    S = inverse @ factor.S @ basis
    # Round-off beside the blocks, which the kernel never reads, must not count in the check either.
    S = S * _blocks_of_ones(S.shape[0], size)
    return Factor(factor.H @ basis, S, inverse @ factor.input, factor.last), size


def _form(factor: Factor, size: int, length: int) -> WindowForm:
    q = factor.S.shape[0]
    ahead, behind = np.empty((length, *factor.input.shape)), np.empty((length, *factor.H.shape))
    column, row = factor.input, factor.H
    for i in range(length):
        ahead[length - 1 - i], behind[i] = column, row
        column, row = factor.S @ column, row @ factor.S
    blocks = [factor.S[i : i + size, i : i + size] for i in range(0, q, size)]
    return WindowForm(factor.H, np.array(blocks), factor.input, factor.last, ahead, behind)


def _fits(form: WindowForm, feedback: Feedback) -> bool:
    """Whether the taps of the form are the table's, by both of the products that the loop uses."""
    taps = feedback.input_gain
    W = taps.shape[1] - 1
    forwards = np.einsum("cmq,jqp->cjmp", form.out, form.ahead[::-1])
    backwards = np.einsum("jcmq,qp->cjmp", form.behind, form.enter)
    scale = np.abs(taps[:, :W]).max(axis=(0, 2, 3))[None, :, None, None]
    tolerance = max(ACCURACY, W * _PER_INPUT)
    for found in (forwards, backwards):
        error = np.abs(found - taps[:, :W])
        if not np.isfinite(found).all() or (error > tolerance * scale).any():
            return False
    return True


class ModelAhead:
    """The model of a law over the periods 0, …, K + W, W = ⌊D/h⌋ (`scenarios.law_lanes`).

    Attributes
    ----------
    loop : Loop
        The maps of the model's periods; its x0 and weight are not used.
    """

    def __init__(self, law: Law, sampled: SampledPlant, samples: int) -> None:
        window, n = sampled.window, sampled.plant.states
        self._law, self._step, self._samples = law, window.step, samples
        self._preview = self._preview_along(SwitchingSignal.constant(0))
        whole = window.phase >= window.step
        self._length = window.count if whole else window.count - 1
        self._rest = 0.0 if whole else window.phase
        self.loop = Loop(sampled, np.zeros(n), (samples - 1 + self._length) * window.step)

    def sample_signals(self, signals: SignalBatch) -> KnownSignalModel:
        """The model along signals; an error if one ends before the preview does."""
        self._preview_along(signals[int(signals.end.argmin())])
        return self._own if self._law.previewed is not None else self._sample_signals(signals)

    @cached_property
    def _own(self) -> KnownSignalModel:
        """The model along the signal that the law was given, the same in all scenarios."""
        assert self._law.previewed is not None
        return self._sample_signals(SignalBatch.of([self._law.previewed]))

    def without_signals(self) -> KnownSignalModel:
        """The model along no signals, to compile the loop without `sample_signals`."""
        return self._model(self.loop.without_signals(), read_only(np.zeros(0, np.int64)))

    def _sample_signals(self, signals: SignalBatch) -> KnownSignalModel:
        return self._model(self.loop.sample_signals(signals), signals.modes)

    def _model(
        self, by_period: SignalPeriods, sampled: Int[np.ndarray, " sojourn"]
    ) -> KnownSignalModel:
        loop, records = self.loop, by_period.records
        tails = np.concatenate((self._own_tails, self._tails_of_cuts(records, sampled)))
        first, step, which = records.first, records.step, records.map
        return KnownSignalModel(
            self._length, loop.acting.lags, by_period.maps, first, step, which, tails
        )

    def _tails_of_cuts(
        self, records: Records, sampled: Int[np.ndarray, " sojourn"]
    ) -> Float[np.ndarray, "cut tail"]:
        """[K M, L] of cut periods: M moves x over the rest of the delay, K is the gain there."""
        loop, tables = self.loop, self.loop.tables
        assert tables is not None
        n, m, wide = loop.plant.states, loop.plant.inputs, loop.acting.wide
        last, cuts = records.sojourn.astype(np.int64), records.sojourn.size
        # The last sojourn that has begun by t_k + D, in all cut periods at once.
        begun = last + 1 < records.until
        while begun.any():
            begun[begun] = records.at[last[begun] + 1] <= self._rest
            last += begun
            begun &= last + 1 < records.until
        moves = np.eye(n, wide)[None]
        if self._rest > 0.0:
            maps, end = np.empty((cuts, tables.width)), np.full(cuts, self._rest)
            given = end, records, sampled, loop.acting, tables.pieces, loop.step
            compose_cuts(maps, np.arange(cuts), last + 1, *given)
            moves = maps[:, : n * wide].reshape(cuts, n, wide)
        gains, tails = self._preview.gains[sampled[last]], np.zeros((cuts, m, n + m))
        tails[:, :, n:] += self._preview.latest
        for j in range(n):
            tails += gains[:, :, j, None] * moves[:, None, j, : n + m]
        return tails.reshape(cuts, m * (n + m))

    def _preview_along(self, signal: SwitchingSignal) -> Preview:
        found = self._law.preview(self._step, signal, self._samples)
        assert found is not None
        return found

    @cached_property
    def _own_tails(self) -> np.ndarray:
        """[K M, L] of periods in one mode, as in `_tails_of_cuts`."""
        loop, plant = self.loop, self.loop.plant
        n, m, tails = plant.states, plant.inputs, []
        # Over no time `parts_of` gives no parts, and M = [I 0].
        periods = [parts_of(loop.acting, i, 0.0, self._rest) for i in range(plant.modes)]
        moves = np.tile(np.eye(n, loop.acting.wide), (plant.modes, 1, 1))
        if self._rest > 0.0:
            moves = compose(plant, loop.acting, periods, loop.acting.wide).move
        for K, move in zip(self._preview.gains, moves, strict=True):
            tail = K @ move[:, : n + m]
            tail[:, n:] += self._preview.latest
            tails.append(tail.ravel())
        return np.array(tails)


_NOTHING = np.zeros(0)
PERFECT = MeasurementLanes()


class EngineTable(NamedTuple):
    """A law as `scenarios.lane_loop` takes it: `factored`, `dense` or `model`, and its state.

    taps : how many past inputs it reads
    feedback : the table whose rows follow the reported modes, None if they do not
    outputs : (modes, p, n), the plant's C if outputs are measured
    gains : (rows, m, n), F of the rows that a belief weighs
    """

    shape: LoopSizes
    factored: Factored | None = None
    dense: Dense | None = None
    model: KnownSignalModel | None = None
    memory: Memory | None = None
    belief: Belief | None = None
    bank: BankForm | None = None
    taps: int = 0
    feedback: Feedback | None = None
    outputs: np.ndarray | None = None
    gains: np.ndarray | None = None

    @property
    def measured(self) -> int:
        """Size of a measurement."""
        return self.shape.seen


class Engine:
    """Runs tables along signals on the grid of a loop; immutable, shared by threads."""

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
            return EngineTable(shape, dense=_dense(feedback), taps=taps, feedback=feedback)
        rows, _, q = form.out.shape
        shape = replace(self._shape, b=q, block=form.transition.shape[1], rows=rows * m)
        own = _factored(feedback, form)
        return EngineTable(shape, factored=own, taps=taps, feedback=feedback)

    def on_observer(
        self, feedback: Feedback, memory: Memory, outputs: Float[np.ndarray, "mode p n"]
    ) -> EngineTable:
        """The rows of a law on its observer of y = C_σ x, `outputs` being the plant's C."""
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

    def on_belief(self, feedback: Feedback, belief: Belief) -> EngineTable:
        """The rows of a law weighed by a belief."""
        gains = feedback.state_gain
        return self.table(feedback)._replace(belief=belief, feedback=None, gains=gains)

    def on_bank(
        self, feedback: Feedback, bank: BankForm, outputs: Float[np.ndarray, "mode p n"]
    ) -> EngineTable:
        """The rows of a law weighed by a belief from y = C_σ x, `outputs` being the plant's C."""
        table, (_, p, n) = self.on_belief(feedback, bank.chain), outputs.shape
        shape = replace(table.shape, seen=p, output=p, kept=n)
        return table._replace(shape=shape, bank=bank, outputs=outputs)

    def along(self, law: EngineTable | ModelAhead, signals: SignalBatch) -> EngineTable:
        """The table of a law along signals."""
        if isinstance(law, EngineTable):
            return law
        return self._with_preview(law, law.sample_signals(signals))

    def compile(self, law: EngineTable | ModelAhead) -> None:
        """Compile the loop under a law that receives every sample: run it along no signals."""
        if isinstance(law, ModelAhead):
            law = self._with_preview(law, law.without_signals())
        self.run(law, self._loop.without_signals())

    def _with_preview(self, ahead: ModelAhead, model: KnownSignalModel) -> EngineTable:
        entering = model.lags.size * self._loop.plant.inputs
        shape = replace(self._shape, entering=entering)
        return EngineTable(shape, model=model, taps=ahead.loop.sampled.longest_lag)

    def run(
        self,
        table: EngineTable,
        by_period: SignalPeriods,
        first: int = 0,
        count: int | None = None,
        measurements: MeasurementLanes = PERFECT,
        force: np.ndarray | None = None,
    ) -> ScenarioSums:
        """Run a table along scenarios first, …, first + count − 1 with these data and forces."""
        count = by_period.scenarios - first if count is None else count
        return self._run_kernel(table, by_period, first, count, measurements, force, _NOTHING, 0)

    def path(
        self,
        table: EngineTable,
        by_period: SignalPeriods,
        first: int,
        count: int,
        measurements: MeasurementLanes = PERFECT,
        force: np.ndarray | None = None,
        keep: int = 0,
        room: np.ndarray = _NOTHING,
    ) -> tuple[ScenarioSums, Path]:
        """Run as `run` does, with states and inputs from sample `keep` on, in `room` if it fits.

        New memory costs about as much as a run of a few scenarios.
        """
        n, m = table.shape.x, table.shape.u
        shape = groups(count), self._run.samples - keep, n + m, LANES
        size = math.prod(shape)
        path = room[:size] if room.size >= size else np.empty(size)
        figures = self._run_kernel(table, by_period, first, count, measurements, force, path, keep)
        return figures, Path(path.reshape(shape), count, n)

    def _run_kernel(
        self,
        table: EngineTable,
        by_period: SignalPeriods,
        first: int,
        count: int,
        measurements: MeasurementLanes,
        force: np.ndarray | None,
        path: np.ndarray,
        keep: int,
    ) -> ScenarioSums:
        records, lags = by_period.records, self._loop.acting.lags
        plant = PlantLanes(lags, by_period.maps, *records[:4], by_period.age)
        loop = plant, self._run, self._limits, *measurements, force
        law, shape, samples = table.factored, table.shape, self._run.samples
        carry = 0 if law is None else max(1, min(law.length, samples)) * shape.rows
        work = work_of(shape, plant, self._run, table.taps, carry, count)
        ahead = None if table.model is None else PreviewLanes.of(shape, table.model)
        kept = None if table.memory is None else ObserverLanes.of(table.memory)
        beliefs = None
        if table.belief is not None and table.gains is not None:
            beliefs = belief_lanes(shape, table.belief, table.bank, table.gains)
        outputs = None if table.outputs is None else OutputLanes.of(table.outputs)
        # The fields up to `taps` are the law's arguments, in the order of `run_scenarios`.
        room = work, ahead, kept, beliefs, outputs
        run_scenarios(*table[:8], *loop, first, count, path, keep, *room)
        # The last two are exponents, which the kernel has added to the logarithms.
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
    """Zeros of which every eighth begins a cache line: a vector across two takes twice as long."""
    room = np.zeros(size + LANES)
    skip = -(room.ctypes.data // room.itemsize) % LANES
    return room[skip : skip + size]
