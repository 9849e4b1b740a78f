"""What the laws of eight scenarios hear: samples late or lost, noise, rows by the modes told.

`layout.Told` has it, drawn before the run.
"""

# Intrinsics take one argument less than the functions that declare them.
# pyright: reportCallIssue=false

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deadtime.numerics.kernels import kernel
from deadtime.numerics.lanes import LANES, choose, first_of, gather, load, same, spread, times

_ONE = (0.0,)


class Memory(NamedTuple):
    """The last states of eight scenarios, scenario by scenario, and where to read in them.

    begin : where a scenario begins in `layout.Told`, and where its noise lies
    lost : 1 where nothing is heard;  number : the row of the law's table, as `choose` reads it
    """

    states: np.ndarray
    places: np.ndarray
    begin: np.ndarray
    added: np.ndarray
    lost: np.ndarray
    number: np.ndarray


@kernel(eager=True, nogil=True)
def memory_of(shape, told, samples, first, count):
    """Room for as many states as are looked back to; `first` is the first scenario's number."""
    states = np.zeros(LANES * (told.reach + 1) * len(shape.x))
    begin = samples * (first + np.minimum(np.arange(LANES), count - 1))
    places, added = np.zeros(LANES, np.int64), np.zeros(LANES, np.int64)
    return Memory(states, places, begin, added, np.zeros(LANES), np.zeros(LANES))


@kernel(eager=True, nogil=True, inline="always")
def hear(shape, told, memory, x, k):
    """What the law takes x_k to be."""
    n, slots = len(shape.x), told.reach + 1
    spread(memory.states, k % slots * n, slots * n, x)
    for lane in range(LANES):
        at = memory.begin[lane] + k
        memory.added[lane] = at * n
        sample = told.sample[at]
        memory.lost[lane] = 1.0 if sample < 0 else 0.0
        memory.places[lane] = (lane * slots + max(0, sample) % slots) * n
        if told.row.size > 0:
            memory.number[lane] = told.row[at]
    heard = gather(memory.states, memory.places, shape.x)
    if told.noise.size > 0:
        heard = times(same(1.0, shape.x), heard, gather(told.noise, memory.added, shape.x))
    return heard


@kernel(eager=True, nogil=True, inline="always")
def told_rows(told, memory, row):
    """Put the rows of the modes told in place of those of the plant's."""
    if told.row.size > 0:
        for lane in range(LANES):
            row[lane] = np.int64(memory.number[lane])


@kernel(eager=True, nogil=True, inline="always")
def command(shape, memory, u, before):
    """What is asked for: u, or what was asked for before where nothing was heard."""
    both = first_of(u, before, before, shape.pair)
    return choose(both, load(memory.lost, 0, _ONE), shape.u)
