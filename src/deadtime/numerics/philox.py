"""Numbers that are a function of where they stand: the generator Philox4x64-10, compiled.

Ten rounds of multiplications turn a counter of four words and a key of two into four random
words. There is no state to advance, so number w of block b of stream s of a scenario is the same
in whatever order, in whatever company and on whatever thread it is asked for:

    words = Philox(key, counter = (b, scenario, s, 0))

A word x becomes the double (⌊x/2¹²⌋ + 1/2)/2⁵², which is exact and never 0 or 1. With one bit more
the largest would round to 1.

`numpy.random.Philox` gives the same words (it adds 1 to the counter before the first of them). Its
own streams begin at s = 0, which is left to it.

This module needs Numba, so it is imported where it is used: for few numbers,
`deadtime.numerics.streams` has the same ones by `numpy.random.Philox`.

References
----------
Salmon, Moraes, Dror and Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from deadtime.numerics.kernels import kernel
from deadtime.numerics.streams import DROPPED, WORDS

_ROUNDS = 10
# Salmon et al. 2011, table 2 and section 3.3: the golden ratio and √3 − 1 step the keys.
_M0, _M1 = np.uint64(0xD2E7470EE14C6C93), np.uint64(0xCA5A826395121157)
_W0, _W1 = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBB67AE8584CAA73B)
_ZERO = np.uint64(0)


@intrinsic
def high_word(typing, a, b):
    """⌊ab/2⁶⁴⌋: a machine multiplies two words in one instruction, which no Numba type can say."""

    def generate(context, builder, signature, arguments):
        wide = ir.IntType(128)
        a, b = (builder.zext(word, wide) for word in arguments)
        high = builder.lshr(builder.mul(a, b), ir.Constant(wide, 64))
        return builder.trunc(high, ir.IntType(64))

    return types.uint64(types.uint64, types.uint64), generate


@kernel(eager=True, nogil=True)
def block_words(key, block, scenario, stream):
    """The four words at one counter."""
    c0, c1, c2, c3 = np.uint64(block), np.uint64(scenario), np.uint64(stream), _ZERO
    k0, k1 = key[0], key[1]
    for _ in range(_ROUNDS):
        high0, low0 = high_word(_M0, c0), _M0 * c0  # pyright: ignore[reportCallIssue]
        high1, low1 = high_word(_M1, c2), _M1 * c2  # pyright: ignore[reportCallIssue]
        c0, c1, c2, c3 = high1 ^ c1 ^ k0, low1, high0 ^ c3 ^ k1, low0
        k0, k1 = k0 + _W0, k1 + _W1
    return c0, c1, c2, c3


@kernel(eager=True, nogil=True)
def first_words(seeds, purpose):
    """The first words that NumPy draws with the key (seed, purpose), of many seeds (count, 4)."""
    result = np.empty((seeds.size, WORDS), np.uint64)
    for i in range(seeds.size):
        words = block_words((seeds[i], purpose), 1, 0, 0)
        for w in range(WORDS):
            result[i, w] = words[w]
    return result


@kernel(eager=True, nogil=True)
def uniform(word):
    """A word as a double in (0, 1)."""
    return (np.float64(word >> DROPPED) + 0.5) * 2.0**-52


@kernel(eager=True, nogil=True)
def uniforms(key, scenarios, start, blocks, stream):
    """The numbers in (0, 1) of blocks start, …, start + blocks − 1 of a stream, (count, 4 blocks).

    `key` is (2,) uint64, `scenarios` (count,) uint64.
    """
    result = np.empty((scenarios.size, WORDS * blocks))
    for i in range(scenarios.size):
        for b in range(blocks):
            w0, w1, w2, w3 = block_words(key, start + b, scenarios[i], stream)
            at = WORDS * b
            result[i, at], result[i, at + 1] = uniform(w0), uniform(w1)
            result[i, at + 2], result[i, at + 3] = uniform(w2), uniform(w3)
    return result
