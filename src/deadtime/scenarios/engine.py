"""The engine: tables of laws along signals, eight scenarios to a vector (`scenarios.kernel`)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from deadtime.feedback import Feedback
from deadtime.numerics.lanes import LANES
from deadtime.scenarios.figures import Figures, Path
from deadtime.scenarios.foreseen import NO_MODEL, Model
from deadtime.scenarios.kernel import run_scenarios
from deadtime.scenarios.layout import PERFECT, Plant, Rows, Run, Shape, Told
from deadtime.scenarios.loop import Loop
from deadtime.scenarios.model_ahead import ModelAhead
from deadtime.scenarios.records import Laid
from deadtime.scenarios.window_form import WindowForm, window_form
from deadtime.switching import SignalBatch

_KINDS = {"none": 0, "mode": 1, "mode_age": 2}
_NOTHING = np.zeros(0)


class Table(NamedTuple):
    """A law as `scenarios.kernel` takes it; `feedback` is what its rows are, where it has one."""

    shape: Shape
    rows: Rows
    model: Model
    feedback: Feedback | None


class Engine:
    """Runs tables along signals that are laid on a loop; holds nothing that changes."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        limits = loop.limits
        self._run = Run(
            loop.whole + 1,
            loop.rest / loop.window.step,
            loop.late,
            loop.x0,
            limits[0],
            limits[1].ravel(),
            limits[2].ravel(),
            loop.root.ravel(),
        )

    def table(self, feedback: Feedback) -> Table:
        """A law's rows as the compiled loop reads them."""
        form = window_form(feedback)
        if form is None:
            return Table(self._shape(1, 1, 1, dense=1), _dense_rows(feedback), NO_MODEL, feedback)
        rows, _, q = form.out.shape
        shape = self._shape(q, form.transition.shape[1], rows)
        return Table(shape, _factor_rows(feedback, form), NO_MODEL, feedback)

    def foresee(self, ahead: ModelAhead, signals: SignalBatch) -> Table:
        """What a law that knows these signals does, of each of them."""
        model = ahead.lay(signals)
        n, m = self._loop.plant.states, self._loop.plant.inputs
        rows = _unfactored(ahead.loop.sampled.longest_lag, m * max(m, n))
        shape = self._shape(1, 1, 1, foreseeing=1, entering=model.lags.size * m)
        return Table(shape, rows, model, None)

    def run(
        self,
        table: Table,
        laid: Laid,
        first: int = 0,
        count: int | None = None,
        told: Told = PERFECT,
    ) -> Figures:
        """Run a table along the scenarios first, …, first + count − 1, which hear `told`."""
        count = laid.scenarios - first if count is None else count
        return self._run_kernel(table, laid, first, count, told, _NOTHING, 0)

    def path(
        self,
        table: Table,
        laid: Laid,
        first: int,
        count: int,
        keep: int = 0,
        told: Told = PERFECT,
    ) -> tuple[Figures, Path]:
        """The same for up to eight of them, with states and inputs from sample `keep` on."""
        n, m = len(table.shape.x), len(table.shape.u)
        samples = self._run.samples - keep
        path = np.empty(samples * (n + m) * LANES)
        figures = self._run_kernel(table, laid, first, count, told, path, keep)
        both = path.reshape(samples, n + m, LANES).transpose(2, 1, 0)[:count]
        return figures, Path(both[:, :n], both[:, n:])

    def _run_kernel(
        self,
        table: Table,
        laid: Laid,
        first: int,
        count: int,
        told: Told,
        path: np.ndarray,
        keep: int,
    ) -> Figures:
        records, lags = laid.records, self._loop.acting.lags
        plant = Plant(lags, laid.maps, *records[:4], laid.age)
        shape = table.shape._replace(told=(0.0,) * int(told.sample.size > 0))
        law = shape, table.rows, table.model
        return Figures(*run_scenarios(*law, plant, self._run, told, first, count, path, keep))

    def _shape(
        self,
        order: int,
        block: int,
        rows: int,
        dense: int = 0,
        foreseeing: int = 0,
        entering: int | None = None,
    ) -> Shape:
        plant, wide = self._loop.plant, self._loop.acting.wide
        n, m = plant.states, plant.inputs
        entering = m if entering is None else entering
        sizes = n, m, n + m, wide - n, wide, order, block, rows * m, m * (n + m)
        model = n * n, entering, n + entering, 2 * m
        flags = dense, int(len(self._loop.actuators) > 0), foreseeing, 0
        return Shape(*((0.0,) * size for size in (*sizes, *model, *flags)))


def _factor_rows(feedback: Feedback, form: WindowForm) -> Rows:
    flat: list[Any] = [part.ravel() for part in (feedback.state_gain, *form)]
    state, out, transition, enter, last, ahead, behind = map(np.ascontiguousarray, flat)
    parts = state, out, last, transition, enter, ahead, behind
    kind = _KINDS[feedback.context]
    length, taps = form.ahead.shape[0], feedback.taps
    return Rows(length, taps, *parts, _NOTHING, _NOTHING, 0, kind, 1)


def _dense_rows(feedback: Feedback) -> Rows:
    """Dense rows, the latest input beside F, the others padded to whole vectors."""
    taps, (rows, m, n) = feedback.taps, feedback.state_gain.shape
    width = max(1, -(-(taps - 1) * m // LANES)) * LANES
    dense = _zeros_on_cache_lines(rows * m * width).reshape(rows, m, width)
    G = feedback.latest_first
    head = np.concatenate((feedback.state_gain, G[:, :, :m]), axis=2)
    dense[:, :, : (taps - 1) * m] = G[:, :, m:]
    kind = _KINDS[feedback.context]
    return _unfactored(taps, m * max(m, n))._replace(
        head=head.ravel(), dense=dense.ravel(), width=width, kind=kind, ages=feedback.ages
    )


def _unfactored(taps: int, size: int) -> Rows:
    """Rows with nothing of a factorised law: the code for it is there, and never run."""
    unused: list[Any] = [np.zeros(size)] * 7
    return Rows(0, taps, *unused, head=_NOTHING, dense=_NOTHING, width=0, kind=0, ages=1)


def _zeros_on_cache_lines(size: int) -> np.ndarray:
    """Zeros of which every eighth begins a cache line: a vector across two costs twice as much."""
    room = np.zeros(size + LANES)
    skip = -(room.ctypes.data // room.itemsize) % LANES
    return room[skip : skip + size]
