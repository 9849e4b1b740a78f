"""Laws in eight scenarios: rows on past inputs, factorised or dense, and previews of signals.

The stacks of a preview are those of `loop.preview_steps`; a piece is the affine map x → Φ_p x +
Γ_p z_p of the model over a period p, its inputs z_p being in flight. At t_k the prediction takes
x_k over the W = ⌊D/h⌋ coming periods and over the rest φ' of the delay, 0 ≤ φ' < h
(`deadtime.feedback.preview`).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from deadtime.loop.preview_steps import (
    PreviewSizes,
    PreviewState,
    answer_ahead,
    enter_piece,
    move_window,
    predict_ahead,
)
from deadtime.loop.received_samples import row_of_mode
from deadtime.numerics.kernels import inner_kernel, kernel
from deadtime.numerics.lanes import (
    LANES,
    KnownNumbers,
    first_of,
    lanes_of,
    load,
    product,
    same,
    store,
    times,
    total,
)
from deadtime.numerics.numbers import arrays_of
from deadtime.scenarios.lane_types import LoopSizes

# Intrinsics take one argument less than the functions that declare them.
# pyright: reportCallIssue=false


_ONE = (0.0,)
_FOUR, _FIVE = (0.0,) * 4, (0.0,) * 5
_NEVER = np.int64(2**62)


@kernel(eager=True, nogil=True)
def dot(a, i, b, j, length):
    """Σ a[i + k] b[j + k] over a length that is a multiple of 8."""
    # Four sums of eight lanes: in one, each addition would wait for the one before.
    sums = same(0.0, _FOUR)
    k = 0
    while k + 4 * LANES <= length:
        sums = times(load(a, i + k, _FOUR), load(b, j + k, _FOUR), sums)
        k += 4 * LANES
    rest = same(0.0, _ONE)
    while k < length:
        rest = times(load(a, i + k, _ONE), load(b, j + k, _ONE), rest)
        k += LANES
    return total(first_of(sums, rest, rest, _FIVE))


@inner_kernel
def refill(shape, factored, ring, period, now, carry):
    """Fill `carry` with the share of the previous block of W inputs in the sums of the next one.

        inputs   … | u_{k−W}  …  u_{k−1} | u_k  …  u_{k+r−1} | u_{k+r}
                   previous block        | coming block: summed in b as they enter

    The window of the sum r periods on is u_{k−W+r}, …, u_{k+r−1}. With s_r = Σ_{i ≥ r} S^{W−1−i} Γ
    u_{k−W+i} the previous block adds H S^r s_r. Inputs leave the window without being subtracted,
    so that nothing cancels and round-off does not grow from block to block.
    """
    m, asked = len(shape.u), len(shape.rows)
    q = len(shape.b)
    s = same(0.0, shape.b)
    place = now
    # From the latest input back: s_r is s_{r+1} and one older input.
    for r in range(factored.length - 1, -1, -1):
        place = period - 1 if place == 0 else place - 1
        u = load(ring, place * m * LANES, shape.u)
        s = product(factored.ahead, r * q * m, u, s)
        sums = product(factored.behind, r * asked * q, s, same(0.0, shape.rows))
        store(carry, r * asked * LANES, sums)


class RowWindow(NamedTuple):
    """Memory of dense rows.

    line : (lane, 2 taps m and padding), flat, the inputs of each scenario, twice
    sums : (lane, m), of all inputs but the latest;  row, head : (lane,), rows and their places

    The ring of inputs, latest first, is written twice, so that `taps` of them are contiguous from
    any place on:

        place        0      1      2     …  taps − 1 | taps   taps + 1 …
        content      u_k−1  u_k−2  u_k−3 …           | u_k−1  u_k−2    …
    """

    line: np.ndarray
    sums: np.ndarray
    row: np.ndarray
    head: np.ndarray


@kernel(eager=True, nogil=True)
def window_of(shape, dense):
    """The memory of dense rows at time 0."""
    m, row = len(shape.u), np.zeros(LANES, np.int64)
    line = np.zeros((2 * dense.taps * m + LANES) * LANES)
    return RowWindow(line, np.empty(m * LANES), row, row.copy())


@inner_kernel
def choose_rows(dense, work, window, k):
    """The row of every scenario by its mode and age."""
    for lane in range(LANES):
        age = k - work.began[lane]
        window.row[lane] = row_of_mode(dense.apart, dense.ages, work.mode[lane], age)


@inner_kernel
def sum_dense(shape, dense, window, place):
    """Sums of all inputs but the latest, scenario by scenario.

    They do not depend on the last period: a processor computes both at once.
    """
    m, head = len(shape.u), len(shape.head)
    width = window.line.size // LANES
    for lane in range(LANES):
        row = window.row[lane]
        window.head[lane] = row * head
        # Row `place` holds the latest input, which is added with the head.
        start = lane * width + (place + 1) * m
        for i in range(m):
            begin = (row * m + i) * dense.width
            window.sums[lane * m + i] = dot(dense.rest, begin, window.line, start, dense.width)


class KnownSignalModel(NamedTuple):
    """A law's model along signals that it knows, one per scenario or one for all.

    length : W;  lags, maps, first, step, map : as in `PlantLanes`, over W periods more
    tails : (maps, m (n + m)), [K M, L], for the prediction after W periods and the latest input: M
        moves x up to t_k + D, K is the gain there
    """

    length: int
    lags: np.ndarray
    maps: np.ndarray
    first: np.ndarray
    step: np.ndarray
    map: np.ndarray
    tails: np.ndarray


class PreviewLanes(NamedTuple):
    """The previews of eight scenarios.

    stacks : PreviewState;  own : (n (n + q), lane), the map of the period that enters
    tail : (m (n + m), lane);  answer : (m, lane)
    at, stop, coming, acting : as of `LaneScratch`, W periods early
    """

    stacks: PreviewState
    own: np.ndarray
    tail: np.ndarray
    answer: np.ndarray
    at: np.ndarray
    stop: np.ndarray
    coming: np.ndarray
    acting: np.ndarray

    @classmethod
    def of(cls, shape: LoopSizes, model: KnownSignalModel) -> PreviewLanes:
        n, m, q = shape.x, shape.u, shape.entering
        sizes = PreviewSizes.of(n, m, q)
        known: Any = KnownNumbers(sizes._asdict())
        stacks = PreviewState.of(sizes, model.length, LANES)._replace(sizes=known)
        floats = arrays_of((n * (n + q),), (m * (n + m),), (m,), lanes=(LANES,))
        lanes = [np.empty(LANES, np.int64) for _ in range(3)]
        return cls(stacks, *floats, *lanes, np.empty(model.lags.size, np.int64))


@kernel(eager=True, nogil=True, no_cpython_wrapper=True)
def begin_previews(shape, model, ahead, ring, start, count, period):
    """Fill the stacks with the first W periods, for time 0; return the next of `coming`.

    Inputs from before time 0 are 0.
    """
    soon = -np.int64(model.length) * LANES
    for p in range(model.lags.size):
        ahead.acting[p] = -model.lags[p] % period
    for lane in range(LANES):
        scenario = 0 if model.first.size == 2 else start + min(lane, count - 1)
        ahead.at[lane], ahead.stop[lane] = model.first[scenario], model.first[scenario + 1]
        ahead.coming[lane] = soon + lane
    for i in range(3):
        ahead.stacks.bounds[i] = 0
    for k in range(-model.length, 0):
        soon = turn(model, ahead, k, soon)
        enter(ahead, ring)
    return soon


@kernel(eager=True, nogil=True, no_cpython_wrapper=True)
def turn(model, ahead, k, soon):
    """Apply the records of the period that enters at t_k; return the next of `coming`."""
    while soon // LANES == k:
        lane = soon % LANES
        record = ahead.at[lane]
        ahead.at[lane] += 1
        row = model.map[record]
        for i in range(len(ahead.own)):
            ahead.own[i, lane] = model.maps[row, i]
        for i in range(len(ahead.tail)):
            ahead.tail[i, lane] = model.tails[row, i]
        ahead.coming[lane] = _NEVER
        if ahead.at[lane] < ahead.stop[lane]:
            step = np.int64(model.step[ahead.at[lane]]) - model.length
            ahead.coming[lane] = step * LANES + lane
        soon = _NEVER
        for other in range(LANES):
            soon = min(soon, ahead.coming[other])
    return soon


@inner_kernel
def enter(ahead, ring):
    """Let a period enter the window, under its inputs, which are in the ring already."""
    eight = lanes_of(ahead)
    acting, m, q = eight.stacks.acting, eight.stacks.sizes.m, eight.stacks.sizes.acting
    for p in range(q // m):
        for j in range(m):
            acting[p * m + j] = ring[ahead.acting[p], j]
    enter_piece(eight.stacks, eight.own)
    for p in range(q // m):
        after = ahead.acting[p] + 1
        ahead.acting[p] = 0 if after == ring.shape[0] else after


@inner_kernel
def answer_with_preview(shape, length, ahead, k, x, latest):
    """The command: x predicted over W periods, then multiplied by the tail."""
    eight = lanes_of(ahead)
    if length > 0:
        move_window(eight.stacks, k)
        # In this order: values that are stored after the move stay in registers.
        store(ahead.stacks.x, 0, x)
        predict_ahead(eight.stacks, k)
    else:
        store(ahead.stacks.x, 0, x)
    answer_ahead(eight.stacks, eight.tail, latest, eight.answer)
    return load(ahead.answer, 0, shape.u)
