"""Maps to measurements that lie within periods, laid for the compiled loop: see `sights`."""

# Intrinsics take one argument less than the functions that declare them.
# pyright: reportCallIssue=false

from __future__ import annotations

import numpy as np

from deadtime.numerics.kernels import kernel
from deadtime.numerics.lanes import LANES, load, same, store, times


@kernel(eager=True, nogil=True)
def lay_sights(
    laid, period, offset, begin, few, records, modes, acting, n, pieces, cell, width
):  # fmt: skip
    """Lay the maps to measurements `offset` seconds into a period, scenarios from `begin` on.

    period, offset : (few or 1, sample), period −1 for no measurement
    laid : (group, sample, n, z, lane), flat
    pieces : (mode, cell, degree, size), Φ and Γ of one mode over a time; `cell` is in seconds
    """
    samples, wide, m, count = period.shape[1], acting.wide, acting.column.shape[1], pieces.shape[0]
    flat, cells, degrees, size = pieces.reshape(-1), *pieces.shape[1:]
    stretch, column = acting.stretches.first, acting.column
    opens, closes = acting.stretches.start, acting.stretches.stop
    record_step, record_map, first = records.step, records.map, records.first
    sojourn, until, at = records.sojourn, records.until, records.at
    move, moved, piece = np.empty((n, wide)), np.empty((n, wide)), np.empty(LANES * len(width))
    for f in range(few + -few % LANES):
        s, row = begin + min(f, few - 1), min(f, few - 1, period.shape[0] - 1)
        place = ((begin + f) // LANES * samples * n * wide) * LANES + f % LANES
        r, last_record, known, when = first[s], first[s + 1] - 1, -1, -1.0
        for k in range(samples):
            now, t = period[row, k], offset[row, k]
            while r < last_record and record_step[r + 1] <= now:
                r += 1
            while record_step[r] > max(now, 0):
                r -= 1
            if record_map[r] != known or t != when:
                known, when, start = record_map[r], t, 0.0
                cut = known - count
                for i in range(n):
                    for a in range(wide):
                        move[i, a] = 1.0 if i == a else 0.0
                i, stop_at = (0, 1) if cut < 0 else (sojourn[cut], until[cut])
                while i < stop_at and start < t:
                    mode = known if cut < 0 else modes[i]
                    stop = t if i + 1 == stop_at else min(at[i + 1], t)
                    for e in range(stretch[mode], stretch[mode + 1]):
                        length = min(stop, closes[e]) - max(start, opens[e])
                        if length > 0.0:
                            c = min(np.int64(length / cell), cells - 1)
                            delta = same(2.0 * (length / cell - c) - 1.0, width)
                            term = ((mode * cells + c) * degrees + degrees - 1) * size
                            value = load(flat, term, width)
                            for _ in range(degrees - 1):
                                term -= size
                                value = times(value, delta, load(flat, term, width))
                            store(piece, 0, value)
                            for p in range(n):
                                for a in range(wide):
                                    total = 0.0
                                    for q in range(n):
                                        total += piece[p * n + q] * move[q, a]
                                    moved[p, a] = total
                                for q in range(m):
                                    moved[p, column[e, q]] += piece[n * n + p * m + q]
                            for p in range(n):
                                for a in range(wide):
                                    move[p, a] = moved[p, a]
                    start = max(start, stop)
                    i += 1
            for i in range(n):
                for a in range(wide):
                    laid[place] = move[i, a]
                    place += LANES
