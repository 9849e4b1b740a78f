"""The loops of `deadtime.switching.models.drawing` over scenarios, compiled.

They release Python's lock. This module needs Numba, so it is imported where it is used.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from deadtime.numerics.philox import WORDS, block_words, uniform


@njit(cache=True, nogil=True)
def first_modes(key, scenarios, stream, modes):
    """A uniformly drawn mode for every scenario."""
    result = np.empty(scenarios.size, np.int64)
    for i in range(scenarios.size):
        word, _, _, _ = block_words(key, 0, scenarios[i], stream)
        result[i] = int(uniform(word) * modes)
    return result


@njit(cache=True, nogil=True)
def _next(bounds, mode, u):
    """The first entry of a row of cumulated probabilities, which ends in 1, that exceeds u."""
    j = 0
    while u >= bounds[mode, j]:
        j += 1
    return j


@njit(cache=True, nogil=True)
def paths(bounds, mode, key, scenarios, stream, start, blocks):
    """The modes of the next 4·blocks sojourns of every scenario, and the mode after them."""
    path = np.empty((scenarios.size, WORDS * blocks), np.int64)
    after = np.empty(scenarios.size, np.int64)
    for i in range(scenarios.size):
        now = mode[i]
        for b in range(blocks):
            words = block_words(key, start + b, scenarios[i], stream)
            for w in range(WORDS):
                path[i, WORDS * b + w] = now
                now = _next(bounds, now, uniform(words[w]))
        after[i] = now
    return path, after


@njit(cache=True, nogil=True)
def starts(path, sojourns, time, last, horizon):
    """When the sojourns start: times and modes (count, jumps), of which the first `used` hold.

    `time` is where the first sojourn of each row starts and `last` the mode before it, −1 for
    none. A sojourn whose ends are one number is left out, and one in the mode before it goes on
    with that. Returns also the time and the last mode after the row; a time that is not below
    the horizon ends the signal.
    """
    count, jumps = path.shape
    times, modes = np.empty((count, jumps)), np.empty((count, jumps), np.int64)
    used, end, held = np.zeros(count, np.int64), time.copy(), last.copy()
    for i in range(count):
        t, mode, kept = time[i], last[i], 0
        for j in range(jumps):
            then = t + sojourns[i, j]
            if then > t and path[i, j] != mode:
                mode = path[i, j]
                times[i, kept], modes[i, kept] = t, mode
                kept += 1
            t = then
            if not t < horizon:
                break
        used[i], end[i], held[i] = kept, t, mode
    return times, modes, used, end, held


@njit(cache=True, nogil=True)
def place(to, rows, used, times, modes, flat_times, flat_modes):
    """Move the sojourns of a round to where their scenarios' next ones belong, `to`; move `to`."""
    for i in range(rows.size):
        at = to[rows[i]]
        for j in range(used[i]):
            flat_times[at + j] = times[i, j]
            flat_modes[at + j] = modes[i, j]
        to[rows[i]] = at + used[i]
