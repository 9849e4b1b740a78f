"""The digital loop of eight scenarios at once, compiled: see `docs/theory/batch.md`.

Why lanes: within one scenario every operation of a period waits for the one before, and the units
of a processor idle. Eight scenarios are independent, and one vector instruction moves them all.

    lane         0     1     2   …   7
    x            x₁ of eight scenarios   | x₂ of eight scenarios | …       vectors in registers
    ring         u_{k−N} | … | u_{k−1} | u_k,   each m vectors             place k mod period
    own          M of eight scenarios, entry by entry, then E              one map per lane

All sizes are types (`deadtime.numerics.lanes`), so that one period is straight-line code with
states, window sums and metrics in registers. Each scenario's map over a period lies in memory and
is rewritten by its records: when its mode changes, and for a period with a switch. A law is
factorised rows, dense rows, or a model for a preview; arguments that are None leave their branches
out of the compiled code.
"""

# Intrinsics take one argument less than the functions that declare them.
# pyright: reportCallIssue=false

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deadtime.imperfections.sensors_and_actuators import limit_input
from deadtime.numerics.kernels import inner_kernel, kernel
from deadtime.numerics.lanes import (
    LANES,
    block_product,
    choose,
    exponent,
    first_of,
    gather,
    lanes_of,
    larger,
    load,
    load_each,
    mantissa,
    matrix_product,
    own_form,
    own_product,
    product,
    same,
    smaller,
    spread,
    squares,
    store,
    times,
    where_larger,
)
from deadtime.scenarios.lane_types import LoopSizes, PlantLanes, RunLanes
from deadtime.scenarios.law_lanes import (
    answer_with_preview,
    begin_previews,
    choose_rows,
    enter,
    refill,
    sum_dense,
    turn,
    window_of,
)
from deadtime.scenarios.measured_lanes import (
    add_noise,
    command,
    go_on,
    receive,
    receive_modes,
    receive_rows,
    recent_of,
    reported_rows,
    see,
)
from deadtime.scenarios.state_lanes import (
    begin_observers,
    mean_dense_row,
    mean_row,
    measure_outputs,
    store_commands,
    update_beliefs,
    update_observers,
)

FIGURES = 8  # ise, energy, peak², last outside, least², Σ log, ΣΣ log, final²
OUTSIDE = 0.02**2
_LOG_2 = math.log(2.0)
_NEVER = np.int64(2**62)
_ONE = (0.0,)
_GROUP = 32  # samples whose |x|² are multiplied before exponents are taken out again


class LaneScratch(NamedTuple):
    """Memory of eight scenarios, made before the loop: code that makes arrays compiles slowly.

    figures : (group, FIGURES + 2, lane), flat, of all scenarios
    ring : (period, m, lane), flat, the inputs of the last `period` samples
    own : (M and E, lane), flat;  xs : (n, lane), x₀;  carry : of factorised rows (`refill`)
    mode : (lane,), `number` the same as a float, for `choose`;  began : the sample of its begin
    at, stop : (lane,), the next record and the end of records
    coming : (lane,), 8 · period + lane of the next record, as one number to compare
    acting : (lag,), the places in `ring` of the inputs that act
    """

    figures: np.ndarray
    ring: np.ndarray
    own: np.ndarray
    xs: np.ndarray
    carry: np.ndarray
    number: np.ndarray
    mode: np.ndarray
    began: np.ndarray
    at: np.ndarray
    stop: np.ndarray
    coming: np.ndarray
    acting: np.ndarray


