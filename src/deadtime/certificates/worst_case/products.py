"""Sojourns as small matrices: the loop between its switches, compressed.

Runs from random states under random admissible signals end in a set X of lifted states of nearly
low dimension, since a delay smooths; functionals carried back over such signals end in a set Y of
this kind. With Yᵀ X = P S Qᵀ (singular values) the oblique projection

    V = X Q S^{−1/2},    U = S^{−1/2} Pᵀ Yᵀ,    U V = I,

keeps the directions that are both reachable and observable (an empirical form of balanced
truncation; Moore, IEEE TAC 26, 1981). The sojourn of k samples in mode i becomes U M_i(k) V. On the
paper's example, N = 20 to 1,000, 16 dimensions give growth rates to about 1e-4 1/s, 5e-3 at worst,
2e-2 where some switches are seen late and others not. They only rank cycles.

A sojourn on the grid has a mode and begins with a switch that the law saw in time or late. A switch
on a sample is seen at it. A switch just after a sample is seen a period late: at that sample the
law still uses the row of the mode before. Every switch of a cycle may do either. A sojourn extends
from sample to sample, so a late one has, at its first sample, the row of the mode before, whose
sojourn is taken to be the shortest one (exact if rows do not depend on the age by then; the cycles
found are evaluated on the loop itself).

If the mode is reported L samples late, the law uses the mode before at the first L samples of every
sojourn, and at one more of a late one. For a lag longer than a sojourn this is an approximation,
which only ranks cycles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from deadtime.certificates.worst_case.cycle_growth import SampledLoop
from deadtime.certificates.worst_case.cycles import Admissible, Cycle
from deadtime.feedback import Feedback
from deadtime.spectrum.sampled_runs import LoopPeriods

RANK = 16
RUNS = 32
DELAYS = 4  # length of a random run
SMALLEST = 1e-10  # singular value that is kept, relative


@dataclass(frozen=True, eq=False)
class Kinds:
    """The kinds of sojourns (immutable).

    Attributes
    ----------
    mode : (kinds,)
        The mode.
    before : (kinds,)
        The mode before, if the law uses its rows at first, else −1.
    wait : (kinds,)
        The number of samples at which it does.
    late : (kinds,)
        Whether the switch falls just after its sample.
    follows : (kinds, kinds)
        Whether the second may follow the first.
    """

    mode: Int[np.ndarray, " kind"]
    before: Int[np.ndarray, " kind"]
    wait: Int[np.ndarray, " kind"]
    late: Bool[np.ndarray, " kind"]
    follows: Bool[np.ndarray, "kind kind"]

    @classmethod
    def of(cls, feedback: Feedback, signals: Admissible, lag: int = 0) -> Kinds:
        """The kinds for a law's table and the admissible cycles."""
        mixed, recurring = signals.late[1], signals.recurring
        each = [(i, p) for i in recurring for p in recurring if i in signals.following[p]]
        found = [(i, -1, 0, 0) for i in recurring]
        if feedback.context != "none" and lag:
            found = [(i, p, lag, 0) for i, p in each]
        if feedback.context != "none" and not signals.at_samples:
            found += [(i, p, lag + 1, 1) for i, p in each]
        mode, before, wait, late = np.array(found).T
        allowed = np.zeros((signals.modes, signals.modes), dtype=bool)
        for i in recurring:
            allowed[i, list(signals.following[i])] = True
        follows = allowed[mode[:, None], mode]
        follows &= (before == -1) | (before == mode[:, None])
        if not mixed:
            follows &= late[:, None] == late
        return cls(mode, before, wait, late > 0, follows)


@dataclass(frozen=True, eq=False)
class Sojourns:
    """The sojourns on the grid, compressed (immutable).

    Attributes
    ----------
    length : (lengths,)
        Their lengths in samples, rising.
    matrix : (kinds, lengths, rank, rank)
        Scaled to unit norm.
    log : (kinds, lengths)
        The logarithm of the norm before scaling.
    kinds : Kinds
        Modes of the sojourns, and which kind may follow which.
    low, high : (kinds,)
        The first and the last length of a kind, as indices of `length`.
    """

    length: Int[np.ndarray, " length"]
    matrix: Float[np.ndarray, "kind length rank rank"]
    log: Float[np.ndarray, "kind length"]
    kinds: Kinds
    low: Int[np.ndarray, " kind"]
    high: Int[np.ndarray, " kind"]

    def rates(
        self, word: Int[np.ndarray, " sojourn"], index: Int[np.ndarray, "cycle sojourn"]
    ) -> Float[np.ndarray, " cycle"]:
        """The growth per sample of cycles of these kinds, by the indices of their lengths."""
        product = self.matrix[word[0], index[:, 0]]
        for i, k in zip(word[1:], index.T[1:], strict=True):
            product = self.matrix[i, k] @ product
        radius = np.abs(np.linalg.eigvals(product)).max(axis=1)
        with np.errstate(divide="ignore"):
            logs = np.log(radius) + self.log[word, index].sum(axis=1)
        return logs / self.length[index].sum(axis=1)


