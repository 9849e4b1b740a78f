"""The pieces of periods that switches cut, compiled: `deadtime.plant.pieces.PieceTable`.

This module needs Numba, so it is imported where it is used.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from deadtime.numerics.exponential import discretise, energy_gramian, extend, multiply
from deadtime.plant.pieces import PieceTable


@njit(cache=True)
def pieces_along(A, B, stretches, cut_step, cut_offset, cut_mode, periods):
    """The pieces of the periods 0, …, periods − 1; switch p goes to cut_mode[p + 1].

    Entries up to the number of stretches are those of modes held; after them come the parts of
    stretches that switches begin or end. Parts of one period under the same inputs are one entry.
    """
    modes, n, m = B.shape
    whole, longest, switches = stretches.start.size, 0, 0
    for i in range(modes):
        longest = max(longest, stretches.first[i + 1] - stretches.first[i])
    while switches < cut_step.size and cut_step[switches] < periods:
        switches += 1
    first, size = np.empty(periods + 1, np.int64), whole + 2 * switches * longest
    entry = np.empty(longest * (periods + switches), np.int64)
    Phi, Gamma = np.empty((size, n, n)), np.empty((size, n, m))
    lag, mode_of = np.empty((size, m), np.int64), np.empty(size, np.int64)
    start, stop = np.empty(size), np.empty(size)
    cut = np.zeros((size, 2), np.int64)
    for i in range(modes):
        for s in range(stretches.first[i], stretches.first[i + 1]):
            start[s], stop[s], mode_of[s] = stretches.start[s], stretches.stop[s], i
            lag[s] = stretches.lag[s]
            Phi[s], Gamma[s] = discretise(A[i], B[i], stop[s] - start[s])
    e, q, p, mode = whole, 0, 0, cut_mode[0]
    for k in range(periods):
        first[k] = q
        now, goes_on = 0.0, False
        s, last = stretches.first[mode], stretches.first[mode + 1]
        while s < last:
            if p < switches and cut_step[p] == k and cut_offset[p] <= now:
                p += 1
                mode = cut_mode[p]
                s, last = stretches.first[mode], stretches.first[mode + 1]
                while stop[s] <= now:
                    s += 1
                continue
            end = stop[s]
            ends = p < switches and cut_step[p] == k and cut_offset[p] < end
            if ends:
                end = cut_offset[p]
            if not ends and now == start[s]:
                entry[q] = s
                q += 1
            else:
                part_Phi, part_Gamma = discretise(A[mode], B[mode], end - now)
                for j in range(m):
                    goes_on = goes_on and lag[e - 1, j] == lag[s, j]
                if goes_on:
                    Phi[e - 1] = multiply(part_Phi, Phi[e - 1])
                    Gamma[e - 1] = multiply(part_Phi, Gamma[e - 1]) + part_Gamma
                else:
                    Phi[e], Gamma[e], lag[e] = part_Phi, part_Gamma, lag[s]
                    start[e], mode_of[e], cut[e, 0] = now, mode, p
                    entry[q] = e
                    e, q = e + 1, q + 1
                stop[e - 1], cut[e - 1, 1] = end, p
            now, goes_on = end, ends
            if not ends:
                s += 1
    first[periods] = q
    return PieceTable(
        first, entry[:q], Phi[:e], Gamma[:e], lag[:e], start[:e], stop[:e], mode_of[:e], cut[:e]
    )


@njit(cache=True)
def up_to(A, B, table, cut_offset, cut_mode, e, end):
    """Φ, Γ of entry e from its start up to `end` seconds after the period's sample."""
    n, m = B.shape[1:]
    Phi, Gamma = np.eye(n), np.zeros((n, m))
    mode, now = table.mode[e], table.start[e]
    for p in range(table.cut[e, 0], table.cut[e, 1] + 1):
        until = min(cut_offset[p], end) if p < table.cut[e, 1] else end
        if until > now:
            part_Phi, part_Gamma = discretise(A[mode], B[mode], until - now)
            Phi, Gamma = multiply(part_Phi, Phi), multiply(part_Phi, Gamma) + part_Gamma
            now = until
        if p < table.cut[e, 1]:
            mode = cut_mode[p + 1]
    return Phi, Gamma


@njit(cache=True)
def gramian_up_to(A, B, table, cut_offset, cut_mode, e, end, Q=None):
    """M with ∫xᵀQx dt = zᵀ M z, z = (x, u), over entry e from its start up to `end`."""
    n, m = B.shape[1:]
    M, transition = np.zeros((n + m, n + m)), np.eye(n + m)
    mode, now = table.mode[e], table.start[e]
    for p in range(table.cut[e, 0], table.cut[e, 1] + 1):
        until = min(cut_offset[p], end) if p < table.cut[e, 1] else end
        if until > now:
            part = energy_gramian(A[mode], B[mode], until - now, Q)
            M += multiply(multiply(transition.T, part), transition)
            transition = multiply(extend(*discretise(A[mode], B[mode], until - now)), transition)
            now = until
        if p < table.cut[e, 1]:
            mode = cut_mode[p + 1]
    return M


@njit(cache=True)
def gramians(A, B, table, cut_offset, cut_mode, Q=None):
    """`gramian_up_to` of every entry, to its end."""
    size = B.shape[1] + B.shape[2]
    M = np.empty((table.mode.size, size, size))
    for e in range(table.mode.size):
        M[e] = gramian_up_to(A, B, table, cut_offset, cut_mode, e, table.stop[e], Q)
    return M
