"""What the laws of eight scenarios hear: samples late or lost, noise, rows by the modes told.

`layout.Told` has it, drawn before the run.
"""

# Intrinsics take one argument less than the functions that declare them.
# pyright: reportCallIssue=false

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from deadtime.numerics.lanes import LANES, choose, first_of, gather, load, same, spread, times

_ONE = (0.0,)


class Memory(NamedTuple):
    """The last states of eight scenarios, scenario by scenario, and where to read in them."""

    states: np.ndarray
    places: np.ndarray


@njit(cache=True, nogil=True)
def memory_of(shape, told):
    """Room for as many states as are looked back to."""
    return Memory(np.zeros(LANES * (told.reach + 1) * len(shape.x)), np.zeros(LANES, np.int64))


@njit(cache=True, nogil=True, inline="always")
def hear(shape, told, memory, x, at, k):
    """What the law takes x_k to be; `at` counts samples from the first of all groups."""
    n, slots = len(shape.x), told.reach + 1
    spread(memory.states, k % slots * n, slots * n, x)
    for lane in range(LANES):
        sample = max(0, told.sample[at * LANES + lane])
        memory.places[lane] = (lane * slots + sample % slots) * n
    heard = gather(memory.states, memory.places, shape.x)
    return times(same(1.0, shape.x), heard, load(told.noise, at * n * LANES, shape.x))


@njit(cache=True, nogil=True, inline="always")
def command(shape, told, u, before, at):
    """What is asked for: u, or what was asked for before where nothing was heard."""
    both = first_of(u, before, before, shape.pair)
    return choose(both, load(told.lost, at * LANES, _ONE), shape.u)
