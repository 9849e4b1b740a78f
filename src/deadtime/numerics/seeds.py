"""The seeds of many streams at once: what `numpy.random.SeedSequence` makes of each, by NumPy.

A seed and a spawn key are words of 32 bits, hashed into a pool of four. Here each word is an array,
one entry per stream. NumPy promises that `SeedSequence` never changes what it gives.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import UInt64

_POOL = 4
_FULL = 2**32 - 1
# O'Neill's seed_seq_fe, as in numpy/random/bit_generator.pyx.
_FIRST, _FIRST_TIMES = 0x43B0D7E5, 0x931E8875
_LAST, _LAST_TIMES = 0x8B51F9DD, 0x58F38DED
_LEFT, _RIGHT = np.uint32(0xCA01F9DD), np.uint32(0x4973F715)
_SHIFT = np.uint32(16)


class _Hash:
    """x ↦ hash of x, with other constants at every call."""

    def __init__(self, start: int, factor: int) -> None:
        self._constant, self._factor = start, factor

    def __call__(self, x: np.ndarray) -> np.ndarray:
        x = x ^ np.uint32(self._constant)
        self._constant = self._constant * self._factor & _FULL
        x = x * np.uint32(self._constant)
        return x ^ (x >> _SHIFT)


def _mix(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    mixed = _LEFT * x - _RIGHT * y
    return mixed ^ (mixed >> _SHIFT)


def words_of(number: int) -> list[int]:
    """A number ≥ 0 in words of 32 bits, the lowest first.

    Examples
    --------
    >>> words_of(0), words_of(2**32 + 5)
    ([0], [5, 1])
    """
    words = [number & _FULL]
    while number := number >> 32:
        words.append(number & _FULL)
    return words


def states(
    seed: int | UInt64[np.ndarray, " stream"], key: Sequence[int | np.ndarray], count: int
) -> UInt64[np.ndarray, "stream count"]:
    """`SeedSequence(seed, spawn_key=key).generate_state(count, np.uint64)`, stream by stream.

    Parameters
    ----------
    seed : int ≥ 0, or an array of these below 2⁶⁴
    key : sequence
        Integers ≥ 0 and arrays of these; those of arrays are below 2³².
    count : int

    Examples
    --------
    >>> found = states(3, [np.arange(5)], 2)
    >>> sequence = np.random.SeedSequence(3, spawn_key=(4,))
    >>> (found[4] == sequence.generate_state(2, np.uint64)).all()
    np.True_
    """
    if isinstance(seed, np.ndarray):
        words: list[int | np.ndarray] = [seed & np.uint64(_FULL), seed >> np.uint64(32)]
    else:
        words = [*words_of(seed)]
    words += [0] * (_POOL - len(words))
    for part in key:
        words += [part] if isinstance(part, np.ndarray) else words_of(part)
    entropy = np.broadcast_arrays(*(np.asarray(word).astype(np.uint32) for word in words))
    hashed = _Hash(_FIRST, _FIRST_TIMES)
    pool = [hashed(np.atleast_1d(word)) for word in entropy[:_POOL]]
    for source in range(_POOL):
        for target in range(_POOL):
            if source != target:
                pool[target] = _mix(pool[target], hashed(pool[source]))
    for word in entropy[_POOL:]:
        for target in range(_POOL):
            pool[target] = _mix(pool[target], hashed(np.atleast_1d(word)))
    given = _Hash(_LAST, _LAST_TIMES)
    halves = [given(pool[i % _POOL]).astype(np.uint64) for i in range(2 * count)]
    return np.stack(
        [low | high << np.uint64(32) for low, high in zip(halves[::2], halves[1::2], strict=True)],
        axis=1,
    )
