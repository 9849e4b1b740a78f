"""What the laws of eight scenarios hear: samples late or lost, noise, rows by the modes told.

`layout.Relayed` has it, drawn before the run.
"""

# Intrinsics take one argument less than the functions that declare them.
# pyright: reportCallIssue=false

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deadtime.numerics.kernels import kernel
from deadtime.numerics.lanes import LANES, choose, first_of, gather, load, same, spread, times

_ONE = (0.0,)


class Recent(NamedTuple):
    """The last states of eight scenarios, scenario by scenario, and where to read in them.

    slot : of x_k, one number;  places : where what is heard lies
    lost : 1 where nothing is heard;  number : the row of the law's table, as `choose` reads it
    """

    states: np.ndarray
    slot: np.ndarray
    places: np.ndarray
    lost: np.ndarray
    number: np.ndarray


@kernel(eager=True, nogil=True)
def recent_of(shape, relayed):
    """Room for as many states as are looked back to."""
    states = np.zeros(LANES * (relayed.reach + 1) * len(shape.x))
    slot, places = np.zeros(1, np.int64), np.zeros(LANES, np.int64)
    return Recent(states, slot, places, np.zeros(LANES), np.zeros(LANES))


@kernel(eager=True, nogil=True, inline="always")
def hear(shape, relayed, recent, x, at):
    """The state that was measured as long before x_k as is said at `at`."""
    n, slots, slot = len(shape.x), relayed.reach + 1, recent.slot[0]
    spread(recent.states, slot * n, slots * n, x)
    for lane in range(LANES):
        lag = np.int64(relayed.lag[at + lane])
        recent.lost[lane] = 1.0 if lag < 0 else 0.0
        place = slot - max(lag, 0)
        place += slots if place < 0 else 0
        recent.places[lane] = (lane * slots + place) * n
    recent.slot[0] = 0 if slot + 1 == slots else slot + 1
    return gather(recent.states, recent.places, shape.x)


@kernel(eager=True, nogil=True, inline="always")
def add_noise(shape, relayed, x, at):
    """What the law takes x to be."""
    return times(same(1.0, shape.x), x, load(relayed.noise, at * len(shape.x), shape.x))


@kernel(eager=True, nogil=True, inline="always")
def hear_rows(relayed, recent, at):
    """Note the row of the law's table in every scenario."""
    for lane in range(LANES):
        recent.number[lane] = relayed.row[at + lane]


@kernel(eager=True, nogil=True, inline="always")
def told_rows(recent, row):
    """Put the rows of the modes told in place of those of the plant's."""
    for lane in range(LANES):
        row[lane] = np.int64(recent.number[lane])


@kernel(eager=True, nogil=True, inline="always")
def command(shape, recent, u, before):
    """What is asked for: u, or what was asked for before where nothing was heard."""
    both = first_of(u, before, before, shape.pair)
    return choose(both, load(recent.lost, 0, _ONE), shape.u)
