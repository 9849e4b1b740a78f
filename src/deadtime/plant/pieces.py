"""Pieces of periods, over which no acting input changes: their transitions and Gramians.

    period   t_k              φ of an input              t_{k+1}
             |---- stretch 0 ----|-------- stretch 1 --------|
    switches          ↑ p                    ↑ p + 1
    parts    | mode a | mode b   |  mode b   |    mode c     |
    entries  |----- entry e -----|-------- entry e + 1 ------|

Switches divide a stretch into parts. Where a switch changes the delays, and with them the acting
inputs, it also ends the entry. NumPy computes the parts of all entries together; once compiled,
kernels replace it, with bitwise equal results.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import read_only
from deadtime.numerics.exponential import (
    add_congruence,
    congruence_all,
    discretise,
    discretise_all,
    discretise_into,
    gramian,
    gramian_all,
    product,
    product_all,
)
from deadtime.numerics.kernels import kernel
from deadtime.plant.discretisation import Cuts


class Stretch(NamedTuple):
    """A part of a period, start to stop in seconds after the sample, in which u_{k−lag[j]} acts.

    That is input j, for every j.
    """

    start: float
    stop: float
    lag: Int[np.ndarray, " m"]


class Piece(NamedTuple):
    """A stretch and its map: x becomes Phi x + Gamma u under the acting inputs u."""

    Phi: Float[np.ndarray, "n n"]
    Gamma: Float[np.ndarray, "n m"]
    stretch: Stretch


class Period(NamedTuple):
    """The map of a whole period: x_{k+1} = Phi x_k + Σ_l Gamma[l] u_{k−lags[l]}, oldest first."""

    Phi: Float[np.ndarray, "n n"]
    Gamma: Float[np.ndarray, "lag n m"]
    lags: tuple[int, ...]


class Stretches(NamedTuple):
    """The stretches of all modes as arrays; mode i has first[i], …, first[i + 1] − 1."""

    first: Int[np.ndarray, " mode+1"]
    start: Float[np.ndarray, " stretch"]
    stop: Float[np.ndarray, " stretch"]
    lag: Int[np.ndarray, "stretch m"]


class Ahead(NamedTuple):
    """The stretches of [t_k, t_k + D), in each of which one input in flight at t_k acts.

    start, stop : (stretches,), seconds from t_k on
    lag : (stretches, m), j of the acting u_{k−j}
    length : (kinds,), the different lengths, seconds; kind : (stretches,), index into them
    """

    start: Float[np.ndarray, " stretch"]
    stop: Float[np.ndarray, " stretch"]
    lag: Int[np.ndarray, "stretch m"]
    length: Float[np.ndarray, " kind"]
    kind: Int[np.ndarray, " stretch"]


class PieceTable(NamedTuple):
    """The pieces of many periods along a switching signal, each transition computed once.

    Period k has the pieces first[k], …, first[k + 1] − 1. Piece q is entry e = entry[q] and takes x
    to Phi[e] x + Gamma[e] u. A switch that changes no acting input does not end a piece: entry e
    begins in mode[e] and contains the switches cut[e, 0], …, cut[e, 1] − 1.

    first : (periods + 1,)
    entry : (pieces,)
    Phi : (entries, n, n), Gamma : (entries, n, m)
    lag : (entries, m), how many samples ago the acting inputs were computed
    start, stop : (entries,), seconds after the period's sample
    mode : (entries,)
    cut : (entries, 2)
    """

    first: Int[np.ndarray, " period+1"]
    entry: Int[np.ndarray, " piece"]
    Phi: Float[np.ndarray, "entry n n"]
    Gamma: Float[np.ndarray, "entry n m"]
    lag: Int[np.ndarray, "entry m"]
    start: Float[np.ndarray, " entry"]
    stop: Float[np.ndarray, " entry"]
    mode: Int[np.ndarray, " entry"]
    cut: Int[np.ndarray, "entry 2"]

    @property
    def period(self) -> Int[np.ndarray, " piece"]:
        """The period of every piece."""
        return np.repeat(np.arange(self.first.size - 1), np.diff(self.first))

    @property
    def sample(self) -> Int[np.ndarray, "piece m"]:
        """The k of the acting u_k, by piece and input."""
        return self.period[:, None] - self.lag[self.entry]

    def parts(self, entry: int, cuts: Cuts) -> list[tuple[int, float, float]]:
        """Mode, start and stop of every part of an entry."""
        first, stop = self.cut[entry]
        modes = [self.mode[entry], *cuts.mode[first + 1 : stop + 1]]
        times = [self.start[entry], *cuts.offset[first:stop], self.stop[entry]]
        parts = zip(modes, times[:-1], times[1:], strict=True)
        return [(int(mode), float(a), float(b)) for mode, a, b in parts if b > a]


class CutPieces(NamedTuple):
    """The pieces of the periods with switches, and the entries that are not a whole stretch.

    Piece first[i] + j is number j of period[i]. These entries are numbered after the stretches;
    `stretch` is a stretch with the same acting inputs, the other arrays are as in a `PieceTable`.
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
def sample_cuts(stretches, cut_step, cut_offset, cut_mode, switches):
    """The `CutPieces` of the first `switches` switches (`Cuts`, as arrays).

    Consecutive parts of a period under the same inputs are one entry.
    """
    whole, longest, m = stretches.start.size, 0, stretches.lag.shape[1]
    for i in range(stretches.first.size - 1):
        longest = max(longest, stretches.first[i + 1] - stretches.first[i])
    period, first = np.empty(switches, np.int64), np.empty(switches + 1, np.int64)
    entry = np.empty(2 * longest * switches, np.int64)
    stretch, mode_of = np.empty(entry.size, np.int64), np.empty(entry.size, np.int64)
    start, stop = np.empty(entry.size), np.empty(entry.size)
    cut = np.zeros((entry.size, 2), np.int64)
    # Next numbers: i of a period with switches, e of an entry, q of a piece, p of a switch. At most
    # two entries per stretch and switch, before and after it.
    i, e, q, p = 0, 0, 0, 0
    while p < switches:
        k, mode, now, goes_on = cut_step[p], cut_mode[p], 0.0, False
        period[i], first[i] = k, q
        s, last = stretches.first[mode], stretches.first[mode + 1]
        while s < last:
            if p < switches and cut_step[p] == k and cut_offset[p] <= now:
                # The switch is now: continue in the stretch of the new mode at this time.
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
            if not ends and now == stretches.start[s]:  # a whole stretch
                entry[q] = s
                q += 1
            else:
                # After a switch, the same lags mean the same acting inputs: the entry continues.
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
    return CutPieces(
        period[:i],
        first[: i + 1],
        entry[:q],
        stretch[:e],
        start[:e],
        stop[:e],
        mode_of[:e],
        cut[:e],
    )


