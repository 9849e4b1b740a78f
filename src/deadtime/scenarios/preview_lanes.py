"""Laws that know the signal, eight scenarios at once: their model moves ahead of the plant.

At t_k the prediction takes x_k over the W = ⌊D/h⌋ periods that lie ahead and over the rest φ' of
the delay, 0 ≤ φ' < h (`deadtime.feedback.preview`). Over a period p the model does the affine
map x → Φ_p x + Γ_p z_p, its inputs z_p being in flight, so what is needed is the composition of
the last W such maps: a window that slides by one a period. Two stacks do it without inverting
anything: maps that enter are composed into `back`, and once the window's first half is used up,
the maps in it become suffixes, slot r the composition of all from r on. The prediction goes
through slot r, then through `back`. A period costs three products of matrices, whatever W is,
and every prediction starts from the x_k that was measured.
"""

# Intrinsics take one argument less than the functions that declare them.
# pyright: reportCallIssue=false

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deadtime.numerics.kernels import inner_kernel, kernel
from deadtime.numerics.lanes import (
    LANES,
    first_of,
    load,
    load_each,
    matrix_product,
    own_product,
    same,
    store,
    table_product,
)
from deadtime.scenarios.lane_types import LoopSizes

_NEVER = np.int64(2**62)


class KnownSignalModel(NamedTuple):
    """A law's model along signals that it knows, of each scenario its own or one for all.

    length : W;  lags, maps, first, step, map : as of `kernel.Plant`, over W periods more
    tails : (maps, m (n + m)), what the prediction after W periods and the latest input are
        multiplied by, up to t_k + D and by the gain there
    """

    length: int
    lags: np.ndarray
    maps: np.ndarray
    first: np.ndarray
    step: np.ndarray
    map: np.ndarray
    tails: np.ndarray


class Stacks(NamedTuple):
    """Memory of eight scenarios: the two stacks, and what holds in the period that enters.

    stack : slots of Φ (n, n) and v (n,);  back : one more;  own : the period's map, flat
    tail : m (n + m);  row : where the rows of `own` begin
    at, stop, coming : as of `kernel.Work`, W periods early;  acting : as there
    """

    stack: np.ndarray
    back: np.ndarray
    own: np.ndarray
    tail: np.ndarray
    row: np.ndarray
    at: np.ndarray
    stop: np.ndarray
    coming: np.ndarray
    acting: np.ndarray


def stacks_of(shape: LoopSizes, model: KnownSignalModel) -> Stacks:
    """Room for eight scenarios."""
    n, m, wide = shape.x, shape.u, shape.model
    slot = (n * n + n) * LANES
    sizes = max(1, model.length) * slot, slot, n * wide * LANES, m * (n + m) * LANES
    row = wide * LANES * np.arange(n)
    lanes = [np.empty(LANES, np.int64) for _ in range(3)]
    return Stacks(*map(np.empty, sizes), row, *lanes, np.empty(model.lags.size, np.int64))


@kernel(eager=True, nogil=True, no_cpython_wrapper=True)
def look_ahead(shape, model, ahead, start, count, period):
    """The stacks at time 0, when the first W periods are in; when the next records enter.

    Inputs from before time 0 are 0.
    """
    m, soon = len(shape.u), -np.int64(model.length) * LANES
    for p in range(model.lags.size):
        ahead.acting[p] = (period + model.length - model.lags[p]) % period * m * LANES
    for lane in range(LANES):
        scenario = 0 if model.first.size == 2 else start + min(lane, count - 1)
        ahead.at[lane], ahead.stop[lane] = model.first[scenario], model.first[scenario + 1]
        ahead.coming[lane] = soon + lane
    clear(shape, ahead)
    for k in range(-model.length, 0):
        soon = turn(model, ahead, k, soon)
        enter(shape, ahead, same(0.0, shape.entering), k + model.length)
    return soon


@kernel(eager=True, nogil=True, no_cpython_wrapper=True)
def clear(shape, ahead):
    """Nothing in `back`."""
    n = len(shape.x)
    for i in range(ahead.back.size):
        ahead.back[i] = 0.0
    for i in range(n):
        store(ahead.back, (i * n + i) * LANES, same(1.0, (0.0,)))


@kernel(eager=True, nogil=True, no_cpython_wrapper=True)
def turn(model, ahead, k, soon):
    """Apply the records of the period that enters at t_k; when the next one does."""
    while soon // LANES == k:
        lane = soon % LANES
        record = ahead.at[lane]
        ahead.at[lane] += 1
        row = model.map[record]
        for i in range(ahead.own.size // LANES):
            ahead.own[i * LANES + lane] = model.maps[row, i]
        for i in range(ahead.tail.size // LANES):
            ahead.tail[i * LANES + lane] = model.tails[row, i]
        ahead.coming[lane] = _NEVER
        if ahead.at[lane] < ahead.stop[lane]:
            step = np.int64(model.step[ahead.at[lane]]) - model.length
            ahead.coming[lane] = step * LANES + lane
        soon = _NEVER
        for other in range(LANES):
            soon = min(soon, ahead.coming[other])
    return soon


@inner_kernel
def enter(shape, ahead, acting, slot):
    """Put the period that enters, under its inputs, into `back`, and by itself into a slot."""
    n = len(shape.x)
    size = n * n * LANES
    Phi = load_each(ahead.own, ahead.row, shape.x, shape.square)
    zero = same(0.0, shape.x)
    entered = own_product(ahead.own, 0, first_of(zero, acting, acting, shape.model), zero)
    place = slot * (size + n * LANES)
    store(ahead.stack, place, Phi)
    store(ahead.stack, place + size, entered)
    moved = table_product(Phi, load(ahead.back, 0, shape.square), same(0.0, shape.square))
    v = matrix_product(Phi, load(ahead.back, size, shape.x), entered)
    store(ahead.back, 0, moved)
    store(ahead.back, size, v)


@kernel(eager=True, nogil=True, no_cpython_wrapper=True)
def sum_up(shape, length, ahead):
    """Make the maps in the slots suffixes: slot r the composition of all from r on."""
    n = len(shape.x)
    size = n * n * LANES
    slot = size + n * LANES
    for r in range(length - 2, -1, -1):
        later = load(ahead.stack, (r + 1) * slot, shape.square)
        v = load(ahead.stack, (r + 1) * slot + size, shape.x)
        first = load(ahead.stack, r * slot, shape.square)
        entered = load(ahead.stack, r * slot + size, shape.x)
        store(ahead.stack, r * slot, table_product(later, first, same(0.0, shape.square)))
        store(ahead.stack, r * slot + size, matrix_product(later, entered, v))
    clear(shape, ahead)


@inner_kernel
def foresee(shape, length, ahead, slot, x, latest):
    """The input: x predicted through a slot, `back` and the tail."""
    size = len(shape.x) * len(shape.x) * LANES
    if length > 0:
        place = slot * (size + len(shape.x) * LANES)
        v = load(ahead.stack, place + size, shape.x)
        x = matrix_product(load(ahead.stack, place, shape.square), x, v)
        v = load(ahead.back, size, shape.x)
        x = matrix_product(load(ahead.back, 0, shape.square), x, v)
    z = first_of(x, latest, latest, shape.both)
    return own_product(ahead.tail, 0, z, same(0.0, shape.u))
