"""Compiled random numbers of many scenarios or seeds: Philox4x64-10, and PCG64.

Philox is counter-based: ten rounds of multiplications turn a counter of four words and a key of two
into four random words,

    words = Philox(key, counter = (b, scenario, s, 0))

for block b of stream s. Without a state the numbers do not depend on the order of calls, on other
scenarios or on threads. A word x becomes the double (⌊x/2¹²⌋ + 1/2)/2⁵², which is exact and never 0
or 1; with one bit more the largest would round to 1. `numpy.random.Philox` has the same words (it
adds 1 to the counter before the first one). Stream s = 0 is left to NumPy's own use.

PCG64 is the generator of `numpy.random.default_rng`: a linear congruential state of 128 bits, each
of which gives a word of 64 bits. A uniform number is the upper 53 bits of a word. A normal number
is drawn by the ziggurat of Marsaglia and Tsang: 256 layers of equal area v under e^{−x²/2}, the
edge of layer i at x_i with x_i (f(x_{i+1}) − f(x_i)) = v. A word gives a layer, a sign and a
position in it; a position left of the next edge, as 99 % are, is below the curve.

NumPy's tables of edges have round-off. The ones here are correctly rounded, so that normal numbers
agree with NumPy's to a relative 1e-14, and uniform ones bitwise.

This module needs Numba, so it is imported where it is used; for few numbers
`deadtime.numerics.streams` has the same ones by NumPy's generators.

References
----------
Salmon, Moraes, Dror and Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011.
O'Neill, "PCG: A family of simple fast space-efficient statistically good algorithms for random
number generation", HMC-CS-2014-0905. Marsaglia and Tsang, "The ziggurat method for generating
random variables", Journal of Statistical Software 5(8), 2000.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from decimal import Decimal, localcontext
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt64
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from deadtime.base.checks import read_only
from deadtime.numerics.kernels import kernel
from deadtime.numerics.streams import DROPPED, WORDS, Words, stream

_ROUNDS = 10
# Salmon et al. 2011, table 2 and section 3.3: the golden ratio and √3 − 1 step the keys.
_M0, _M1 = np.uint64(0xD2E7470EE14C6C93), np.uint64(0xCA5A826395121157)
_W0, _W1 = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBB67AE8584CAA73B)
_ZERO = np.uint64(0)


@intrinsic
def high_word(typing, a, b):
    """⌊ab/2⁶⁴⌋: one machine instruction, for which Numba has no type."""

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
    """The first words that NumPy draws with the keys (seed, purpose), (count, 4)."""
    result = np.empty((seeds.size, WORDS), np.uint64)
    for i in range(seeds.size):
        # NumPy adds 1 to the counter before the first words.
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


# The beginning of the tail for which 256 layers of its area end exactly at x = 0.
TAIL = Decimal("3.654152885361008771645429720399515763")
_TAIL, _LAYERS, _PLACES = float(TAIL), 256, Decimal(2**52)
_M_HIGH, _M_LOW = np.uint64(0x2360ED051FC65DA4), np.uint64(0x4385DF649FCCF645)
_ZERO, _ONE, _BYTE = np.uint64(0), np.uint64(1), np.uint64(255)
_TURN, _BITS, _NINE, _ELEVEN = np.uint64(58), np.uint64(63), np.uint64(9), np.uint64(11)
_EIGHT, _PLACE = np.uint64(8), np.uint64(2**52 - 1)


class Layers(NamedTuple):
    """Tables by layer: width of a position, number of positions below the curve, f at the edge.

    Layer 0 is the lowest, with the tail; 1, …, 255 go from the top down.
    """

    width: Float[np.ndarray, " layer"]
    below: UInt64[np.ndarray, " layer"]
    height: Float[np.ndarray, " layer"]


@lru_cache(1)
def layers() -> Layers:
    """The tables of the ziggurat, computed with 40 digits."""
    with localcontext() as context:
        context.prec = 40

        def curve(x: Decimal) -> Decimal:
            return (-x * x / 2).exp()

        ratio = TAIL  # e^{−r²/2} over its integral from r on, by a continued fraction
        for k in range(200, 0, -1):
            ratio = TAIL + k / ratio
        area = curve(TAIL) * (TAIL + 1 / ratio)
        edges = [TAIL]
        for _ in range(_LAYERS - 2):
            edges.append((-2 * (area / edges[-1] + curve(edges[-1])).ln()).sqrt())
        edges = [area / curve(TAIL), *reversed(edges)]
        inner = [TAIL, Decimal(0), *edges[1:-1]]
        below = [int(_PLACES * a / b) for a, b in zip(inner, edges, strict=True)]
        width = [float(x / _PLACES) for x in edges]
        height = [1.0, *(float(curve(x)) for x in edges[1:])]
    return Layers(
        read_only(np.array(width)),
        read_only(np.array(below, np.uint64)),
        read_only(np.array(height)),
    )


@dataclass(frozen=True, eq=False)
class Streams:
    """The generators `stream(seed, name, index, *spawned)` of many seeds.

    Examples
    --------
    >>> many, room = Streams(np.array([4, 9], np.uint64), "Noise", 0), np.empty((1, 5))
    >>> many.draw(1, True, room)
    >>> bool(np.allclose(room, stream(9, "Noise").standard_normal(5), rtol=1e-13, atol=0.0))
    True
    """

    seeds: UInt64[np.ndarray, " stream"]
    name: str
    index: int
    spawned: tuple[int, ...] = ()

    def spawned_as(self, i: int) -> Streams:
        """The generators number i of `Generator.spawn`."""
        return replace(self, spawned=(*self.spawned, i))

    def draw(self, first: int, normal: bool, room: Float[np.ndarray, "some count"]) -> None:
        """Fill each row of `room` with the first numbers of a generator, from number `first` on."""
        take = self.draw_compiled if draws_as_numpy() else self.draw_by_numpy
        take(first, normal, room)

    def draw_compiled(self, first: int, normal: bool, room: np.ndarray) -> None:
        """`draw` by the generator of this module."""
        words = self._words[first : first + len(room)]
        if normal:
            fill_normal(words, *layers(), room)
        else:
            fill_uniform(words, room)

    def draw_by_numpy(self, first: int, normal: bool, room: np.ndarray) -> None:
        """`draw` by NumPy's generator."""
        for row, rng in zip(room, self.generators(first, len(room)), strict=True):
            row[:] = rng.standard_normal(row.size) if normal else rng.random(row.size)

    def generators(self, first: int, count: int) -> Iterator[np.random.Generator]:
        """NumPy's generators first, …, first + count − 1."""
        for seed in self.seeds[first : first + count]:
            yield stream(int(seed), self.name, self.index, *self.spawned)

    @cached_property
    def _words(self) -> UInt64[np.ndarray, "stream 4"]:
        purpose = Words(0, self.name, self.index, *self.spawned).key[1]
        return first_words(read_only(self.seeds), np.uint64(purpose))


