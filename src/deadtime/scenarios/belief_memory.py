"""What laws on a belief keep of eight scenarios: a `deadtime.feedback.belief.Belief` of each.

The beliefs move side by side (`belief_lanes`), and the answers of a law's rows, each weighed by its
share, are summed for all eight, too.
"""

# Intrinsics take one argument less than the functions that declare them.
# pyright: reportCallIssue=false

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deadtime.feedback.belief import BeliefState
from deadtime.numerics.kernels import inner_kernel, kernel
from deadtime.numerics.lanes import (
    LANES,
    choose,
    first_of,
    load,
    same,
    spread,
    store,
    times,
)
from deadtime.scenarios.belief_lanes import move, pair, predict, share_rows, weigh
from deadtime.scenarios.law_rows import dot

_ONE = (0.0,)


class BeliefLanes(NamedTuple):
    """Memory of eight scenarios, side by side: flat, the lane last; of banks one by one.

    chain : π (modes, ages);  x, before : what is measured at this sample and at the one before, (n)
    sent : inputs, (L, m), a ring whose latest is number `latest`
    predicted : (modes, n);  size : (n);  root : (2, n, n), of a pair and of the first one
    white, apart, bent : (n);  square, volume, mass, density : (modes, modes)
    share : the shares of rows;  answer : of every row (rows, m);  both : x and the latest input
    now, weight, seen, told, room : of the bank of each scenario: π (lane, modes, ages), shares
        (lane, rows), measurements (lane, p), inputs twice over (lane, 2L, m), room to work in
    """

    chain: np.ndarray
    x: np.ndarray
    before: np.ndarray
    sent: np.ndarray
    predicted: np.ndarray
    size: np.ndarray
    root: np.ndarray
    white: np.ndarray
    apart: np.ndarray
    bent: np.ndarray
    square: np.ndarray
    volume: np.ndarray
    mass: np.ndarray
    density: np.ndarray
    share: np.ndarray
    answer: np.ndarray
    both: np.ndarray
    latest: np.ndarray
    now: np.ndarray
    weight: np.ndarray
    seen: np.ndarray
    told: np.ndarray
    room: BeliefState


@kernel(eager=True, nogil=True)
def believed_of(shape, belief, dense):
    """The memory at time 0; `dense` is None of factorised rows."""
    n, m, p = len(shape.x), len(shape.u), len(shape.seen)
    rows = len(shape.rows) // m if dense is None else dense.head.size // len(shape.head)
    modes, ages = belief.start.shape
    now, length = np.empty((LANES, modes, ages)), belief.lag[0] + 1
    chain = np.empty(modes * ages * LANES)
    for i in range(modes):
        for a in range(ages):
            store(chain, (i * ages + a) * LANES, same(belief.start[i, a], _ONE))
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
        np.empty(n),
    )
    pairs = modes * modes * LANES
    return BeliefLanes(
        chain,
        np.empty(n * LANES),
        np.empty(n * LANES),
        np.zeros(length * m * LANES),
        np.empty(modes * n * LANES),
        np.empty(n * LANES),
        np.empty(2 * n * n * LANES),
        np.empty(n * LANES),
        np.empty(n * LANES),
        np.empty(n * LANES),
        np.empty(pairs),
        np.empty(pairs),
        np.empty(pairs),
        np.empty(pairs),
        np.empty(rows * LANES),
        np.empty(rows * m * LANES),
        np.empty(LANES * (n + m)),
        np.full(1, length - 1),
        now,
        weight,
        np.empty((LANES, p)),
        np.zeros((LANES, 2 * length, m)),
        room,
    )


@inner_kernel
def believe_again(belief, mind, seen, lost, k):
    """Each scenario's belief at sample k, from what it sees, and the shares of the rows."""
    n, missing = belief.Phi.shape[1], load(lost, 0, _ONE)
    modes, ages = belief.start.shape
    store(mind.x, 0, seen)
    for a in range(n):
        both = pair(load(mind.x, a * LANES, _ONE), same(math.nan, _ONE))
        store(mind.x, a * LANES, choose(both, missing, _ONE))
    if k > 0:
        seen_at_all = predict(belief, mind)
        for i in range(modes):
            for j in range(modes):
                if i == j or belief.within:
                    weigh(belief, mind, i, j)
        move(belief, mind, seen_at_all)
    for a in range(n):
        store(mind.before, a * LANES, load(mind.x, a * LANES, _ONE))
    share_rows(mind, modes, ages)


@kernel(eager=True, nogil=True, inline="always")
def remember_input(mind, u):
    """Put the inputs that are applied where beliefs read them."""
    length, m = mind.told.shape[1] // 2, mind.told.shape[2]
    place = mind.latest[0] + 1
    mind.latest[0] = place = 0 if place == length else place
    store(mind.sent, place * m * LANES, u)


@inner_kernel
def remember_input_twice(mind, u):
    """The same for banks, each scenario's inputs side by side."""
    remember_input(mind, u)
    length, m = mind.told.shape[1] // 2, mind.told.shape[2]
    flat, place = mind.told.reshape(-1), mind.latest[0]
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
    m, rows = len(shape.u), mind.share.size // LANES
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
        for c in range(mind.share.size // LANES):
            for i in range(m):
                total, row = 0.0, c * m + i
                if mind.share[c * LANES + lane] > 0.0:
                    total = dot(dense.rest, row * dense.width, line, start, dense.width)
                    for j in range(both):
                        total += dense.head[row * both + j] * mind.both[x + j]
                mind.answer[row * LANES + lane] = total
