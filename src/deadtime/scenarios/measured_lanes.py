"""Measurements and modes as they reach the laws of eight scenarios: late, lost, noisy or wrong.

`loop.received_samples.Received` has them, drawn before the run.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deadtime.numerics.kernels import inner_kernel, kernel
from deadtime.numerics.lanes import (
    LANES,
    choose,
    first_of,
    gather,
    load,
    matrix_product,
    own_product,
    same,
    spread,
    times,
)

# Intrinsics take one argument less than the functions that declare them.
# pyright: reportCallIssue=false


_ONE = (0.0,)


class Recent(NamedTuple):
    """The last states of eight scenarios, and the places of the received measurements.

    states : (lane, slot, seen), flat, a ring; with measurements within periods (lane, slot, z)
    slot : (1,), of x_k;  places : (lane,), of the received measurements
    lost : (lane,), 1 where nothing is received;  number : (lane,), the row of the law's table
    row : (lane,), of `InstantLanes`;  own : (degree, n, z, lane), flat, its content
    """

    states: np.ndarray
    slot: np.ndarray
    places: np.ndarray
    lost: np.ndarray
    number: np.ndarray
    row: np.ndarray
    own: np.ndarray


@kernel(eager=True, nogil=True)
def recent_of(shape, relayed, instants):
    """Room for the states back to the longest lag, and for their inputs if need be."""
    size = len(shape.seen) if instants is None else len(shape.z)
    states = np.zeros(LANES * (relayed.reach + 1) * size)
    slot, places = np.zeros(1, np.int64), np.zeros(LANES, np.int64)
    row = np.full(LANES, -1, np.int64)
    own = np.zeros(0 if instants is None else instants.series.shape[1] * LANES)
    return Recent(states, slot, places, np.zeros(LANES), np.zeros(LANES), row, own)


@inner_kernel
def receive(shape, relayed, recent, x, at):
    """The measurements of the samples that the lags at `at` choose."""
    n, slots, slot = len(shape.seen), relayed.reach + 1, recent.slot[0]
    spread(recent.states, slot * n, slots * n, x)
    _look_back(relayed, recent, at, slots, n)
    recent.slot[0] = 0 if slot + 1 == slots else slot + 1
    return gather(recent.states, recent.places, shape.seen)


@inner_kernel
def see(shape, relayed, instants, recent, x, at):
    """The measurement at an instant within a period; `go_on` adds the inputs of the period."""
    size, slots = len(shape.z), relayed.reach + 1
    spread(recent.states, recent.slot[0] * size, slots * size, x)
    _look_back(relayed, recent, at, slots, size)
    if instants.news[at // LANES]:
        _load_series(instants, recent, at)
    z, delta = gather(recent.states, recent.places, shape.z), load(instants.place, at, _ONE)
    block = len(shape.x) * size * LANES
    x = same(0.0, shape.x)
    # Horner's rule over the degrees of the series in time, the highest first.
    for part in range(recent.own.size - block, -1, -block):
        x = matrix_product(x, delta, own_product(recent.own, part, z, same(0.0, shape.x)))
    return x


@kernel(eager=True, nogil=True, no_cpython_wrapper=True)
def _load_series(instants, recent, at):
    """Copy the series into the lanes of scenarios whose row has changed."""
    several, cut_size = len(instants.series), instants.cuts.shape[1]
    for lane in range(LANES):
        row = np.int64(instants.row[at + lane])
        if row != recent.row[lane]:
            recent.row[lane] = row
            for i in range(instants.series.shape[1]):
                # A cut period has a map for one instant, a series of degree 0: clear the rest.
                value = 0.0
                if row < several:
                    value = instants.series[row, i]
                elif i < cut_size:
                    value = instants.cuts[row - several, i]
                recent.own[i * LANES + lane] = value


@inner_kernel
def go_on(shape, relayed, recent, acting):
    """Put the inputs that act in this period beside its x."""
    size, slots, slot = len(shape.z), relayed.reach + 1, recent.slot[0]
    spread(recent.states, slot * size + len(shape.x), slots * size, acting)
    recent.slot[0] = 0 if slot + 1 == slots else slot + 1


@inner_kernel
def _look_back(relayed, recent, at, slots, size):
    """Note the places of the received measurements, and the scenarios without one."""
    slot = recent.slot[0]
    for lane in range(LANES):
        lag = np.int64(relayed.lag[at + lane])
        recent.lost[lane] = 1.0 if lag < 0 else 0.0
        # Of a lost sample any place will do: `lost` masks its value.
        place = slot - max(lag, 0)
        place += slots if place < 0 else 0
        recent.places[lane] = (lane * slots + place) * size


@inner_kernel
def add_noise(shape, relayed, x, at):
    """The measurement x with its noise added."""
    return times(same(1.0, shape.seen), x, load(relayed.noise, at * len(shape.seen), shape.seen))


@inner_kernel
def receive_rows(relayed, recent, at):
    """Note the row of the law's table in every scenario."""
    for lane in range(LANES):
        recent.number[lane] = relayed.row[at + lane]


@inner_kernel
def receive_modes(relayed, mode, at):
    """Note the mode that is reported in every scenario."""
    for lane in range(LANES):
        mode[lane] = relayed.mode[at + lane]


@inner_kernel
def reported_rows(recent, row):
    """Put the rows of the reported modes in place of those of the plant's."""
    for lane in range(LANES):
        row[lane] = np.int64(recent.number[lane])


@inner_kernel
def command(shape, recent, u, before):
    """The command: u, or the one before where no measurement was received."""
    both = first_of(u, before, before, shape.pair)
    return choose(both, load(recent.lost, 0, _ONE), shape.u)