class Parts(NamedTuple):
    """The parts of entries: mode and seconds, number within the entry, and whether one follows."""

    entry: np.ndarray
    mode: np.ndarray
    length: np.ndarray
    rank: np.ndarray
    goes_on: np.ndarray


def parts_of(start, stop, mode, cut, cut_offset, cut_mode) -> Parts:
    """The parts of positive length."""
    count = cut[:, 1] - cut[:, 0] + 1
    first = np.concatenate(([0], np.cumsum(count)))
    entry = np.repeat(np.arange(start.size), count)
    # Part r of an entry ends at switch cut[e, 0] + r, the last one at the end of the entry. That
    # number may lie one beyond the last switch, so a NaN is appended, which `stop` replaces.
    switch = consecutive(cut[:, 0], first)
    until = np.append(cut_offset, np.nan)[switch]
    until[first[1:] - 1] = stop
    since = np.concatenate(([0.0], until))[: entry.size]
    since[first[:-1]] = start
    mode_of = cut_mode[switch]
    mode_of[first[:-1]] = mode
    kept = until > since
    entry = entry[kept]
    rank = np.arange(entry.size) - np.searchsorted(entry, entry)
    goes_on = np.append(entry[1:] == entry[:-1], False)[: entry.size]
    return Parts(entry, mode_of[kept], (until - since)[kept], rank, goes_on)


