"""What laws on a belief keep of eight scenarios: a `deadtime.feedback.belief.Belief` of each.

Each scenario's belief moves by the steps of a single run (`estimation/belief_kernel.py`); the
answers of a law's rows, each weighed by its share, are summed for all eight at once.
"""

# Intrinsics take one argument less than the functions that declare them.
# pyright: reportCallIssue=false

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deadtime.estimation.belief_kernel import advance_belief, share_rows
from deadtime.feedback.belief import BeliefState
from deadtime.numerics.kernels import kernel
from deadtime.numerics.lanes import LANES, first_of, load, same, spread, store, times
from deadtime.scenarios.law_rows import dot

_ONE = (0.0,)


class Believed(NamedTuple):
    """Memory of eight scenarios, scenario by scenario.

    now : π (lane, modes, ages);  weight : the shares of rows (lane, rows), and `share` (rows, lane)
    seen, before : what is measured at this sample and at the one before, (lane, n)
    told : (lane, 2L, m), inputs twice over, so that L of them lie side by side wherever a ring of
        them begins, and `latest` where the latest one is
    room : what the steps of one scenario work in
    answer : of every row (rows m, lane);  both : x and the latest input (lane, n + m), flat
    """

    now: np.ndarray
    weight: np.ndarray
    share: np.ndarray
    seen: np.ndarray
    before: np.ndarray
    told: np.ndarray
    latest: np.ndarray
    room: BeliefState
    answer: np.ndarray
    both: np.ndarray


@kernel(eager=True, nogil=True)
def believed_of(shape, belief, dense):
    """The memory at time 0; `dense` is None of factorised rows."""
    n, m = len(shape.x), len(shape.u)
    rows = len(shape.rows) // m if dense is None else dense.head.size // len(shape.head)
    modes, ages = belief.start.shape
    now, length = np.empty((LANES, modes, ages)), belief.lag[0] + 1
    for lane in range(LANES):
        for i in range(modes):
            for a in range(ages):
                now[lane, i, a] = belief.start[i, a]
    weight = np.empty((LANES, rows))
    room = BeliefState(
        now[0],
        weight[0],
        np.empty((0, modes)),
        np.empty((modes, modes)),
        np.empty((modes, modes)),
        np.empty((modes, n)),
        np.empty(n),
        np.empty(n),
        np.empty((n, n)),
        np.empty(n),
    )
    return Believed(
        now,
        weight,
        np.empty(rows * LANES),
        np.empty((LANES, n)),
        np.empty((LANES, n)),
        np.zeros((LANES, 2 * length, m)),
        np.full(1, length - 1),
        room,
        np.empty(rows * m * LANES),
        np.empty(LANES * (n + m)),
    )


@kernel(eager=True, nogil=True)
def believe_again(belief, mind, lost, k):
    """Each scenario's belief at sample k, from what it sees, and the shares of the rows."""
    room, n, rows = mind.room, mind.seen.shape[1], mind.weight.shape[1]
    newest = mind.latest[0] + mind.told.shape[1] // 2
    for lane in range(LANES):
        state = BeliefState(
            mind.now[lane],
            mind.weight[lane],
            room.trace,
            room.density,
            room.mass,
            room.predicted,
            room.apart,
            room.size,
            room.root,
            room.white,
        )
        if lost[lane] > 0.0:
            for i in range(n):
                mind.seen[lane, i] = math.nan
        if k > 0:
            seen, before = mind.seen[lane], mind.before[lane]
            advance_belief(belief, state, before, seen, mind.told[lane], newest)
        share_rows(state)
        for i in range(n):
            mind.before[lane, i] = mind.seen[lane, i]
        for c in range(rows):
            mind.share[c * LANES + lane] = mind.weight[lane, c]


@kernel(eager=True, nogil=True, inline="always")
def remember_input(mind, u):
    """Put the inputs that are applied where beliefs read them."""
    length, m = mind.told.shape[1] // 2, mind.told.shape[2]
    place = mind.latest[0] + 1
    mind.latest[0] = place = 0 if place == length else place
    flat = mind.told.reshape(-1)
    spread(flat, place * m, 2 * length * m, u)
    spread(flat, (place + length) * m, 2 * length * m, u)


@kernel(eager=True, nogil=True, inline="always")
def mean_row(shape, mind, answers):
    """The answers of factorised rows, each by its share."""
    store(mind.answer, 0, answers)
    return _mean(shape, mind)


@kernel(eager=True, nogil=True, inline="always")
def _mean(shape, mind):
    """Σ_c π_c of the answers; the room of one row's answers takes the means."""
    m, rows = len(shape.u), mind.weight.shape[1]
    for i in range(m):
        total = same(0.0, _ONE)
        for c in range(rows):
            answer = load(mind.answer, (c * m + i) * LANES, _ONE)
            total = times(load(mind.share, c * LANES, _ONE), answer, total)
        store(mind.answer, i * LANES, total)
    return load(mind.answer, 0, shape.u)


@kernel(eager=True, nogil=True, inline="always")
def mean_dense_row(shape, mind, dense, window, place, known, before):
    """The same of dense rows."""
    both = len(shape.both)
    spread(mind.both, 0, both, first_of(known, before, before, shape.both))
    _answer_dense(mind, dense, window.line, place, len(shape.u), both)
    return _mean(shape, mind)


@kernel(eager=True, nogil=True)
def _answer_dense(mind, dense, line, place, m, both):
    """What the dense rows of any weight ask for in every scenario."""
    width = line.size // LANES
    for lane in range(LANES):
        start, x = lane * width + (place + 1) * m, lane * both
        for c in range(mind.weight.shape[1]):
            for i in range(m):
                total, row = 0.0, c * m + i
                if mind.weight[lane, c] > 0.0:
                    total = dot(dense.rest, row * dense.width, line, start, dense.width)
                    for j in range(both):
                        total += dense.head[row * both + j] * mind.both[x + j]
                mind.answer[row * LANES + lane] = total
