"""What laws with a memory keep of eight scenarios: `deadtime.feedback.memory`, side by side.

The estimate moves by a map of its mode over each period and is corrected by what is heard; a sum of
errors follows. Each scenario's matrices lie in memory and are rewritten where its mode changes.
"""

# Intrinsics take one argument less than the functions that declare them.
# pyright: reportCallIssue=false

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deadtime.numerics.kernels import inner_kernel, kernel
from deadtime.numerics.lanes import (
    LANES,
    choose,
    first_of,
    load,
    load_each,
    own_product,
    product,
    same,
    store,
    times,
)

_ONE = (0.0,)
_ROUND_OFF = 1e-9  # of an input: what differs by less was not refused


class MemoryScratch(NamedTuple):
    """Memory of eight scenarios.

    own : the matrices of each one's mode, and `mode` which that is
    outputs : the C of each one's plant, and `seen` of which mode;  told : the modes that are told
    acting : where in the ring of inputs those of the period that ends lie
    estimate, sums, value : x̂, q and v
    asked, before : the law's answer, and what was applied;  change : what q would grow by, `on` if
    """

    own: np.ndarray
    mode: np.ndarray
    outputs: np.ndarray
    seen: np.ndarray
    told: np.ndarray
    acting: np.ndarray
    estimate: np.ndarray
    sums: np.ndarray
    value: np.ndarray
    asked: np.ndarray
    before: np.ndarray
    change: np.ndarray
    on: np.ndarray


@kernel(eager=True, nogil=True)
def kept_of(shape, memory, samples, period):
    """The memory at time 0."""
    m, size = len(shape.u), memory.matrices.shape[1]
    acting = np.empty(memory.lags.size, np.int64)
    for p in range(memory.lags.size):
        acting[p] = (period - min(memory.lags[p], samples)) % period * m * LANES
    estimate = np.empty(len(shape.estimate) * LANES)
    for i in range(len(shape.estimate)):
        for lane in range(LANES):
            estimate[i * LANES + lane] = memory.start[i]
    sums, value = np.zeros(len(shape.sums) * LANES), np.zeros(len(shape.tracked) * LANES)
    nowhere = np.full(LANES, -1, np.int64)
    return MemoryScratch(
        np.zeros(size * LANES),
        nowhere,
        np.zeros(memory.outputs.shape[1] * LANES),
        nowhere.copy(),
        nowhere.copy(),
        acting,
        estimate,
        sums,
        value,
        np.zeros(m * LANES),
        np.zeros(m * LANES),
        np.zeros(sums.size),
        np.ones(LANES),
    )


@inner_kernel
def predict(shape, kept, ring):
    """Take the estimates over the period that ends."""
    acting = load_each(ring, kept.acting, shape.u, shape.reaching)
    estimate = load(kept.estimate, 0, shape.estimate)
    z = first_of(estimate, acting, acting, shape.watched)
    store(kept.estimate, 0, own_product(kept.own, 0, z, same(0.0, shape.estimate)))


@inner_kernel
def follow_modes(memory, kept, mode):
    """Lay out the matrices of modes that are new."""
    lay_out(memory.matrices, kept.own, kept.mode, mode)


@inner_kernel
def follow_outputs(memory, kept, mode):
    """Lay out the outputs of the plant's modes that are new."""
    lay_out(memory.outputs, kept.outputs, kept.seen, mode)


@kernel(eager=True, nogil=True, no_cpython_wrapper=True)
def lay_out(table, own, known, mode):
    """Put each scenario's row of a table into `own`, where its mode is new."""
    for lane in range(LANES):
        if mode[lane] != known[lane]:
            known[lane] = mode[lane]
            for i in range(table.shape[1]):
                own[i * LANES + lane] = table[mode[lane], i]


@inner_kernel
def correct(shape, memory, kept, y, lost):
    """The estimates by what is heard, where anything is; and y, or what it should be."""
    x = load(kept.estimate, 0, shape.estimate)
    error = own_product(kept.own, memory.at_output * LANES, x, y)
    nearer = own_product(kept.own, memory.at_gain * LANES, error, x)
    store(kept.estimate, 0, choose(first_of(nearer, x, x, shape.estimates), lost, shape.estimate))
    assumed = times(same(-1.0, shape.output), error, y)
    return choose(first_of(y, assumed, assumed, shape.outputs), lost, shape.output)


@inner_kernel
def sum_up_errors(shape, memory, kept, y, k, limited):
    """Add the errors of the period that ends to q, and note H y."""
    value, none = product(memory.tracked, 0, y, same(0.0, shape.tracked)), same(0.0, shape.tracked)
    if k > 0 and memory.sums > 0:
        at, half = (k - 1) * memory.tracked_count, same(0.5 * memory.step, shape.tracked)
        error = times(half, load(kept.value, 0, shape.tracked), times(half, value, none))
        asked_for = product(memory.reference, at, same(-memory.step, _ONE), error)
        change = first_of(asked_for, none, none, shape.sums)
        if limited:
            store(kept.change, 0, change)
            _stop(shape, memory, kept)
        on, sums = load(kept.on, 0, _ONE), load(kept.sums, 0, shape.sums)
        more = times(same(1.0, shape.sums), change, sums)
        store(kept.sums, 0, choose(first_of(sums, more, more, shape.two_sums), on, shape.sums))
    store(kept.value, 0, value)


@kernel(eager=True, nogil=True, no_cpython_wrapper=True)
def _stop(shape, memory, kept):
    """Note where q is to grow: not where it asks for more of what an input was refused."""
    m, q = len(shape.u), len(shape.sums)
    for lane in range(LANES):
        further = 0.0
        for i in range(m):
            change = 0.0
            for j in range(q):
                push = kept.own[(memory.at_push + i * q + j) * LANES + lane]
                change += push * kept.change[j * LANES + lane]
            asked = kept.asked[i * LANES + lane]
            refused = asked - kept.before[i * LANES + lane]
            if abs(refused) > _ROUND_OFF * abs(asked):
                further += refused * change
        kept.on[lane] = 0.0 if further > 0.0 else 1.0


@inner_kernel
def remembered(shape, memory, kept, k):
    """What the law's rows are multiplied with, (x̂, q, r)."""
    at = k * memory.tracked_count
    reference = product(memory.reference, at, same(1.0, _ONE), same(0.0, shape.tracked))
    x, sums = load(kept.estimate, 0, shape.estimate), load(kept.sums, 0, shape.sums)
    return first_of(x, sums, reference, shape.known)
