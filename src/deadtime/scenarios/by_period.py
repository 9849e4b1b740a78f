"""Switching signals, and measurements within periods, by the periods of a digital loop; compiled.

As in `plant.discretisation.Cuts`, a switch within 1e-9 of a period of a sample, or of an arriving
input, counts as at it.
"""

from __future__ import annotations

import numpy as np

from deadtime.loop.received_samples import snap_number
from deadtime.numerics.kernels import kernel
from deadtime.numerics.lanes import LANES, load, same, store, times
from deadtime.scenarios.periods import Acting, Records

# Intrinsics take one argument less than the functions that declare them.
# pyright: reportCallIssue=false


@kernel(eager=True, nogil=True, no_cpython_wrapper=True)
def _place(time, step, arrival, arriving, rate):
    """The period of a switch, and seconds into it; `rate` is 1/step."""
    ratio = snap_number(time * rate)
    k = np.floor(ratio)
    if ratio == k:
        return np.int64(k), 0.0
    for a in range(arrival.size):
        # A switch at an arriving input is put exactly there, or a piece as short as round-off would
        # be left between them.
        late = snap_number((time - arriving[a] * step - arrival[a]) * rate)
        if late == np.floor(late):
            return np.int64(late) + arriving[a], arrival[a]
    return np.int64(k), time - k * step


def sample_signals(
    offset: np.ndarray,
    times: np.ndarray,
    modes: np.ndarray,
    samples: int,
    step: float,
    acting: Acting,
    plants: int,
) -> Records:
    """The records of every scenario for the periods 0, …, samples − 1.

    Scenario s has the sojourns offset[s], …, offset[s + 1] − 1; `plants` is the number of modes.
    """
    # A sojourn makes two records at most, of its cut period and of the periods after, and the last
    # period of a scenario makes two more.
    most = 2 * (modes.size + offset.size - 1)
    numbers = (np.empty(most, np.int32) for _ in range(5))
    first, last, at = (
        np.empty(offset.size, np.int64),
        np.empty(most, np.bool_),
        np.empty(modes.size),
    )
    room = Records(first, *numbers, last, at)
    arrivals = acting.arrival, acting.arriving
    r, c = fill_records(room, offset, times, modes, samples, step, *arrivals, plants)
    records, cuts = (part[:r] for part in room[1:4]), (part[:c] for part in room[4:7])
    return Records(first, *records, *cuts, at)


@kernel(eager=True, nogil=True)
def fill_records(room, offset, times, modes, samples, step, arrival, arriving, plants):
    """Fill the records of `sample_signals`; their number, and that of cut periods."""
    scenarios, rate = offset.size - 1, 1.0 / step
    final, r, c = samples - 1, 0, 0
    for s in range(scenarios):
        room.first[s] = r
        i, stop = offset[s], offset[s + 1]  # i: the sojourn that is going on
        k = 0
        while True:
            # Switches at the sample come first: the law is given the mode after them.
            ahead, within = final + 1, 0.0
            while i + 1 < stop:
                ahead, within = _place(times[i + 1], step, arrival, arriving, rate)
                if ahead != k or within > 0.0:
                    break
                i += 1
                ahead = final + 1
            room.step[r], room.mode[r], room.map[r] = k, modes[i], modes[i]
            if k == final or ahead == k:
                # The maps of cut periods are numbered behind those of every mode's whole period.
                room.map[r], room.sojourn[c], room.last[c] = plants + c, i, k == final
                while i + 1 < stop and ahead == k:
                    i += 1
                    room.at[i] = within
                    ahead = final + 1
                    if i + 1 < stop:
                        ahead, within = _place(times[i + 1], step, arrival, arriving, rate)
                room.until[c] = i + 1
                c += 1
                r += 1
                if k == final:
                    break
                k += 1
            else:
                r += 1
                # One record serves all whole periods up to the next cut one.
                k = min(ahead, final)
    room.first[scenarios] = r
    return r, c


@kernel(eager=True, nogil=True, no_cpython_wrapper=True)
def series(flat, index, cells, degrees, size, start, cell, t, width):
    """Σ_d flat[index, c, d] δ^d by Horner's rule: c the cell of t, δ ∈ [−1, 1] the place in it."""
    c = min(max(np.int64((t - start) / cell), 0), cells - 1)
    delta = same(2.0 * ((t - start) / cell - c) - 1.0, width)
    place = ((index * cells + c) * degrees + degrees - 1) * size
    value = load(flat, place, width)
    for _ in range(degrees - 1):
        place -= size
        value = times(value, delta, load(flat, place, width))
    return value


@kernel(eager=True, nogil=True)
def fill_series(found, which, row, time, edges, table, width):
    """Fill found[which[c]] from row[c] of `table` (row, part, cell, degree, size), at time[c]."""
    _, parts, cells, degrees, size = table.shape
    flat, place = table.reshape(-1), found.reshape(-1)
    for c in range(time.size):
        part = 0
        while part + 1 < parts and time[c] >= edges[part + 1]:
            part += 1
        low, cell = edges[part], (edges[part + 1] - edges[part]) / cells
        value = series(flat, row[c] * parts + part, cells, degrees, size, low, cell, time[c], width)
        store(place, which[c] * size, value)


