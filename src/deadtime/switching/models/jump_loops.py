"""Loops over the jumps of signals; compiled, they release Python's lock."""

from __future__ import annotations

import numpy as np

from deadtime.numerics.kernels import kernel


@kernel(nogil=True)
def walk(bounds, mode, u):
    """The modes of the next sojourns of every signal, and the mode after them.

    `bounds` are cumulated probabilities of the next mode, of which each row ends in 1; `mode` is
    where each signal starts, and u (signal, jump) are numbers in (0, 1).
    """
    path = np.empty(u.shape, np.int64)
    after = np.empty(mode.size, np.int64)
    for i in range(mode.size):
        now = mode[i]
        for j in range(u.shape[1]):
            path[i, j] = now
            following = 0
            while u[i, j] >= bounds[now, following]:
                following += 1
            now = following
        after[i] = now
    return path, after


@kernel(nogil=True)
def lay(path, sojourns, time, last, horizon):
    """When the sojourns start: times and modes (signal, jump), of which the first `used` hold.

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


@kernel(nogil=True)
def place(to, rows, used, times, modes, flat_times, flat_modes):
    """Move the sojourns of a round to where their signals' next ones belong, `to`; move `to`."""
    for i in range(rows.size):
        at, kept = to[rows[i]], used[i]
        for j in range(kept):
            flat_times[at + j], flat_modes[at + j] = times[i, j], modes[i, j]
        to[rows[i]] = at + kept
