"""The parts of entries of a `PieceTable` between the switches within them, all at once by NumPy.

The kernels of `deadtime.plant.cut_pieces` take over, to the same bits, once they are compiled.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deadtime.numerics.stacked import congruence_all, discretise_all, gramian_all, product_all
from deadtime.plant.pieces import PieceTable


class Parts(NamedTuple):
    """What lies between the switches within entries: mode and seconds.

    `rank` counts the parts of an entry, and `goes_on` says whether another one follows.
    """

    entry: np.ndarray
    mode: np.ndarray
    length: np.ndarray
    rank: np.ndarray
    goes_on: np.ndarray


def parts_of(
    start: np.ndarray,
    stop: np.ndarray,
    mode: np.ndarray,
    cut: np.ndarray,
    cut_offset: np.ndarray,
    cut_mode: np.ndarray,
) -> Parts:
    """The parts of entries, those without length left out."""
    inner = cut[:, 1] - cut[:, 0]
    first = np.concatenate(([0], np.cumsum(inner + 1)))
    entry = np.repeat(np.arange(start.size), inner + 1)
    switch = consecutive(cut[:, 0], first)  # that ends a part
    begins, ends = first[:-1], first[1:] - 1
    until = np.empty(entry.size)
    until[ends] = stop
    inside = np.ones(entry.size, bool)
    inside[ends] = False
    until[inside] = cut_offset[switch[inside]]
    since, of = np.empty(entry.size), np.empty(entry.size, np.int64)
    since[1:] = until[:-1]
    since[begins] = start
    inside[ends], inside[begins] = True, False
    of[inside] = cut_mode[switch[inside]]
    of[begins] = mode
    kept = until > since
    entry, of, length = entry[kept], of[kept], (until - since)[kept]
    change = np.concatenate(([True], entry[1:] != entry[:-1]))[: entry.size]
    begin = np.flatnonzero(change)
    rank = np.arange(entry.size) - np.repeat(begin, np.diff(np.append(begin, entry.size)))
    return Parts(entry, of, length, rank, np.append(~change[1:], False)[: entry.size])


def transitions_at_once(
    A: np.ndarray,
    B: np.ndarray,
    start: np.ndarray,
    stop: np.ndarray,
    mode: np.ndarray,
    cut: np.ndarray,
    cut_offset: np.ndarray,
    cut_mode: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """`transitions` by NumPy."""
    parts = parts_of(start, stop, mode, cut, cut_offset, cut_mode)
    Phi, Gamma = np.empty((mode.size, *A.shape[1:])), np.empty((mode.size, *B.shape[1:]))
    of, entered = discretise_all(A, B, parts.mode, parts.length)
    Phi[parts.entry[parts.rank == 0]] = of[parts.rank == 0]
    Gamma[parts.entry[parts.rank == 0]] = entered[parts.rank == 0]
    with np.errstate(all="ignore"):
        for rank in range(1, parts.rank.max(initial=0) + 1):
            now = np.flatnonzero(parts.rank == rank)
            e = parts.entry[now]
            Phi[e] = product_all(of[now], Phi[e])
            Gamma[e] = product_all(of[now], Gamma[e]) + entered[now]
    return Phi, Gamma


def gramians_at_once(
    A: np.ndarray,
    B: np.ndarray,
    table: PieceTable,
    cut_offset: np.ndarray,
    cut_mode: np.ndarray,
    Q: np.ndarray,
) -> np.ndarray:
    """`gramians` by NumPy."""
    entries, (n, m) = table.mode.size, B.shape[1:]
    parts = parts_of(table.start, table.stop, table.mode, table.cut, cut_offset, cut_mode)
    M = gramian_all(A, B, parts.mode, parts.length, Q)
    result = np.zeros((entries, n + m, n + m))
    moved = np.tile(np.eye(n + m), (entries, 1, 1))
    with np.errstate(all="ignore"):
        for rank in range(parts.rank.max(initial=-1) + 1):
            of = np.flatnonzero(parts.rank == rank)
            e = parts.entry[of]
            result[e] += congruence_all(moved[e], M[of]) if rank else M[of]
            of = of[parts.goes_on[of]]
            e = parts.entry[of]
            Phi, Gamma = discretise_all(A, B, parts.mode[of], parts.length[of])
            moved[e, :n, n:] = product_all(Phi, moved[e, :n, n:]) + Gamma
            moved[e, :n, :n] = product_all(Phi, moved[e, :n, :n])
    return result


def consecutive(values: np.ndarray, first: np.ndarray) -> np.ndarray:
    """values[i], values[i] + 1, … at the places first[i], …, first[i + 1] − 1."""
    return np.repeat(values - first[:-1], np.diff(first)) + np.arange(first[-1])
