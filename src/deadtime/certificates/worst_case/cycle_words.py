"""Cycles on the grid, seen by the compressed loop: which to keep, and how to improve them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Int

from deadtime.certificates.worst_case.products import Sojourns

KEPT = 5  # cycles of each number of sojourns that are improved,
ALIKE = 3  # and of them with the same kinds in turn
NEAR = 20  # part of the range of lengths within which cycles count as the same
MOST_CLIMBED = 600  # cycles looked at to improve one


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
    """Every rotation of the places 0, …, size − 1, one a row."""
    return (np.arange(size) - np.arange(size)[:, None]) % size


def climb(sojourns: Sojourns, word: Word) -> tuple[Word, int]:
    """The cycle improved by longer and shorter sojourns, and how many were looked at.

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
