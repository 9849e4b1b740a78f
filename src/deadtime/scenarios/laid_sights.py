"""Measurements that lie within periods, laid for the compiled loop: see `sights`."""

# Intrinsics take one argument less than the functions that declare them.
# pyright: reportCallIssue=false

from __future__ import annotations

import numpy as np

from deadtime.numerics.kernels import kernel
from deadtime.numerics.lanes import LANES, store
from deadtime.scenarios.laid import TOLERANCE, series


@kernel(eager=True, nogil=True)
def find_instants(missing, early, step, period, offset):
    """Fill in the period, −1 before time 0, and the seconds into it at which x is measured.

    As `simulation.loop_arrays.MeasurementLags.instants`: missing, early (runs or 1,
    samples or 1), the others (runs, samples).
    """
    runs, samples = period.shape
    for s in range(runs):
        a, b = min(s, missing.shape[0] - 1), min(s, early.shape[0] - 1)
        for k in range(samples):
            lost = missing[a, min(k, missing.shape[1] - 1)]
            ratio = _snap(k - (lost + early[b, min(k, early.shape[1] - 1)]) / step)
            ratio = ratio if ratio > 0.0 else 0.0
            whole = np.floor(ratio)
            period[s, k] = -1 if _snap(k - lost / step) < 0.0 else np.int64(whole)
            offset[s, k] = (ratio - whole) * step


@kernel(eager=True, nogil=True)
def _snap(ratio):
    nearest = np.rint(ratio)
    return nearest if abs(ratio - nearest) <= TOLERANCE else ratio


@kernel(eager=True, nogil=True)
def lay_periods(lag, reach, heard, period, begin, few):
    """Fill `lag` of scenarios from `begin` on; the longest, `reach` at least.

    heard : (few or 1, sample), whose measurement is heard, −1 for none;  period : as above, when
        that is taken
    """
    samples = heard.shape[1]
    at = begin * samples
    for first in range(0, few, LANES):
        for k in range(samples):
            for lane in range(LANES):
                s = min(first + lane, few - 1)
                j = heard[min(s, heard.shape[0] - 1), k]
                now = -1 if j < 0 else period[min(s, period.shape[0] - 1), j]
                lag[at] = -1 if now < 0 else k - now
                reach = max(reach, lag[at])
                at += 1
    return reach


@kernel(eager=True, nogil=True)
def lay_places(
    row, place, news, lag, heard, offset, begin, few, records, modes, edges, cells, count, cut,
    when,
):  # fmt: skip
    """Fill rows and places of scenarios from `begin` on; how many measurements lie in cut periods.

    These have the rows count, count + 1, …, and are noted: cut period `cut` at `when`.
    lag, row, place : (group, sample, lane), flat;  news : (group, sample), flat, set where a row
        is another one than before;  heard : as in `lay_periods`
    offset : (few or 1, sample), of all samples
    """
    samples, parts, noted = heard.shape[1], edges.size - 1, 0
    step_of, map_of = records.step, records.map
    cell_of = np.empty(parts)
    for part in range(parts):
        cell_of[part] = (edges[part + 1] - edges[part]) / cells
    for f in range(few + -few % LANES):
        s = min(f, few - 1)
        times, told = offset[min(s, offset.shape[0] - 1)], heard[min(s, heard.shape[0] - 1)]
        first, last = records.first[begin + s], records.first[begin + s + 1] - 1
        at = (begin + f) // LANES * samples * LANES + f % LANES
        group = (begin + f) // LANES * samples
        r, known, time, now_row, part = first, -1, -1.0, 0, 0
        e, since, until = map_of[r], np.int64(step_of[r]), _until(step_of, r, last)
        for k in range(samples):
            late, delta, before = lag[at], 0.0, now_row
            if late >= 0:
                t, now = times[told[k]], k - late
                if now >= until or now < since:
                    while r < last and step_of[r + 1] <= now:
                        r += 1
                    while step_of[r] > now:
                        r -= 1
                    e, since, until = map_of[r], np.int64(step_of[r]), _until(step_of, r, last)
                if e < modes:
                    part = 0
                    while part + 1 < parts and t >= edges[part + 1]:
                        part += 1
                    place_in = (t - edges[part]) / cell_of[part]
                    c = min(np.int64(place_in), cells - 1)
                    delta = 2.0 * (place_in - c) - 1.0
                    now_row = (e * parts + part) * cells + c
                elif e != known or t != time:
                    cut[noted], when[noted], now_row = e - modes, t, count + noted
                    noted += 1
                known, time = e, t
            row[at], place[at] = now_row, delta
            if k == 0 or now_row != before:
                news[group + k] = True
            at += LANES
    return noted


@kernel(eager=True, nogil=True, no_cpython_wrapper=True)
def _until(step, r, last):
    """The period with which the record after r begins, or one that no run reaches."""
    return np.int64(step[r + 1]) if r < last else np.int64(2**62)


@kernel(eager=True, nogil=True)
def follow_cuts(moves, cut, when, records, modes, acting, pieces, cell, width):
    """Fill moves[c] (n, z) with the map of a cut period up to a measurement, for each noted.

    pieces : (mode, cell, degree, size), Φ and Γ of one mode over a time; `cell` is in seconds
    """
    n, wide, m = moves.shape[1], moves.shape[2], acting.column.shape[1]
    flat, cells, degrees, size = pieces.reshape(-1), *pieces.shape[1:]
    stretch, column = acting.stretches.first, acting.column
    opens, closes = acting.stretches.start, acting.stretches.stop
    moved, piece = np.empty((n, wide)), np.empty(LANES * len(width))
    for c in range(cut.size):
        move, start, t = moves[c], 0.0, when[c]
        for p in range(n):
            for a in range(wide):
                move[p, a] = 1.0 if p == a else 0.0
        i, until = records.sojourn[cut[c]], records.until[cut[c]]
        while i < until and start < t:
            mode, stop = modes[i], t if i + 1 == until else min(records.at[i + 1], t)
            for e in range(stretch[mode], stretch[mode + 1]):
                length = min(stop, closes[e]) - max(start, opens[e])
                if length > 0.0:
                    value = series(flat, mode, cells, degrees, size, 0.0, cell, length, width)
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