@kernel(eager=True, nogil=True, no_cpython_wrapper=True)
def _compose(piece, column, move, energy, own):
    """Follow the map (move, energy) by a piece whose inputs are z[column]."""
    (n, wide), m = move.shape, column.size
    for a in range(wide):
        # A copy of the state at the piece's start, which the energy and every row of Φ read.
        for i in range(n):
            own[i, a] = move[i, a]
        for j in range(m):
            own[n + j, a] = 1.0 if a == column[j] else 0.0
    at = n * n + n * m
    for i in range(n + m):
        for j in range(i, n + m):
            q = piece[at]
            at += 1
            for a in range(wide):
                left = q * own[i, a]
                # Most entries are 0: the row of an input has one entry, in its column.
                if left != 0.0:
                    for b in range(wide):
                        energy[a, b] += left * own[j, b]
    for i in range(n):
        for a in range(wide):
            value = 0.0
            for j in range(n):
                value += piece[i * n + j] * own[j, a]
            for j in range(m):
                value += piece[n * n + i * m + j] * own[n + j, a]
            move[i, a] = value


@kernel(eager=True, nogil=True, no_cpython_wrapper=True)
def _compose_period(first, last, modes, at, end, acting, pieces, cell, result, room, width):
    """The map over [0, end) of a period with the sojourns first, …, last − 1."""
    cells, degrees, size = pieces.shape[1:]
    flat, n, wide = pieces.reshape(-1), acting.states, acting.wide
    move, energy, own, scratch = room
    for a in range(wide):
        for i in range(n):
            move[i, a] = 1.0 if i == a else 0.0
        for b in range(wide):
            energy[a, b] = 0.0
    start = 0.0
    for i in range(first, last):
        stop = end if i + 1 == last else min(at[i + 1], end)
        mode = modes[i]
        for s in range(acting.stretches.first[mode], acting.stretches.first[mode + 1]):
            edge = min(stop, acting.stretches.stop[s])
            if edge > start:
                value = series(flat, mode, cells, degrees, size, 0.0, cell, edge - start, width)
                store(scratch, 0, value)
                _compose(scratch, acting.column[s], move, energy, own)
                start = edge
    k = 0
    for i in range(n):
        for a in range(wide):
            result[k] = move[i, a]
            k += 1
    for a in range(wide):
        for b in range(a, wide):
            # `_compose` adds to either half; the form needs their sum as the term of z_a z_b.
            result[k] = energy[a, a] if a == b else energy[a, b] + energy[b, a]
            k += 1


@kernel(eager=True, nogil=True)
def fill_composed(maps, which, first, stop, end, modes, at, acting, pieces, step, room, width):
    """Fill maps[which[c]] with the map over [0, end[c]) of sojourns first[c], …, stop[c] − 1.

    pieces : (mode, cell, degree, size)
    """
    cell = step / pieces.shape[1]
    for c in range(which.size):
        _compose_period(
            first[c], stop[c], modes, at, end[c], acting, pieces, cell, maps[which[c]], room, width
        )


def compose_cuts(
    maps: np.ndarray,
    which: np.ndarray,
    stop: np.ndarray,
    end: np.ndarray,
    records: Records,
    modes: np.ndarray,
    acting: Acting,
    pieces: np.ndarray,
    step: float,
) -> None:
    """Fill maps[which[c]] with cut period which[c] up to `end`, before sojourn `stop`."""
    n, wide, size = acting.states, acting.wide, pieces.shape[-1]
    shapes = (n, wide), (wide, wide), (acting.column.shape[1] + n, wide), (size,)
    room, width = tuple(np.empty(shape) for shape in shapes), (0.0,) * (size // LANES)
    first = records.sojourn[which].astype(np.int64)
    given = first, stop.astype(np.int64), end, modes, records.at, acting, pieces, step, room, width
    fill_composed(maps, which, *given)


@kernel(eager=True, nogil=True)
def fill_places(
    row, place, news, lag, received, offset, begin, few, records, modes, edges, cells, count, cut,
    when,
):  # fmt: skip
    """Fill rows and places of scenarios from `begin` on; the number of measurements in cut periods.

    These have the rows count, count + 1, …, and their cut periods `cut` and instants `when`.
    row, place : (group, sample, lane), flat
    news : (group, sample), flat, set where a row differs from the sample before
    lag : of scenarios from `begin` on;  received : (few or 1, sample), the sample whose measurement
        arrives, as in `fill_lags`
    offset : (few or 1, sample), of all samples
    """
    samples, parts, noted = received.shape[1], edges.size - 1, 0
    step_of, map_of = records.step, records.map
    cell_of = np.empty(parts)
    for part in range(parts):
        cell_of[part] = (edges[part + 1] - edges[part]) / cells
    for f in range(few + -few % LANES):
        s = min(f, few - 1)
        first, last = records.first[begin + s], records.first[begin + s + 1] - 1
        times, sample = offset[min(s, offset.shape[0] - 1)], received[min(s, received.shape[0] - 1)]
        own = f // LANES * samples * LANES + f % LANES
        at, group = begin * samples + own, (begin + f) // LANES * samples
        r, known, time, now_row, part = first, -1, -1.0, 0, 0
        e, since, until = map_of[r], np.int64(step_of[r]), _until(step_of, r, last)
        for k in range(samples):
            late, delta, before = lag[own], 0.0, now_row
            if late >= 0:
                t, now = times[sample[k]], k - late
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
            own += LANES
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
