"""The pieces of periods that switches cut, for kernels: `deadtime.plant.pieces.PieceTable`."""

from __future__ import annotations

import numpy as np

from deadtime.numerics.exponential import (
    add_congruence,
    discretise,
    discretise_into,
    gramian,
    product,
)
from deadtime.numerics.kernels import kernel
from deadtime.plant.pieces import PieceTable


@kernel
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
            for j in range(m):
                lag[s, j] = stretches.lag[s, j]
            discretise_into(A[i], B[i], stop[s] - start[s], Phi[s], Gamma[s])
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
                for j in range(m):
                    goes_on = goes_on and lag[e - 1, j] == lag[s, j]
                if goes_on:
                    part_Phi, part_Gamma = discretise(A[mode], B[mode], end - now)
                    go_on(Phi[e - 1], Gamma[e - 1], part_Phi, part_Gamma)
                else:
                    for j in range(m):
                        lag[e, j] = lag[s, j]
                    discretise_into(A[mode], B[mode], end - now, Phi[e], Gamma[e])
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


@kernel
def go_on(Phi, Gamma, part_Phi, part_Gamma):
    """Let a part follow on Φ, Γ, which are overwritten."""
    n, m = Gamma.shape
    moved, entered = np.empty((n, n)), np.empty((n, m))
    product(part_Phi, Phi, moved)
    product(part_Phi, Gamma, entered)
    for i in range(n):
        for j in range(n):
            Phi[i, j] = moved[i, j]
        for j in range(m):
            Gamma[i, j] = entered[i, j] + part_Gamma[i, j]


@kernel
def up_to(A, B, table, cut_offset, cut_mode, e, end):
    """Φ, Γ of entry e from its start up to `end` seconds after the period's sample."""
    n, m = B.shape[1:]
    Phi, Gamma = np.eye(n), np.zeros((n, m))
    mode, now = table.mode[e], table.start[e]
    for p in range(table.cut[e, 0], table.cut[e, 1] + 1):
        until = min(cut_offset[p], end) if p < table.cut[e, 1] else end
        if until > now:
            part_Phi, part_Gamma = discretise(A[mode], B[mode], until - now)
            go_on(Phi, Gamma, part_Phi, part_Gamma)
            now = until
        if p < table.cut[e, 1]:
            mode = cut_mode[p + 1]
    return Phi, Gamma


@kernel
def gramian_up_to(A, B, table, cut_offset, cut_mode, e, end, Q):
    """M with ∫xᵀQx dt = zᵀ M z, z = (x, u), over entry e from its start up to `end`."""
    n, m = B.shape[1:]
    M, spare, carried = np.zeros((n + m, n + m)), np.empty((n + m, n + m)), np.eye(n + m)
    Phi, Gamma = np.eye(n), np.zeros((n, m))
    mode, now = table.mode[e], table.start[e]
    for p in range(table.cut[e, 0], table.cut[e, 1] + 1):
        until = min(cut_offset[p], end) if p < table.cut[e, 1] else end
        if until > now:
            for i in range(n):
                for j in range(n):
                    carried[i, j] = Phi[i, j]
                for j in range(m):
                    carried[i, n + j] = Gamma[i, j]
            add_congruence(carried, gramian(A[mode], B[mode], until - now, Q), spare, M)
            if p < table.cut[e, 1]:
                part_Phi, part_Gamma = discretise(A[mode], B[mode], until - now)
                go_on(Phi, Gamma, part_Phi, part_Gamma)
            now = until
        if p < table.cut[e, 1]:
            mode = cut_mode[p + 1]
    return M


@kernel
def gramians(A, B, table, cut_offset, cut_mode, Q):
    """`gramian_up_to` of every entry, to its end."""
    size = B.shape[1] + B.shape[2]
    M = np.empty((table.mode.size, size, size))
    for e in range(table.mode.size):
        part = gramian_up_to(A, B, table, cut_offset, cut_mode, e, table.stop[e], Q)
        for i in range(size):
            for j in range(size):
                M[e, i, j] = part[i, j]
    return M