def compress(
    loop: SampledLoop, lengths: Int[np.ndarray, " length"], kinds: Kinds, signals: Admissible
) -> Sojourns:
    """The sojourns of all kinds and these lengths, in samples."""
    # The first and the last of the lengths that every mode may have, as indices.
    shortest = [dwell.shortest for dwell in signals.dwell]
    longest_of = [dwell.longest for dwell in signals.dwell]
    low = np.searchsorted(lengths, shortest).clip(0, lengths.size - 1)
    high = np.searchsorted(lengths, longest_of, side="right") - 1
    n, m, W = loop.plant.states, loop.plant.inputs, loop.past
    longest = int(lengths[-1])
    entries = zip(kinds.mode.tolist(), kinds.before.tolist(), kinds.wait.tolist(), strict=True)
    tables = [_entry_table(loop, *entry, int(lengths[low[entry[1]]]), longest) for entry in entries]
    low, high = low[kinds.mode], high[kinds.mode]
    V, U = _projection(loop, tables, lengths, kinds, low, high)
    rank = V.shape[1]
    matrix = np.empty((len(tables), lengths.size, rank, rank))
    for kind, table in enumerate(tables):
        for column in range(rank):
            states, inputs = loop.run(table, 1, V[:, column])
            # Row k of `line` has the W inputs before the sample k, in the order of ζ.
            line = np.lib.stride_tricks.sliding_window_view(inputs.ravel(), W * m)[::m]
            reached = states[lengths - 1] @ U[:, :n].T + line[lengths] @ U[:, n:].T
            matrix[kind, :, :, column] = reached
    size = np.sqrt((matrix**2).sum(axis=(2, 3)))
    with np.errstate(divide="ignore"):
        log = np.log(size)
    matrix = matrix / np.maximum(size, 1e-300)[:, :, None, None]
    return Sojourns(lengths, matrix, log, kinds, low, high)


def _entry_table(
    loop: SampledLoop, mode: int, before: int, wait: int, shortest: int, periods: int
) -> LoopPeriods:
    """The periods of a mode that has just been entered; see `Kinds` for `before` and `wait`."""
    rows = loop.feedback.rows(np.full(periods, mode))
    if before >= 0:
        old = loop.feedback.rows(np.full(max(shortest + 1, wait), before))[-wait:]
        rows = np.concatenate((old, rows[:-wait]))[:periods]
    return loop.table(Cycle((mode,), (float(periods),)))._replace(rows=rows)


def _projection(
    loop: SampledLoop,
    tables: list[LoopPeriods],
    lengths: np.ndarray,
    kinds: Kinds,
    low: np.ndarray,
    high: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    order = loop.order
    if order <= RANK:
        return np.eye(order), np.eye(order)
    rng = np.random.default_rng(1)  # fixed seeds: the search is deterministic
    X = _snapshots(loop, tables, lengths, kinds, (low, high), rng, back=False)
    Y = _snapshots(loop, tables, lengths, kinds, (low, high), rng, back=True)
    P, S, Qt = np.linalg.svd(Y.T @ X)
    rank = max(1, min(RANK, int(np.count_nonzero(S / S[0] > SMALLEST))))
    root = np.sqrt(S[:rank])
    return X @ Qt[:rank].T / root, (Y @ P[:, :rank] / root).T


def _snapshots(
    loop: SampledLoop,
    tables: list[LoopPeriods],
    lengths: np.ndarray,
    kinds: Kinds,
    ends: tuple[np.ndarray, np.ndarray],
    rng: np.random.Generator,
    back: bool,
) -> np.ndarray:
    """Lifted states (or functionals) at the switches of random runs, scaled, one a column."""
    snapshots, W = [], loop.past
    follows = kinds.follows.T if back else kinds.follows
    for _ in range(RUNS):
        z = rng.normal(size=loop.order)
        kind, time = int(rng.integers(len(tables))), 0
        while True:
            # Half of the sojourns are the shortest ones, which worst cycles often have.
            wanted = lengths[ends[0][kind]] + rng.exponential(W) * rng.integers(2)
            k = int(lengths[min(np.searchsorted(lengths, wanted), ends[1][kind])])
            part = tables[kind].until(k)
            z = loop.before(part, z) if back else loop.after(part, 1, z)
            size = float(np.abs(z).max())
            if not 0.0 < size < math.inf:
                break
            z, time = z / size, time + k
            if time > W:  # the random inputs of the start have left the delay line
                snapshots.append(z / np.linalg.norm(z))
            if time > DELAYS * W:
                break
            if len(tables) > 1:
                kind = int(rng.choice(np.flatnonzero(follows[kind])))
    if not snapshots:
        return np.eye(loop.order)[:, :1]
    return np.array(snapshots).T
