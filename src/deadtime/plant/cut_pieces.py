"""The pieces of periods that switches cut: `deadtime.plant.pieces.PieceTable`."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from deadtime.base.checks import read_only
from deadtime.numerics.exponential import (
    add_congruence,
    discretise,
    discretise_into,
    gramian,
    product,
)
from deadtime.numerics.kernels import kernel
from deadtime.numerics.stacked import discretise_all
from deadtime.plant.laid_cuts import LaidCuts, lay_cuts
from deadtime.plant.parts import consecutive, gramians_at_once, transitions_at_once
from deadtime.plant.pieces import PieceTable, Stretches

FEW = 24  # entries and switches, of which the transitions are kept


def pieces_along(
    A: np.ndarray,
    B: np.ndarray,
    stretches: Stretches,
    cut_step: np.ndarray,
    cut_offset: np.ndarray,
    cut_mode: np.ndarray,
    periods: int,
    whole: tuple[np.ndarray, np.ndarray] | None = None,
) -> PieceTable:
    """The pieces of the periods 0, …, periods − 1; switch p goes to cut_mode[p + 1].

    Entries up to the number of stretches are those of modes held; after them come the parts of
    stretches that switches begin or end. Parts of one period under the same inputs are one entry.
    `whole` are Φ and Γ of the stretches, where they are known.
    """
    switches = int(np.searchsorted(cut_step, periods))
    laid = lay_cuts(stretches, cut_step, cut_offset, cut_mode, switches)
    cut = np.concatenate((np.zeros((stretches.start.size, 2), np.int64), laid.cut))
    known = whole_stretches(A, B, stretches) if whole is None else whole
    own = _transitions_of(A, B, laid, cut_offset, cut_mode)
    Phi, Gamma = (np.concatenate(both) for both in zip(known, own, strict=True))
    mode = cut_mode[np.searchsorted(cut_step[:switches], np.arange(periods))]
    counts = np.diff(stretches.first)[mode]
    counts[laid.period] = np.diff(laid.first)
    first = np.concatenate(([0], np.cumsum(counts)))
    entry = consecutive(stretches.first[mode], first)
    entry[consecutive(first[laid.period], laid.first)] = laid.entry
    return PieceTable(
        first,
        entry,
        Phi,
        Gamma,
        np.concatenate((stretches.lag, stretches.lag[laid.stretch])),
        np.concatenate((stretches.start, laid.start)),
        np.concatenate((stretches.stop, laid.stop)),
        np.concatenate((_modes_of(stretches), laid.mode)),
        cut,
    )


def _transitions_of(
    A: np.ndarray, B: np.ndarray, laid: LaidCuts, cut_offset: np.ndarray, cut_mode: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Φ and Γ of the entries that are no whole stretch; few of them are kept."""
    if not laid.mode.size:
        return np.empty((0, *A.shape[1:])), np.empty((0, *B.shape[1:]))
    entries = map(read_only, (laid.start, laid.stop, laid.mode, laid.cut))
    given = A, B, *entries, cut_offset, cut_mode
    if laid.mode.size > FEW or cut_mode.size > FEW:
        return transitions(*given)
    return _kept_transitions(tuple((one.dtype.char, one.shape, one.tobytes()) for one in given))


@lru_cache(maxsize=256)  # searches move one switch of a few at a time, and go back
def _kept_transitions(given: tuple[tuple[str, Any, bytes], ...]) -> tuple[np.ndarray, np.ndarray]:
    arrays = [np.frombuffer(data, kind).reshape(shape) for kind, shape, data in given]
    Phi, Gamma = transitions(*arrays)
    return read_only(Phi), read_only(Gamma)


def whole_stretches(
    A: np.ndarray, B: np.ndarray, stretches: Stretches
) -> tuple[np.ndarray, np.ndarray]:
    """Φ and Γ of the stretches."""
    Phi, Gamma = discretise_all(A, B, _modes_of(stretches), stretches.stop - stretches.start)
    return read_only(Phi), read_only(Gamma)


def _modes_of(stretches: Stretches) -> np.ndarray:
    """The mode of every stretch."""
    return np.repeat(np.arange(stretches.first.size - 1), np.diff(stretches.first))


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


@kernel(plain=transitions_at_once)
def transitions(A, B, start, stop, mode, cut, cut_offset, cut_mode):
    """Φ and Γ of entries, part after part."""
    n, m = B.shape[1:]
    Phi, Gamma = np.empty((start.size, n, n)), np.empty((start.size, n, m))
    for e in range(start.size):
        of, now, begun = mode[e], start[e], False
        for p in range(cut[e, 0], cut[e, 1] + 1):
            until = cut_offset[p] if p < cut[e, 1] else stop[e]
            if until > now:
                if begun:
                    part_Phi, part_Gamma = discretise(A[of], B[of], until - now)
                    go_on(Phi[e], Gamma[e], part_Phi, part_Gamma)
                else:
                    discretise_into(A[of], B[of], until - now, Phi[e], Gamma[e])
                now, begun = until, True
            if p < cut[e, 1]:
                of = cut_mode[p + 1]
    return Phi, Gamma


@kernel(plain=gramians_at_once)
def gramians(A, B, table, cut_offset, cut_mode, Q):
    """`gramian_up_to` of every entry, to its end."""
    q = B.shape[1] + B.shape[2]
    M = np.empty((table.mode.size, q, q))
    for e in range(table.mode.size):
        own = gramian_up_to(A, B, table, cut_offset, cut_mode, e, table.stop[e], Q)
        for i in range(q):
            for j in range(q):
                M[e, i, j] = own[i, j]
    return M


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
