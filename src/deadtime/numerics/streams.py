"""Independent streams of random numbers, each a function of a seed and a purpose.

All are keyed by words of the counter-based generator Philox, without a common state. `stream` is a
generator to draw from in order; `deadtime.numerics.generators.Streams` has the compiled generators
of many seeds, with the same numbers. `uniforms` has random access, by the counter of Philox, for
few numbers; `deadtime.numerics.generators.uniforms` is compiled, with the same numbers.
"""

from __future__ import annotations

from hashlib import blake2b

import numpy as np
from jaxtyping import Float, UInt64
from numpy.random.bit_generator import ISpawnableSeedSequence
from numpy.typing import DTypeLike

from deadtime.base.checks import read_only
from deadtime.base.errors import ArgumentError

WORDS = 4  # of Philox per counter
DROPPED = np.uint64(12)  # bits of a word; a double holds the others plus one half


class Words(ISpawnableSeedSequence):
    """A seed sequence for NumPy's generators: words of Philox with the key (seed, purpose)."""

    def __init__(self, seed: int, *purpose: str | int) -> None:
        self.seed, self.spawned = int(seed), 0
        self.purpose = (*(part if isinstance(part, str) else int(part) for part in purpose),)

    @property
    def key(self) -> tuple[int, int]:
        """The lower 64 bits of the seed, and a hash of the purpose and its other bits."""
        text = repr((*self.purpose, self.seed >> 64)).encode()
        return self.seed % 2**64, int.from_bytes(blake2b(text, digest_size=8).digest(), "little")

    def generate_state(self, n_words: int, dtype: DTypeLike = np.uint32) -> np.ndarray:
        if dtype != np.uint64:
            raise ArgumentError("dtype must be uint64: these words are for PCG64 and Philox.")
        return np.random.Philox(key=np.array(self.key, np.uint64)).random_raw(n_words)

    def spawn(self, n_children: int) -> list[ISpawnableSeedSequence]:
        first, self.spawned = self.spawned, self.spawned + n_children
        return [Words(self.seed, *self.purpose, i) for i in range(first, self.spawned)]


def stream(seed: int, name: str, index: int = 0, *spawned: int) -> np.random.Generator:
    """The generator for a purpose `name` and number `index`; with `spawned`, one spawned from it.

    Examples
    --------
    >>> stream(1, "Noise").random() == stream(1, "Noise").random()
    True
    >>> stream(1, "Noise").random() == stream(1, "Dropout").random()
    False
    """
    words = Words(seed, name, index, *spawned)
    return np.random.Generator(np.random.PCG64(words))  # pyright: ignore[reportArgumentType]


def key_of(seed: int) -> UInt64[np.ndarray, 2]:
    """Philox's key for a seed of at least 0."""
    return read_only(np.random.SeedSequence(seed).generate_state(2, np.uint64))


def uniforms(
    key: UInt64[np.ndarray, 2],
    scenarios: UInt64[np.ndarray, " count"],
    start: int,
    blocks: int,
    stream: int,
) -> Float[np.ndarray, "count number"]:
    """The numbers in (0, 1) of blocks start, …, start + blocks − 1 of a stream, (count, 4 blocks).

    Examples
    --------
    >>> whole = uniforms(key_of(1), np.array([7], np.uint64), start=0, blocks=3, stream=2)
    >>> part = uniforms(key_of(1), np.array([7], np.uint64), start=2, blocks=1, stream=2)
    >>> (part == whole[:, 8:]).all()
    np.True_
    """
    result = np.empty((scenarios.size, WORDS * blocks))
    for row, scenario in zip(result, scenarios, strict=True):
        # NumPy adds 1 to the counter before the first word.
        counter = (start + (int(scenario) << 64) + (stream << 128) - 1) % 2**256
        words = np.random.Philox(key=key, counter=counter).random_raw(row.size)
        row[:] = ((words >> DROPPED) + 0.5) * 2.0**-52
    return result