def transitions_at_once(A, B, start, stop, mode, cut, cut_offset, cut_mode):
    """`transitions` by NumPy."""
    parts = parts_of(start, stop, mode, cut, cut_offset, cut_mode)
    Phi, Gamma = np.empty((mode.size, *A.shape[1:])), np.empty((mode.size, *B.shape[1:]))
    of, entered = discretise_all(A, B, parts.mode, parts.length)
    begins = parts.rank == 0
    Phi[parts.entry[begins]], Gamma[parts.entry[begins]] = of[begins], entered[begins]
    with np.errstate(all="ignore"):
        for rank in range(1, parts.rank.max(initial=0) + 1):
            now = np.flatnonzero(parts.rank == rank)
            e = parts.entry[now]
            Phi[e] = product_all(of[now], Phi[e])
            Gamma[e] = product_all(of[now], Gamma[e]) + entered[now]
    return Phi, Gamma


def gramians_at_once(A, B, table, cut_offset, cut_mode, Q):
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
    """The array with values[i], values[i] + 1, … at first[i], …, first[i + 1] − 1."""
    return np.repeat(values - first[:-1], np.diff(first)) + np.arange(first[-1])


FEW = 24  # entries and switches up to which transitions are cached


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

    The first entries are the stretches, each in its mode; after them come the entries that begin or
    end at switches. `whole` are Φ and Γ of the stretches, if they are known.
    """
    switches = int(np.searchsorted(cut_step, periods))
    pieces = sample_cuts(stretches, cut_step, cut_offset, cut_mode, switches)
    cut = np.concatenate((np.zeros((stretches.start.size, 2), np.int64), pieces.cut))
    known = whole_stretches(A, B, stretches) if whole is None else whole
    own = _transitions_of(A, B, pieces, cut_offset, cut_mode)
    Phi, Gamma = (np.concatenate(both) for both in zip(known, own, strict=True))
    mode = cut_mode[np.searchsorted(cut_step[:switches], np.arange(periods))]
    counts = np.diff(stretches.first)[mode]
    counts[pieces.period] = np.diff(pieces.first)
    first = np.concatenate(([0], np.cumsum(counts)))
    # Periods without switches have their mode's stretches; the others are overwritten.
    entry = consecutive(stretches.first[mode], first)
    entry[consecutive(first[pieces.period], pieces.first)] = pieces.entry
    return PieceTable(
        first,
        entry,
        Phi,
        Gamma,
        np.concatenate((stretches.lag, stretches.lag[pieces.stretch])),
        np.concatenate((stretches.start, pieces.start)),
        np.concatenate((stretches.stop, pieces.stop)),
        np.concatenate((_modes_of(stretches), pieces.mode)),
        cut,
    )


def _transitions_of(
    A: np.ndarray, B: np.ndarray, pieces: CutPieces, cut_offset: np.ndarray, cut_mode: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Φ and Γ of the entries that are not a whole stretch."""
    if not pieces.mode.size:
        return np.empty((0, *A.shape[1:])), np.empty((0, *B.shape[1:]))
    entries = map(read_only, (pieces.start, pieces.stop, pieces.mode, pieces.cut))
    given = A, B, *entries, cut_offset, cut_mode
    if pieces.mode.size > FEW or cut_mode.size > FEW:
        return transitions(*given)
    return _kept_transitions(tuple((one.dtype.char, one.shape, one.tobytes()) for one in given))


@lru_cache(maxsize=256)  # searches move one switch at a time and return to former ones
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
    return np.repeat(np.arange(stretches.first.size - 1), np.diff(stretches.first))


@kernel
def go_on(Phi, Gamma, part_Phi, part_Gamma):
    """Compose Φ, Γ with those of the part that follows, in place."""
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
    """`gramian_up_to` the end, of every entry."""
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
