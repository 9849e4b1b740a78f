"""Branch and bound over words of sojourns, on the compressed loop.

A word is a sequence of (kind of sojourn, length); words are grown by a sojourn at a time. With A_w
the product of a word's matrices, T_w its length and |·| a norm,

    β(w) = min over prefixes p of w of ln|A_p| / T_p

bounds the rate of every signal that can be cut into words without children: Gripenberg's bound
("Computing the joint spectral radius", Linear Algebra Appl. 234, 1996), with products weighted by
their length. A word with β(w) at most the best rate found, plus a tolerance, has no children.
If too many words remain, those of largest bound continue and the rest is dropped, and the bound
with it (the modified Gripenberg algorithm; Mejstrik, ACM Trans. Math. Softw. 46, 2020).
The norm is Euclidean in coordinates in which the mean over sojourns of |A z|² is |z|² nearly.
The best cycles are then improved by changing their lengths (`climb`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from deadtime.certificates.worst_case.products import Sojourns

KEPT = 5  # cycles improved of each number of sojourns
ALIKE = 3  # of them with the same sequence of kinds
NEAR = 20  # cycles within this fraction of the range of lengths count as equal
MOST_CLIMBED = 600  # cycles evaluated to improve one
LETTERS = 40  # sojourns by which a word may be extended, about
WIDTH = 100  # words that continue
LONGEST = 10  # sojourns in a word
LIKELY = 200  # cycles of each number of sojourns that are evaluated
BEGINNING = 3  # first kinds by which words are grouped, so that no beginning crowds out the others
SQUARINGS = 5


@dataclass(frozen=True, eq=False)
class Word:
    """A cycle on the grid: kinds, indices of their lengths, and its growth per sample."""

    kinds: Int[np.ndarray, " sojourn"]
    index: Int[np.ndarray, " sojourn"]
    rate: float


def distinct(words: list[Word], sojourns: Sojourns) -> list[Word]:
    """The best few of these, no two of which are rotations of nearly the same."""
    kept: list[Word] = []
    near = sojourns.length.size // NEAR
    for word in sorted(words, key=lambda word: -word.rate):
        if not math.isfinite(word.rate):
            continue
        alike = [away for other in kept if (away := _apart(word, other)) is not None]
        if len(alike) < ALIKE and min(alike, default=np.inf) > near:
            kept.append(word)
        if len(kept) == KEPT:
            break
    return kept


def _apart(word: Word, other: Word) -> int | None:
    """The least change of a length from one of the turns of a word to another word of its kinds."""
    if word.kinds.size != other.kinds.size:
        return None
    turns = _turns(word.kinds.size)
    same = (word.kinds[turns] == other.kinds).all(axis=1)
    if not same.any():
        return None
    return int(np.abs(word.index[turns[same]] - other.index).max(axis=1).min())


@lru_cache(maxsize=64)
def _turns(size: int) -> np.ndarray:
    return (np.arange(size) - np.arange(size)[:, None]) % size


def climb(sojourns: Sojourns, word: Word) -> tuple[Word, int]:
    """The cycle improved by longer and shorter sojourns, and the number of cycles evaluated.

    One sojourn is changed, two neighbours against each other, or all together.
    """
    count, low, high = word.index.size, sojourns.low[word.kinds], sojourns.high[word.kinds]
    eye = np.eye(count, dtype=np.int64)
    moves = np.vstack((eye, eye - np.roll(eye, 1, axis=1), np.ones((1, count), np.int64)))
    moves = np.unique(np.vstack((moves, -moves)), axis=0)
    index, rate, evaluated = word.index, word.rate, 0
    reach = max(1, sojourns.length.size // 8)
    while reach and evaluated < MOST_CLIMBED:
        trials = np.clip(index + reach * moves, low, high)
        rates = sojourns.rates(word.kinds, trials)
        evaluated += len(trials)
        best = int(np.argmax(rates))
        if rates[best] > rate + 1e-12:
            index, rate = trials[best], float(rates[best])
        else:
            reach //= 2
    return Word(word.kinds, index, rate), evaluated


@dataclass(eq=False)
class _Level:
    """All words of one number of sojourns that have children."""

    kinds: Int[np.ndarray, "word sojourn"]
    index: Int[np.ndarray, "word sojourn"]
    product: Float[np.ndarray, "word rank rank"]
    log: Float[np.ndarray, " word"]
    time: Float[np.ndarray, " word"]
    bound: Float[np.ndarray, " word"]

    def only(self, keep: np.ndarray) -> _Level:
        """Some of the words."""
        return _Level(*(part[keep] for part in vars(self).values()))


@dataclass(eq=False)
class _CycleSearch:
    sojourns: Sojourns
    letters: list[Int[np.ndarray, " letter"]]
    tolerance: float
    best: float
    cycles: dict[int, list[Word]] = field(default_factory=dict)

    def first(self) -> _Level:
        """The words of one sojourn."""
        S = self.sojourns
        kinds, index = (part[:, None] for part in _each(self.letters))
        product, log = S.matrix[kinds[:, 0], index[:, 0]], S.log[kinds[:, 0], index[:, 0]]
        time = S.length[index[:, 0]].astype(float)
        return _Level(kinds, index, product, log, time, (log + _excess(product)) / time)

    def extend(self, level: _Level) -> _Level:
        """All words with one more sojourn."""
        S, parts = self.sojourns, []
        for kind in range(S.matrix.shape[0]):
            parents = np.flatnonzero(S.kinds.follows[level.kinds[:, -1], kind])
            own = self.letters[kind]
            count, letters = parents.size, own.size
            product = S.matrix[kind, own][None] @ level.product[parents][:, None]
            product, size = _normalise(product)
            log = size + level.log[parents][:, None] + S.log[kind, own]
            time = level.time[parents][:, None] + S.length[own]
            bound = np.minimum(level.bound[parents][:, None], (log + _excess(product)) / time)
            kinds = np.full((count * letters, 1), kind)
            index = np.tile(own, count)[:, None]
            parts.append((
                np.hstack((np.repeat(level.kinds[parents], letters, axis=0), kinds)),
                np.hstack((np.repeat(level.index[parents], letters, axis=0), index)),
                product.reshape(count * letters, *product.shape[2:]),
                log.ravel(), time.ravel(), bound.ravel(),
            ))  # fmt: skip
        return _Level(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))

    def close(self, level: _Level) -> None:
        """Record the growth of the words that are cycles."""
        cyclic = self.sojourns.kinds.follows[level.kinds[:, -1], level.kinds[:, 0]]
        level = level.only(cyclic & (level.bound > self.best - self.tolerance))
        if not level.time.size:
            return
        # Squarings rank the words; the radius itself is computed of the likely ones alone.
        power, log = level.product, level.log.copy()
        for squaring in range(SQUARINGS):
            power, size = _normalise(power @ power)
            log += size / 2.0 ** (squaring + 1)
        likely = np.argsort(-log / level.time, kind="stable")[:LIKELY]
        radius = np.abs(np.linalg.eigvals(level.product[likely])).max(axis=1)
        with np.errstate(divide="ignore"):
            rates = (np.log(radius) + level.log[likely]) / level.time[likely]
        words = [
            Word(level.kinds[w], level.index[w], float(rate))
            for w, rate in zip(likely, rates, strict=True)
        ]
        self.cycles[level.kinds.shape[1]] = words
        self.best = max(self.best, float(rates.max()))


def branch_and_bound(
    sojourns: Sojourns,
    letters: list[Int[np.ndarray, " letter"]],
    floor: float,
    tolerance: float,
    budget: int,
) -> tuple[list[Word], int]:
    """Words of sojourns with `letters` for the indices of their lengths, a list of each kind.

    `floor` is a known lower bound of the rate per sample; `budget` the number of words that may be
    evaluated. Returns the best cycles of each number of sojourns, the best first; and the number of
    words.
    """
    search = _CycleSearch(_adapt(sojourns, letters, floor), letters, tolerance, floor)
    level, evaluated = search.first(), 0
    while level.kinds.shape[1] < LONGEST:
        level = search.extend(level)
        evaluated += level.time.size
        search.close(level)
        level = level.only(level.bound > search.best + tolerance)
        if not level.time.size or evaluated >= budget:
            break
        if level.time.size > WIDTH:
            level = level.only(_most_promising(level))
    words = [word for some in search.cycles.values() for word in distinct(some, sojourns)]
    words.sort(key=lambda word: -word.rate)
    return words, evaluated


def _most_promising(level: _Level) -> np.ndarray:
    """The words of largest bound, equally many of each beginning."""
    order = np.argsort(-level.bound, kind="stable")
    _, group = np.unique(level.kinds[order, :BEGINNING], axis=0, return_inverse=True)
    group = group.ravel()
    place = np.empty(order.size, np.int64)
    for number in range(int(group.max()) + 1):
        inside = np.flatnonzero(group == number)
        place[inside] = np.arange(inside.size)
    return np.sort(order[np.argsort(place, kind="stable")[:WIDTH]])


def _each(letters: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    sizes = [own.size for own in letters]
    return np.repeat(np.arange(len(letters)), sizes), np.concatenate(letters)


def _adapt(sojourns: Sojourns, letters: list[np.ndarray], floor: float) -> Sojourns:
    """Sojourns in the coordinates of the adapted norm."""
    rank, each = sojourns.matrix.shape[2], _each(letters)
    time, log = sojourns.length[each[1]], sojourns.log[each]
    rate = floor if math.isfinite(floor) else float((log / time).max())
    weight = np.exp(np.clip(log - rate * time, -60.0, 60.0))
    A = sojourns.matrix[each] * weight[:, None, None]
    P = np.eye(rank)
    # Power iteration on X → Σ AᵀXA: its fixed point makes the mean of |A z|² proportional to |z|².
    for _ in range(50):
        P = np.einsum("aji,jk,akl->il", A, P, A, optimize=True)
        P /= np.trace(P)
        P += 1e-9 * np.eye(rank)
    L = np.linalg.cholesky(P).T
    matrix, size = _normalise(L @ sojourns.matrix @ np.linalg.inv(L))
    return replace(sojourns, matrix=matrix, log=sojourns.log + size)


def _normalise(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Stacked matrices divided by their Frobenius norms, and the logarithms of these."""
    size = np.sqrt((matrix**2).sum(axis=(-2, -1)))
    with np.errstate(divide="ignore"):
        return matrix / np.maximum(size, 1e-300)[..., None, None], np.log(size)


def _excess(matrix: np.ndarray) -> np.ndarray:
    """The logarithms of bounds on the spectral norms of such matrices: (tr (AᵀA)⁸)^(1/16)."""
    power = np.swapaxes(matrix, -1, -2) @ matrix
    # (tr X⁸)^{1/16} exceeds the norm by at most the factor rank^{1/16}, and needs no eigenvalues.
    for _ in range(2):
        power = power @ power
    with np.errstate(divide="ignore"):
        return np.log((power**2).sum(axis=(-2, -1))) / 16.0
