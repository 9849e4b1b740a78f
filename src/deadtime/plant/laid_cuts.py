"""Where the switches of a signal cut the stretches of the periods that they lie in."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deadtime.numerics.kernels import kernel


class LaidCuts(NamedTuple):
    """The pieces of the periods with switches, and the entries that are no whole stretch.

    Piece first[i] + j is the j-th of period[i]. Entries of one's own are numbered after the
    stretches; `stretch` has the inputs that act in them, the rest is as in a `PieceTable`.
    """

    period: np.ndarray
    first: np.ndarray
    entry: np.ndarray
    stretch: np.ndarray
    start: np.ndarray
    stop: np.ndarray
    mode: np.ndarray
    cut: np.ndarray


@kernel
def lay_cuts(stretches, cut_step, cut_offset, cut_mode, switches):
    """Lay the first `switches` switches; parts of a period under the same inputs are one entry."""
    whole, longest, m = stretches.start.size, 0, stretches.lag.shape[1]
    for i in range(stretches.first.size - 1):
        longest = max(longest, stretches.first[i + 1] - stretches.first[i])
    period, first = np.empty(switches, np.int64), np.empty(switches + 1, np.int64)
    entry = np.empty(2 * longest * switches, np.int64)
    stretch, mode_of = np.empty(entry.size, np.int64), np.empty(entry.size, np.int64)
    start, stop = np.empty(entry.size), np.empty(entry.size)
    cut = np.zeros((entry.size, 2), np.int64)
    i, e, q, p = 0, 0, 0, 0
    while p < switches:
        k, mode, now, goes_on = cut_step[p], cut_mode[p], 0.0, False
        period[i], first[i] = k, q
        s, last = stretches.first[mode], stretches.first[mode + 1]
        while s < last:
            if p < switches and cut_step[p] == k and cut_offset[p] <= now:
                p += 1
                mode = cut_mode[p]
                s, last = stretches.first[mode], stretches.first[mode + 1]
                while stretches.stop[s] <= now:
                    s += 1
                continue
            end = stretches.stop[s]
            ends = p < switches and cut_step[p] == k and cut_offset[p] < end
            if ends:
                end = cut_offset[p]
            if not ends and now == stretches.start[s]:
                entry[q] = s
                q += 1
            else:
                for j in range(m):
                    goes_on = goes_on and (stretches.lag[stretch[e - 1], j] == stretches.lag[s, j])
                if not goes_on:
                    stretch[e], start[e], mode_of[e], cut[e, 0] = s, now, mode, p
                    entry[q] = whole + e
                    e, q = e + 1, q + 1
                stop[e - 1], cut[e - 1, 1] = end, p
            now, goes_on = end, ends
            if not ends:
                s += 1
        i += 1
    first[i] = q
    return LaidCuts(
        period[:i],
        first[: i + 1],
        entry[:q],
        stretch[:e],
        start[:e],
        stop[:e],
        mode_of[:e],
        cut[:e],
    )