@lru_cache(1)
def draws_as_numpy() -> bool:
    """Whether the installed NumPy draws these numbers, which NumPy does not guarantee."""
    check, same = Streams(np.arange(2, dtype=np.uint64), "check", 0), True
    for normal in (False, True):
        mine, theirs = np.empty((2, 2, 1000))
        check.draw_compiled(0, normal, mine)
        check.draw_by_numpy(0, normal, theirs)
        same &= bool(np.allclose(mine, theirs, rtol=1e-12, atol=0.0))
    return same


@kernel(eager=True, nogil=True)
def _advance(high, low, more_high, more_low):
    """The next state; state and increment are two words each."""
    above = high_word(low, _M_LOW) + high * _M_LOW + low * _M_HIGH  # pyright: ignore
    low = low * _M_LOW + more_low
    return above + more_high + (_ONE if low < more_low else _ZERO), low


@kernel(eager=True, nogil=True)
def _word(high, low):
    """The word of a state."""
    turn, word = high >> _TURN, high ^ low
    return (word >> turn) | (word << ((_ZERO - turn) & _BITS))


@kernel(eager=True, nogil=True)
def _uniform(word):
    return np.float64(np.int64(word >> _ELEVEN)) * 2.0**-53


@kernel(eager=True, nogil=True)
def _start(seed):
    """State and increment from a seed of four words."""
    more_high, more_low = (seed[2] << _ONE) | (seed[3] >> _BITS), (seed[3] << _ONE) | _ONE
    low = more_low + seed[1]
    # The increment is odd, and a sum below its summand carries into the upper word.
    high = more_high + seed[0] + (_ONE if low < more_low else _ZERO)
    high, low = _advance(high, low, more_high, more_low)
    return high, low, more_high, more_low


@kernel(eager=True, nogil=True)
def _beyond(high, low, more_high, more_low):
    """The distance of a number in the tail from its beginning, and the state after it."""
    while True:
        high, low = _advance(high, low, more_high, more_low)
        x = -math.log1p(-_uniform(_word(high, low))) / _TAIL
        high, low = _advance(high, low, more_high, more_low)
        y = -math.log1p(-_uniform(_word(high, low)))
        if 2.0 * y > x * x:
            return x, high, low


@kernel(eager=True, nogil=True)
def fill_uniform(seeds, result):
    """Fill (generators, count) with numbers in [0, 1) from seeds (generators, 4)."""
    for g in range(seeds.shape[0]):
        high, low, more_high, more_low = _start(seeds[g])
        for i in range(result.shape[1]):
            high, low = _advance(high, low, more_high, more_low)
            result[g, i] = _uniform(_word(high, low))


@kernel(eager=True, nogil=True)
def fill_normal(seeds, width, below, height, result):
    """`fill_uniform` for the normal distribution, with the tables of `layers`."""
    for g in range(seeds.shape[0]):
        high, low, more_high, more_low = _start(seeds[g])
        i = 0
        while i < result.shape[1]:
            high, low = _advance(high, low, more_high, more_low)
            word = _word(high, low)
            # Bits of the word: 8 for the layer, 1 for the sign, 52 for the position.
            layer, place = word & _BYTE, (word >> _NINE) & _PLACE
            x = np.float64(np.int64(place)) * width[layer]
            sign = 1.0 - 2.0 * np.float64(np.int64((word >> _EIGHT) & _ONE))
            if place >= below[layer]:
                if layer == _ZERO:
                    # NumPy takes the sign of a number in the tail from another bit.
                    sign = 1.0 - 2.0 * np.float64(np.int64((place >> _EIGHT) & _ONE))
                    x, high, low = _beyond(high, low, more_high, more_low)
                    x += _TAIL
                else:
                    high, low = _advance(high, low, more_high, more_low)
                    # In the wedge between two edges a second number decides, by rejection.
                    edge = height[layer]
                    rise = (height[layer - _ONE] - edge) * _uniform(_word(high, low))
                    if rise + edge >= math.exp(-0.5 * x * x):
                        continue
            result[g, i] = sign * x
            i += 1