def work_of(
    shape: LoopSizes, plant: PlantLanes, run: RunLanes, taps: int, carry: int, scenarios: int
) -> LaneScratch:
    """Room for a loop whose law reads `taps` inputs and carries so many vectors."""
    n, m, wide = shape.x, shape.u, shape.z
    # Inputs from before time 0 are 0: what lies further back than the run is a row never written.
    period = min(max(int(plant.lags[0]), taps), run.samples) + 1
    figures = -(-scenarios // LANES) * (FIGURES + 2)
    sizes = figures, period * m, n * wide + wide * (wide + 1) // 2, n, carry, 1
    vectors = [np.empty(size * LANES) for size in sizes]
    lanes = [np.empty(LANES, np.int64) for _ in range(5)]
    return LaneScratch(*vectors, *lanes, np.empty(plant.lags.size, np.int64))


@kernel(eager=True, nogil=True, no_cpython_wrapper=True, _nrt=False)
def _begin(n, m, work, plant, run, start, count):
    """Fill the memory as it is at time 0; sizes are numbers here, so that all laws share it."""
    size = work.ring.size
    period = size // (m * LANES)
    for i in range(size):
        work.ring[i] = 0.0
    for i in range(work.carry.size):
        work.carry[i] = 0.0
    for p in range(plant.lags.size):
        work.acting[p] = (period - min(plant.lags[p], run.samples)) % period * m * LANES
    for lane in range(LANES):
        scenario = start + min(lane, count - 1)
        record = plant.first[scenario]
        work.at[lane], work.stop[lane] = record, plant.first[scenario + 1]
        work.mode[lane] = work.number[lane] = plant.mode[record]
        work.began[lane], work.coming[lane] = -plant.age[scenario], lane
        for i in range(n):
            work.xs[i * LANES + lane] = run.x0[i]


@inner_kernel
def _switch(plant, work, k, soon):
    """Apply the records of period k; return the next of `coming`."""
    size = work.own.size // LANES
    while soon // LANES == k:
        lane = soon % LANES
        record = work.at[lane]
        work.at[lane] += 1
        if plant.mode[record] != work.mode[lane]:
            work.mode[lane], work.began[lane] = plant.mode[record], k
            work.number[lane] = plant.mode[record]
        for i in range(size):
            work.own[i * LANES + lane] = plant.maps[plant.map[record], i]
        work.coming[lane] = _NEVER
        if work.at[lane] < work.stop[lane]:
            work.coming[lane] = np.int64(plant.step[work.at[lane]]) * LANES + lane
        soon = _NEVER
        for other in range(LANES):
            soon = min(soon, work.coming[other])
    return soon


@inner_kernel
def _turn_around(places, m, size):
    """Move places in a ring on to the next input."""
    for p in range(places.size):
        after = places[p] + m * LANES
        places[p] = 0 if after == size else after


# One function: a second one, called from here, would be optimised alone and again where it is
# inlined, which doubles the time of compiling.
@kernel(eager=True, nogil=True)
def run_scenarios(
    shape, factored, dense, model, memory, belief, bank, taps, plant, run, limits, relayed,
    instants, force, start, count, path, keep, work, ahead, kept, beliefs, outputs,
):  # fmt: skip
    """Run the scenarios start, …, start + count − 1; their figures are in `work`.

    factored, dense, model : one of them is the law, which reads `taps` past inputs
    memory, belief, bank : its observer, the belief that weighs its rows, its filters of outputs
    plant, run, limits : `PlantLanes`, `RunLanes`, and the limits of the inputs
    relayed, instants : measurements and modes as received (`lane_types.MeasurementLanes`)
    force : of disturbances (`forces`)
    path : gets x and u of every sample from `keep` on, unless it is empty
    work, ahead, kept, beliefs : memory of the loop, of a model, an observer and a belief
    outputs : C of the plant, None if the state is measured

    All but shape, plant, run, path and work may be None. The last scenario fills the last group.
    """
    n, m, wide = len(shape.x), len(shape.u), len(shape.z)
    ring, own, carry, sizes = work.ring, work.own, work.carry, len(shape.rows)
    period = ring.size // (m * LANES)
    none, one = same(0.0, _ONE), same(1.0, _ONE)
    small = same(OUTSIDE, _ONE)
    for first in range(0, count, LANES):
        begin, few = start + first, min(LANES, count - first)
        _begin(n, m, work, plant, run, begin, few)
        x, u, asked = load(work.xs, 0, shape.x), same(0.0, shape.u), same(0.0, shape.u)
        ise, energy, peak, last, least = none, none, none, same(-1.0, _ONE), same(np.inf, _ONE)
        # Π |x|² and Π of these products so far: mantissas, and sums of exponents.
        P, Q, EP, EQ = one, one, none, none
        felt, y, z = same(0.0, shape.force), same(0.0, shape.output), same(0.0, shape.kept)
        line, nothing_lost = (
            lanes_of(ring.reshape(period, m, LANES)),
            lanes_of(np.zeros((1, LANES))),
        )
        if memory is not None:
            begin_observers(memory, kept)
        # A plain 0 has another type, for which every callee would be compiled once more.
        soon, now, r, place = np.int64(0), np.int64(0), np.int64(0), np.int64(0)
        older = period - min(taps, run.samples)
        if factored is not None:
            b = same(0.0, shape.b)
        if dense is not None:
            window, places = window_of(shape, dense), m * np.arange(LANES)
            width = window.line.size // LANES
        if model is not None:
            enters = begin_previews(shape, model, ahead, line, begin, few, period)
        if relayed is not None:
            recent = recent_of(shape, relayed, instants)
            lost_now = lanes_of(recent.lost.reshape(1, LANES))
            # Before the loop: Numba counts references to arrays that are first used in a branch.
            late, noisy = relayed.lag.size > 0, relayed.noise.size > 0
            by_reported = relayed.row.size > 0
        for k in range(run.samples):
            # 8·period + lane in one number: one comparison finds whether any scenario switches.
            if soon // LANES == k:
                soon = _switch(plant, work, k, soon)
            norm = squares(x, none)
            peak = larger(norm, peak)
            last = where_larger(norm, times(small, peak, none), float(k), last)
            if k >= run.late:
                least = smaller(norm, least)
                P, EP = times(P, mantissa(norm), none), times(one, exponent(norm), EP)
                Q, EQ = times(Q, P, none), times(one, EP, EQ)
                # 32 mantissas below 2 leave P below 2^33 and Q below 2^600: neither overflows.
                if (k - run.late) % _GROUP == _GROUP - 1:
                    EP, EQ = times(one, exponent(P), EP), times(one, exponent(Q), EQ)
                    P, Q = mantissa(P), mantissa(Q)
            latest = period - 1 if now == 0 else now - 1
            before, missing = load(ring, latest * m * LANES, shape.u), nothing_lost
            if outputs is not None:
                y = measure_outputs(shape, outputs, work.mode, x)
            seen = first_of(y, x, x, shape.seen)
            if relayed is not None:
                at = first * run.samples + k * LANES
                if instants is not None:
                    there = see(shape, relayed, instants, recent, x, at)
                    if outputs is not None:
                        y = measure_outputs(shape, outputs, work.mode, there)
                    seen = first_of(y, there, there, shape.seen)
                elif late:
                    seen = receive(shape, relayed, recent, seen, at)
                if noisy:
                    seen = add_noise(shape, relayed, seen, at)
                if by_reported:
                    receive_rows(relayed, recent, at)
                missing = lost_now
            if memory is not None:
                reported = work.mode
                if relayed is not None:  # noqa: SIM102
                    if relayed.mode.size > 0:
                        receive_modes(relayed, kept.reported, at)
                        reported = kept.reported
                received = first_of(seen, seen, seen, shape.output)
                given = line, latest, reported, received, missing, k
                z = update_observers(shape, memory, kept, outputs, *given)
            known = first_of(z, seen, seen, shape.known)
            if belief is not None:
                update_beliefs(belief, bank, beliefs, line, latest, seen, missing, k)
            if model is not None:
                if enters // LANES == k:
                    enters = turn(model, ahead, k, enters)
                u = answer_with_preview(shape, model.length, ahead, k, known, line[latest])
            if factored is not None:
                if r == factored.length:
                    refill(shape, factored, ring, period, now, carry)
                    b, r = same(0.0, shape.b), np.int64(0)
                sums = load(carry, r * sizes * LANES, shape.rows)
                sums = product(factored.last, 0, load(ring, older * m * LANES, shape.u), sums)
                sums = product(factored.out, 0, b, product(factored.state, 0, known, sums))
                if belief is not None:
                    u = mean_row(shape, bank, beliefs, sums)
                else:
                    number = load(work.number, 0, _ONE)
                    if relayed is not None:  # noqa: SIM102
                        if by_reported:
                            number = load(recent.number, 0, _ONE)
                    u = choose(sums, number, shape.u)
            if dense is not None:
                if belief is not None:
                    u = mean_dense_row(shape, bank, beliefs, dense, window, place, known, before)
                else:
                    choose_rows(dense, work, window, k)
                    if relayed is not None:  # noqa: SIM102
                        if by_reported:
                            reported_rows(recent, window.row)
                    sum_dense(shape, dense, window, place)
                    heads = gather(dense.head, window.head, shape.head)
                    sums = gather(window.sums, places, shape.u)
                    u = matrix_product(heads, first_of(known, before, before, shape.both), sums)
            if memory is not None:
                store_commands(kept, u)
            elif relayed is not None and bank is None:
                u = command(shape, recent, u, asked)
                asked = u
            store(ring, now * m * LANES, u)
            if limits is not None:
                for i in range(m):
                    base, asked_for = line[latest, i], line[now, i]
                    line[now, i] = limit_input(
                        limits.low, limits.high, limits.relative, i, asked_for, base
                    )
                u = load(ring, now * m * LANES, shape.u)
            if model is not None:  # noqa: SIM102
                if model.length > 0:
                    enter(ahead, line)
            if factored is not None:
                entered = product(factored.enter, 0, u, same(0.0, shape.b))
                b = block_product(factored.transition, 0, b, entered, shape.block)
                r += 1
            if dense is not None:
                place = dense.taps - 1 if place == 0 else place - 1
                spread(window.line, place * m, width, u)
                spread(window.line, (place + dense.taps) * m, width, u)
            if path.size and k >= keep:
                at = (first * (run.samples - keep) + (k - keep) * LANES) * (n + m)
                store(path, at, x)
                store(path, at + n * LANES, u)
            # After u_k is in the ring: with a delay below one period it acts in this period.
            acting = load_each(ring, work.acting, shape.u, shape.acting)
            if force is not None:
                at = (first * run.samples + k * LANES) * len(shape.force)
                felt = load(force, at, shape.force)
            if instants is not None:
                go_on(shape, relayed, recent, first_of(acting, felt, felt, shape.driving))
            moved = first_of(x, acting, felt, shape.z)
            ise = own_form(own, n * wide * LANES, moved, ise)
            x = own_product(own, 0, moved, same(0.0, shape.x))
            # The horizon may lie within the last period, whose input counts for a part of it.
            weight = run.rest if k == run.samples - 1 else 1.0
            weighed = product(run.root, 0, u, same(0.0, shape.u)) if run.root.size else u
            energy = times(same(weight, _ONE), squares(weighed, none), energy)
            now = 0 if now + 1 == period else now + 1
            _turn_around(work.acting, m, ring.size)
            older = 0 if older + 1 == period else older + 1
        figures = ise, energy, peak, last, least, P, Q, squares(x, none), EP, EQ
        at = first * (FIGURES + 2)
        for f, figure in enumerate(figures):
            store(work.figures, at + f * LANES, figure)
        for lane in range(at, at + LANES):
            # P and Q, their exponents three figures on: log Π = log mantissa + exponent · log 2.
            for f in (5, 6):
                product_so_far, exponents = (
                    work.figures[lane + f * LANES],
                    work.figures[lane + (f + 3) * LANES],
                )
                work.figures[lane + f * LANES] = math.log(product_so_far) + exponents * _LOG_2
