"""Maps to measurements that lie within periods, laid for the compiled loop: see `sights`."""

# Intrinsics take one argument less than the functions that declare them.
# pyright: reportCallIssue=false

from __future__ import annotations

import numpy as np

from deadtime.numerics.kernels import kernel
from deadtime.numerics.lanes import LANES, store
from deadtime.scenarios.laid import series


@kernel(eager=True, nogil=True)
def lay_sights(
    laid, period, offset, begin, few, records, modes, acting, n, pieces, cell, width
):  # fmt: skip
    """Lay the maps to measurements `offset` seconds into a period, scenarios from `begin` on.

    period, offset : (few or 1, sample), period −1 for no measurement
    laid : (group, sample, n, z, lane), flat
    """
    samples, wide = period.shape[1], acting.wide
    flat, cells, degrees, size = pieces.reshape(-1), *pieces.shape[1:]
    place = (cells, degrees, size, cell)
    move, moved, scratch = np.empty((n, wide)), np.empty((n, wide)), np.empty(8 * len(width))
    for f in range(few + -few % LANES):
        s, row = begin + min(f, few - 1), min(f, few - 1, period.shape[0] - 1)
        group, lane = (begin + f) // LANES, f % LANES
        record, known, when = records.first[s], -1, -1.0
        for k in range(samples):
            now, t = period[row, k], offset[row, k]
            while record + 1 < records.first[s + 1] and records.step[record + 1] <= now:
                record += 1
            while records.step[record] > max(now, 0):
                record -= 1
            if records.map[record] != known or t != when:
                known, when = records.map[record], t
                for i in range(n):
                    for a in range(wide):
                        move[i, a] = 1.0 if i == a else 0.0
                cut = known - pieces.shape[0]
                if cut < 0:
                    _go_on(known, 0.0, t, acting, flat, place, width, move, moved, scratch)
                else:
                    start = 0.0
                    for i in range(records.sojourn[cut], records.until[cut]):
                        last = i + 1 == records.until[cut]
                        stop = t if last else min(records.at[i + 1], t)
                        _go_on(
                            modes[i], start, stop, acting, flat, place, width, move, moved, scratch
                        )
                        start = max(start, stop)
            at = ((group * samples + k) * n * wide) * LANES + lane
            for i in range(n):
                for a in range(wide):
                    laid[at] = move[i, a]
                    at += LANES


@kernel(eager=True, nogil=True)
def _go_on(mode, start, stop, acting, flat, place, width, move, moved, scratch):
    """Follow a map by a mode from `start` to `stop`, seconds into the period."""
    n, wide = move.shape
    cells, degrees, size, cell = place
    for s in range(acting.stretches.first[mode], acting.stretches.first[mode + 1]):
        begin, end = max(start, acting.stretches.start[s]), min(stop, acting.stretches.stop[s])
        if end <= begin:
            continue
        value = series(flat, mode, cells, degrees, size, 0.0, cell, end - begin, width)
        store(scratch, 0, value)
        m = acting.column.shape[1]
        for i in range(n):
            for a in range(wide):
                value_at = 0.0
                for j in range(n):
                    value_at += scratch[i * n + j] * move[j, a]
                moved[i, a] = value_at
            for j in range(m):
                moved[i, acting.column[s, j]] += scratch[n * n + i * m + j]
        for i in range(n):
            for a in range(wide):
                move[i, a] = moved[i, a]
