"""Switching signals laid on the periods of a digital loop, many at once, compiled.

As in `plant.discretisation.Cuts`, a switch within 1e-9 of a period of a sample, or of an arriving
input, is at it.
"""

# Intrinsics take one argument less than the functions that declare them.
# pyright: reportCallIssue=false

from __future__ import annotations

import numpy as np

from deadtime.numerics.kernels import kernel
from deadtime.numerics.lanes import LANES, load, same, store, times
from deadtime.scenarios.acting import Acting
from deadtime.scenarios.records import Records

TOLERANCE = 1e-9


@kernel(eager=True, nogil=True, no_cpython_wrapper=True)
def _snap(ratio):
    nearest = np.floor(ratio + 0.5)
    return nearest if abs(ratio - nearest) <= TOLERANCE else ratio


@kernel(eager=True, nogil=True, no_cpython_wrapper=True)
def _place(time, step, arrival, arriving, rate):
    """The period that a switch falls in, and when in it; `rate` is 1/step."""
    ratio = _snap(time * rate)
    k = np.floor(ratio)
    if ratio == k:
        return np.int64(k), 0.0
    for a in range(arrival.size):
        late = _snap((time - arriving[a] * step - arrival[a]) * rate)
        if late == np.floor(late):
            return np.int64(late) + arriving[a], arrival[a]
    return np.int64(k), time - k * step


def lay(
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
    most = 2 * (modes.size + offset.size - 1)
    step_of, mode_of, map_of, sojourn, until = (np.empty(most, np.int32) for _ in range(5))
    first, last, at = (
        np.empty(offset.size, np.int64),
        np.empty(most, np.bool_),
        np.empty(modes.size),
    )
    room = Records(first, step_of, mode_of, map_of, sojourn, until, last, at)
    arrivals = acting.arrival, acting.arriving
    r, c = fill_records(room, offset, times, modes, samples, step, *arrivals, plants)
    records, cuts = (part[:r] for part in room[1:4]), (part[:c] for part in room[4:7])
    return Records(first, *records, *cuts, at)


@kernel(eager=True, nogil=True)
def fill_records(room, offset, times, modes, samples, step, arrival, arriving, plants):
    """Fill the room for records as `lay` has it: how many there are, and how many cut periods."""
    scenarios, rate = offset.size - 1, 1.0 / step
    final, r, c = samples - 1, 0, 0
    for s in range(scenarios):
        room.first[s] = r
        i, stop = offset[s], offset[s + 1]  # i: the sojourn that is going on
        k = 0
        while True:
            # Switches at the sample come first: they are what the law sees.
            ahead, within = final + 1, 0.0
            while i + 1 < stop:
                ahead, within = _place(times[i + 1], step, arrival, arriving, rate)
                if ahead != k or within > 0.0:
                    break
                i += 1
                ahead = final + 1
            room.step[r], room.mode[r], room.map[r] = k, modes[i], modes[i]
            if k == final or ahead == k:
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
                k = min(ahead, final)
    room.first[scenarios] = r
    return r, c


@kernel(eager=True, nogil=True, no_cpython_wrapper=True)
def series(flat, index, cells, degrees, size, start, cell, t, width):
    """Σ_d flat[index, c, d] δ^d: c the cell of t, δ ∈ [−1, 1] the place in it."""
    c = min(max(np.int64((t - start) / cell), 0), cells - 1)
    delta = same(2.0 * ((t - start) / cell - c) - 1.0, width)
    place = ((index * cells + c) * degrees + degrees - 1) * size
    value = load(flat, place, width)
    for _ in range(degrees - 1):
        place -= size
        value = times(value, delta, load(flat, place, width))
    return value


@kernel(eager=True, nogil=True)
def fill_series(found, row, time, edges, table, width):
    """Fill found[c] from row[c] of `table` (row, part, cell, degree, size), at time[c]."""
    _, parts, cells, degrees, size = table.shape
    flat, place = table.reshape(-1), found.reshape(-1)
    for c in range(time.size):
        part = 0
        while part + 1 < parts and time[c] >= edges[part + 1]:
            part += 1
        low, cell = edges[part], (edges[part + 1] - edges[part]) / cells
        value = series(flat, row[c] * parts + part, cells, degrees, size, low, cell, time[c], width)
        store(place, c * size, value)


@kernel(eager=True, nogil=True)
def fill_switched(maps, sojourn, alone, modes, at, edges, table, count, width):
    """Fill maps[c] of the cut periods that are `alone`, one switch in each, from series.

    table : (mode·count + mode, part, cell, degree, size)
    """
    _, parts, cells, degrees, size = table.shape
    flat, place = table.reshape(-1), maps.reshape(-1)
    for c in range(sojourn.size):
        if alone[c]:
            i = sojourn[c]
            t = at[i + 1]
            part = 0
            while part + 1 < parts and t >= edges[part + 1]:
                part += 1
            low, cell = edges[part], (edges[part + 1] - edges[part]) / cells
            index = (modes[i] * count + modes[i + 1]) * parts + part
            value = series(flat, index, cells, degrees, size, low, cell, t, width)
            store(place, c * size, value)


@kernel(eager=True, nogil=True, no_cpython_wrapper=True)
def _compose(piece, column, move, energy, own):
    """Follow the map (move, energy) by a piece whose inputs are z[column]."""
    (n, wide), m = move.shape, column.size
    for a in range(wide):
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
            result[k] = energy[a, a] if a == b else energy[a, b] + energy[b, a]
            k += 1


@kernel(eager=True, nogil=True)
def fill_composed(maps, which, first, stop, end, modes, at, acting, pieces, step, room, width):
    """Fill maps[which[c]] with what the sojourns first[c], …, stop[c] − 1 do until end[c].

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
    """Fill maps[which[c]] with what cut period which[c] does until `end`, before sojourn `stop`."""
    n, wide, size = acting.states, acting.wide, pieces.shape[-1]
    shapes = (n, wide), (wide, wide), (acting.column.shape[1] + n, wide), (size,)
    room, width = tuple(np.empty(shape) for shape in shapes), (0.0,) * (size // LANES)
    first = records.sojourn[which].astype(np.int64)
    given = first, stop.astype(np.int64), end, modes, records.at, acting, pieces, step, room, width
    fill_composed(maps, which, *given)
