"""The engine: tables of laws along signals, eight scenarios to a vector (`scenarios.kernel`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from deadtime.feedback import Feedback
from deadtime.numerics.lanes import LANES
from deadtime.scenarios.figures import Figures, Path
from deadtime.scenarios.kernel import Plant, Rows, Run, Shape, run_scenarios
from deadtime.scenarios.loop import Laid, Loop
from deadtime.scenarios.window_form import WindowForm, window_form

_KINDS = {"none": 0, "mode": 1, "mode_age": 2, "step": 3}
_NOTHING = np.zeros(0)


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

    def table(self, feedback: Feedback) -> tuple[Shape, Rows]:
        """A law's rows as the compiled loop reads them."""
        form = window_form(feedback)
        if form is None:
            return self._shape(1, 1, 1, dense=True), _dense([feedback])
        rows, _, q = form.out.shape
        return self._shape(q, form.transition.shape[1], rows), _factor_rows(feedback, form)

    def tables(self, feedbacks: Sequence[Feedback]) -> tuple[Shape, Rows]:
        """Rows per sample, one table for each of up to eight scenarios."""
        return self._shape(1, 1, 1, dense=True), _dense(feedbacks)

    def run(
        self, table: tuple[Shape, Rows], laid: Laid, first: int = 0, count: int | None = None
    ) -> Figures:
        """Run a table along the scenarios first, …, first + count − 1."""
        count = laid.scenarios - first if count is None else count
        plant = self._plant(laid)
        return Figures(*run_scenarios(*table, plant, self._run, first, count, _NOTHING, 0))

    def path(
        self, table: tuple[Shape, Rows], laid: Laid, first: int, count: int, keep: int = 0
    ) -> tuple[Figures, Path]:
        """The same for up to eight of them, with states and inputs from sample `keep` on."""
        n, m = len(table[0].x), len(table[0].u)
        samples = self._run.samples - keep
        path = np.empty(samples * (n + m) * LANES)
        plant = self._plant(laid)
        result = run_scenarios(*table, plant, self._run, first, count, path, keep)
        both = path.reshape(samples, n + m, LANES).transpose(2, 1, 0)[:count]
        return Figures(*result), Path(both[:, :n], both[:, n:])

    def _plant(self, laid: Laid) -> Plant:
        return Plant(
            self._loop.acting.lags,
            laid.maps,
            laid.first,
            laid.step,
            laid.mode,
            laid.map,
            laid.age,
        )

    def _shape(self, order: int, block: int, rows: int, dense: bool = False) -> Shape:
        plant = self._loop.plant
        n, m = plant.states, plant.inputs
        wide = self._loop.acting.wide
        sizes = n, m, n + m, wide - n, wide, order, block, rows * m, m * (n + m)
        flags = int(dense), int(len(self._loop.actuators) > 0)
        return Shape(*((0.0,) * size for size in (*sizes, *flags)))


def _factor_rows(feedback: Feedback, form: WindowForm) -> Rows:
    flat: list[Any] = [part.ravel() for part in (feedback.state_gain, *form)]
    state, out, transition, enter, last, ahead, behind = map(np.ascontiguousarray, flat)
    parts = state, out, last, transition, enter, ahead, behind
    kind = _KINDS[feedback.context]
    length, taps = form.ahead.shape[0], feedback.taps
    return Rows(length, taps, *parts, _NOTHING, _NOTHING, 0, kind, 1)


def _dense(feedbacks: Sequence[Feedback]) -> Rows:
    """Dense rows, the latest input beside F, the others padded to whole vectors."""
    first = feedbacks[0]
    taps, (m, n) = first.taps, first.state_gain.shape[1:]
    width = max(1, -(-(taps - 1) * m // LANES)) * LANES
    rows = sum(feedback.state_gain.shape[0] for feedback in feedbacks)
    head = np.empty((rows, m, n + m))
    dense, start = _zeros_on_cache_lines(rows * m * width).reshape(rows, m, width), 0
    for feedback in feedbacks:
        stop = start + feedback.state_gain.shape[0]
        G = feedback.latest_first
        head[start:stop, :, :n], head[start:stop, :, n:] = feedback.state_gain, G[:, :, :m]
        dense[start:stop, :, : (taps - 1) * m] = G[:, :, m:]
        start = stop
    unused, kind = np.zeros(m * max(m, n)), _KINDS[first.context]
    # Sizes of what only factorised rows use: the code for them is there, and never run.
    flat = head.ravel(), dense.ravel(), width, kind, first.ages
    return Rows(0, taps, *[unused] * 7, *flat)  # pyright: ignore[reportCallIssue]


def _zeros_on_cache_lines(size: int) -> np.ndarray:
    """Zeros of which every eighth begins a cache line: a vector across two costs twice as much."""
    room = np.zeros(size + LANES)
    skip = -(room.ctypes.data // room.itemsize) % LANES
    return room[skip : skip + size]
