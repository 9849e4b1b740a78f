"""The digital loop of eight scenarios at once, compiled: see `docs/theory/batch.md`.

All sizes are types (`deadtime.monte_carlo.lanes`), so that one period is straight-line code with
states, window sums and metrics in registers. Each scenario's transition over a period lies in
memory and is rewritten where its records say so: when its mode changes, and for a period that a
switch cuts.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from deadtime.monte_carlo.lanes import (
    LANES,
    block_product,
    chosen,
    exponent,
    first_of,
    larger,
    load,
    mantissa,
    own_form,
    own_product,
    product,
    same,
    smaller,
    squares,
    store,
    times,
    total,
    where_larger,
)

FIGURES = 8  # ise, energy, peak², last outside, least², Σ log, ΣΣ log, final²
OUTSIDE = 0.02**2
_LOG_2 = math.log(2.0)
_ONE = (0.0,)
_FOUR = (0.0,) * 4
_GROUP = 32  # samples whose |x|² are multiplied before exponents are taken out again


class Shape(NamedTuple):
    """Sizes, as the lengths of tuples: state, input, what acts over a period, window, its blocks,
    and the inputs that the law's rows ask for. The last two are empty where rows are factorised,
    and where no actuator limits the input."""

    x: tuple
    u: tuple
    z: tuple
    b: tuple
    block: tuple
    rows: tuple
    dense: tuple
    limited: tuple


class Rows(NamedTuple):
    """A law. Of a factorised one `length` is the window, and `dense` is empty.

    state (rows, m, n), out (rows, m, q), last (rows, m, m), transition (q, block), enter (q, m),
    ahead (length, q, m) and behind (length, rows, m, q), flat; dense (rows, m, padded taps), the
    oldest input first; `kind` 0 one row, 1 a row per mode, 2 per mode and age, 3 per sample.
    """

    length: int
    taps: int
    state: np.ndarray
    out: np.ndarray
    last: np.ndarray
    transition: np.ndarray
    enter: np.ndarray
    ahead: np.ndarray
    behind: np.ndarray
    dense: np.ndarray
    kind: int
    ages: int


class Plant(NamedTuple):
    """The truth: N, and signals laid on its periods (`loop.Laid`)."""

    count: int
    maps: np.ndarray
    first: np.ndarray
    step: np.ndarray
    mode: np.ndarray
    map: np.ndarray
    age: np.ndarray


class Run(NamedTuple):
    """samples, the weight of the last one's input, where the late half begins, x0, actuators.

    Actuator a clips to [low[a], high[a]], relative to the input before where `rate[a]`.
    """

    samples: int
    rest: float
    late: int
    x0: np.ndarray
    rate: np.ndarray
    low: np.ndarray
    high: np.ndarray


@njit(cache=True, nogil=True)
def _dot(a, i, b, j, length):
    """Σ a[i + k] b[j + k] over a length that is a multiple of 8."""
    sums = same(0.0, _FOUR)
    k = 0
    while k + 4 * LANES <= length:
        sums = times(load(a, i + k, _FOUR), load(b, j + k, _FOUR), sums)
        k += 4 * LANES
    rest = same(0.0, _ONE)
    while k < length:
        rest = times(load(a, i + k, _ONE), load(b, j + k, _ONE), rest)
        k += LANES
    return total(sums) + total(rest)


@njit(cache=True, nogil=True)
def _refill(shape, rows, ring, period, now, carry):
    """What the previous block of inputs adds to each sum of the coming one.

    With s_r = Σ_{i ≥ r} S^{W−1−i} Γ u_{k−W+i}, the sum r periods on gets H S^r s_r. Nothing is
    subtracted, so nothing cancels.
    """
    m, asked = len(shape.u), len(shape.rows)
    q = len(shape.b)
    s = same(0.0, shape.b)
    place = now
    for r in range(rows.length - 1, -1, -1):
        place = period - 1 if place == 0 else place - 1
        u = load(ring, place * m * LANES, shape.u)
        s = product(rows.ahead, r * q * m, u, s)
        sums = product(rows.behind, r * asked * q, s, same(0.0, shape.rows))
        store(carry, r * asked * LANES, sums)


@njit(cache=True, nogil=True)
def _dense(shape, rows, row, xs, window, start, width, asked):
    """The input that dense rows ask for, scenario by scenario, from x in `xs`."""
    n, m = len(shape.x), len(shape.u)
    length = rows.dense.size // max(1, rows.state.size // n)
    for lane in range(LANES):
        for i in range(m):
            at = row[lane] * m + i
            value = _dot(rows.dense, at * length, window, lane * width + start, length)
            for j in range(n):
                value += rows.state[at * n + j] * xs[j * LANES + lane]
            asked[i * LANES + lane] = value


@njit(cache=True, nogil=True)
def _run_eight(shape, rows, plant, run, start, count, out, path, keep):
    """Run the scenarios start, …, start + count − 1, at most eight; the last fills the rest."""
    n, m, wide, asked = len(shape.x), len(shape.u), len(shape.z), len(shape.rows)
    size = n * wide + wide * (wide + 1) // 2
    factored = len(shape.dense) == 0
    # Inputs from before time 0 are 0: what lies further back than the run is a row never written.
    period = min(max(plant.count, rows.taps), run.samples) + 1
    ring = np.zeros(period * m * LANES)
    carry = np.zeros(max(1, min(rows.length, run.samples)) * asked * LANES)
    own = np.empty(size * LANES)
    xs, ask, more = np.empty(n * LANES), np.empty(m * LANES), np.empty(2 * LANES)
    width = 0 if factored else 2 * rows.taps * m + LANES
    window = np.zeros(width * LANES)
    mode, coming = np.empty(LANES, np.int64), np.empty(LANES, np.int64)
    never = np.int64(run.samples) * LANES
    soon = np.int64(0)
    mode_row = np.zeros(LANES)
    began, row = np.empty(LANES, np.int64), np.zeros(LANES, np.int64)
    at, stop = np.empty(LANES, np.int64), np.empty(LANES, np.int64)
    for lane in range(LANES):
        scenario = start + min(lane, count - 1)
        at[lane], stop[lane] = plant.first[scenario], plant.first[scenario + 1]
        mode[lane] = plant.mode[at[lane]]
        mode_row[lane] = mode[lane] if rows.kind == 1 else 0
        began[lane] = -plant.age[scenario]
        coming[lane] = lane
        for i in range(n):
            xs[i * LANES + lane] = run.x0[i]
    x = load(xs, 0, shape.x)
    b = same(0.0, shape.b)
    one = same(1.0, _ONE)
    ise, energy, peak = same(0.0, _ONE), same(0.0, _ONE), same(0.0, _ONE)
    last, least = same(-1.0, _ONE), same(np.inf, _ONE)
    P, Q, EP, EQ = one, one, same(0.0, _ONE), same(0.0, _ONE)
    small = same(OUTSIDE, _ONE)
    now, old = 0, period - min(plant.count, run.samples)
    new = (period - min(plant.count - 1, run.samples)) % period
    older = period - min(rows.taps, run.samples)
    r, p = 0, 0
    for k in range(run.samples):
        # What happens to the modes in this period.
        while soon // LANES == k:
            lane = soon % LANES
            record = at[lane]
            at[lane] += 1
            if plant.mode[record] != mode[lane]:
                mode[lane], began[lane] = plant.mode[record], k
                mode_row[lane] = mode[lane] if rows.kind == 1 else 0
            for i in range(size):
                own[i * LANES + lane] = plant.maps[plant.map[record], i]
            coming[lane] = never
            if at[lane] < stop[lane]:
                coming[lane] = plant.step[at[lane]] * LANES + lane
            soon = never
            for other in range(LANES):
                soon = min(soon, coming[other])
        # Metrics of the sample.
        norm = squares(x, same(0.0, _ONE))
        peak = larger(norm, peak)
        last = where_larger(norm, times(small, peak, same(0.0, _ONE)), float(k), last)
        if k >= run.late:
            least = smaller(norm, least)
            P = times(P, mantissa(norm), same(0.0, _ONE))
            EP = times(one, exponent(norm), EP)
            Q = times(Q, P, same(0.0, _ONE))
            EQ = times(one, EP, EQ)
            if (k - run.late) % _GROUP == _GROUP - 1:
                EP, EQ = times(one, exponent(P), EP), times(one, exponent(Q), EQ)
                P, Q = mantissa(P), mantissa(Q)
        # The law.
        if factored:
            if r == rows.length:
                _refill(shape, rows, ring, period, now, carry)
                b, r = same(0.0, shape.b), 0
            sums = load(carry, r * asked * LANES, shape.rows)
            sums = product(rows.last, 0, load(ring, older * m * LANES, shape.u), sums)
            sums = product(rows.state, 0, x, sums)
            sums = product(rows.out, 0, b, sums)
            u = chosen(sums, load(mode_row, 0, _ONE), shape.u)
        else:
            for lane in range(LANES):
                if rows.kind == 1:
                    row[lane] = mode[lane]
                elif rows.kind == 2:
                    row[lane] = mode[lane] * rows.ages + min(k - began[lane], rows.ages - 1)
                elif rows.kind == 3:
                    row[lane] = min(lane, count - 1) * run.samples + k
            store(xs, 0, x)
            _dense(shape, rows, row, xs, window, p * m, width, ask)
            u = load(ask, 0, shape.u)
        if len(shape.limited) > 0:
            before = load(ring, (period - 1 if now == 0 else now - 1) * m * LANES, shape.u)
            for a in range(run.rate.size):
                base = times(same(run.rate[a], shape.u), before, same(0.0, shape.u))
                low = product(run.low, a * m, one, base)
                high = product(run.high, a * m, one, base)
                u = smaller(larger(u, low), high)
        store(ring, now * m * LANES, u)
        if factored:
            b = block_product(
                rows.transition, 0, b, product(rows.enter, 0, u, same(0.0, shape.b)), shape.block
            )
            r += 1
        else:
            store(ask, 0, u)
            for lane in range(LANES):
                for i in range(m):
                    window[lane * width + p * m + i] = ask[i * LANES + lane]
                    window[lane * width + (p + rows.taps) * m + i] = ask[i * LANES + lane]
            p = 0 if p + 1 == rows.taps else p + 1
        if path.size and k >= keep:
            store(path, (k - keep) * (n + m) * LANES, x)
            store(path, ((k - keep) * (n + m) + n) * LANES, u)
        # The plant.
        recent = load(ring, new * m * LANES, shape.u)
        z = first_of(x, load(ring, old * m * LANES, shape.u), recent, shape.z)
        ise = own_form(own, n * wide * LANES, z, ise)
        x = own_product(own, 0, z, same(0.0, shape.x))
        weight = run.rest if k == run.samples - 1 else 1.0
        energy = times(same(weight, _ONE), squares(u, same(0.0, _ONE)), energy)
        now = 0 if now + 1 == period else now + 1
        old = 0 if old + 1 == period else old + 1
        new = 0 if new + 1 == period else new + 1
        older = 0 if older + 1 == period else older + 1
    for f, figure in enumerate((ise, energy, peak, last, least, P, Q, squares(x, same(0.0, _ONE)))):
        store(out, f * LANES, figure)
    store(more, 0, EP)
    store(more, LANES, EQ)
    for lane in range(LANES):
        out[5 * LANES + lane] = math.log(out[5 * LANES + lane]) + more[lane] * _LOG_2
        out[6 * LANES + lane] = math.log(out[6 * LANES + lane]) + more[LANES + lane] * _LOG_2


@njit(cache=True, nogil=True)
def run_scenarios(shape, rows, plant, run, start, count, path, keep):
    """Figures (FIGURES, count) of the scenarios start, …, start + count − 1.

    `path`, empty or for at most eight scenarios, gets x and u of every sample from `keep` on.
    """
    result = np.empty((FIGURES, count))
    out = np.empty(FIGURES * LANES)
    for at in range(0, count, LANES):
        few = min(LANES, count - at)
        _run_eight(shape, rows, plant, run, start + at, few, out, path, keep)
        for f in range(FIGURES):
            for lane in range(few):
                result[f, at + lane] = out[f * LANES + lane]
    return result
