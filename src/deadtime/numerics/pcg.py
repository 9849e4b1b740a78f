"""The numbers of many generators at once, compiled: what `numpy.random.default_rng` draws.

PCG64 multiplies a state of 128 bits and adds to it; each state gives a word of 64 bits. A uniform
number is the upper 53 bits of a word. A normal one is taken by Marsaglia and Tsang's ziggurat: 256
layers of equal area v under e^{−x²/2}, the edge of layer i at x_i with x_i (f(x_{i+1}) − f(x_i)) =
v. A word chooses a layer, a sign and a place in it; a place left of the next edge is below the
curve, which 99 % are.

NumPy's tables of edges carry the round-off of those who made them. Ours are exact to the last bit,
so normal numbers agree with NumPy's to some 1e-14 of themselves, and uniform ones in all bits.

This module needs Numba, so it is imported where it is used.

References
----------
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

from deadtime.base.checks import read_only
from deadtime.numerics.kernels import kernel
from deadtime.numerics.philox import first_words, high_word
from deadtime.numerics.streams import Words, stream

# Where the tail begins if 256 layers of its area are to end at x = 0, where the curve is 1.
TAIL = Decimal("3.654152885361008771645429720399515763")
_TAIL, _LAYERS, _PLACES = float(TAIL), 256, Decimal(2**52)
_M_HIGH, _M_LOW = np.uint64(0x2360ED051FC65DA4), np.uint64(0x4385DF649FCCF645)
_ZERO, _ONE, _BYTE = np.uint64(0), np.uint64(1), np.uint64(255)
_TURN, _BITS, _NINE, _ELEVEN = np.uint64(58), np.uint64(63), np.uint64(9), np.uint64(11)
_EIGHT, _PLACE = np.uint64(8), np.uint64(2**52 - 1)


class Layers(NamedTuple):
    """Layer by layer: the width of a place, how many places are below the curve, and f at its edge.

    Layer 0 is the lowest, the tail included; 1, …, 255 go from the top down.
    """

    width: Float[np.ndarray, " layer"]
    below: UInt64[np.ndarray, " layer"]
    height: Float[np.ndarray, " layer"]


@lru_cache(1)
def layers() -> Layers:
    """The ziggurat's tables, in 40 digits until they are rounded."""
    with localcontext() as context:
        context.prec = 40

        def curve(x: Decimal) -> Decimal:
            return (-x * x / 2).exp()

        ratio = TAIL  # of e^{−r²/2} to its integral from r on: a continued fraction
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
        """What `Generator.spawn` makes of each as number i."""
        return replace(self, spawned=(*self.spawned, i))

    def draw(self, first: int, normal: bool, room: Float[np.ndarray, "some count"]) -> None:
        """Fill `room` with the first numbers of generator number `first` and the next ones."""
        take = self.draw_compiled if draws_as_numpy() else self.draw_by_numpy
        take(first, normal, room)

    def draw_compiled(self, first: int, normal: bool, room: np.ndarray) -> None:
        """The same in all cases by our own generator."""
        words = self._words[first : first + len(room)]
        if normal:
            fill_normal(words, *layers(), room)
        else:
            fill_uniform(words, room)

    def draw_by_numpy(self, first: int, normal: bool, room: np.ndarray) -> None:
        """The same in all cases by NumPy's."""
        for row, rng in zip(room, self.generators(first, len(room)), strict=True):
            row[:] = rng.standard_normal(row.size) if normal else rng.random(row.size)

    def generators(self, first: int, count: int) -> Iterator[np.random.Generator]:
        """Some of them, NumPy's."""
        for seed in self.seeds[first : first + count]:
            yield stream(int(seed), self.name, self.index, *self.spawned)

    @cached_property
    def _words(self) -> UInt64[np.ndarray, "stream 4"]:
        purpose = Words(0, self.name, self.index, *self.spawned).key[1]
        return first_words(read_only(self.seeds), np.uint64(purpose))


@lru_cache(1)
def draws_as_numpy() -> bool:
    """Whether this NumPy draws as NumPy did when this was written: it does not promise to."""
    check, same = Streams(np.arange(2, dtype=np.uint64), "check", 0), True
    for normal in (False, True):
        mine, theirs = np.empty((2, 2, 1000))
        check.draw_compiled(0, normal, mine)
        check.draw_by_numpy(0, normal, theirs)
        same &= bool(np.allclose(mine, theirs, rtol=1e-12, atol=0.0))
    return same


@kernel(eager=True, nogil=True)
def _advance(high, low, more_high, more_low):
    """The next state, in two words, as is what is added to it."""
    above = high_word(low, _M_LOW) + high * _M_LOW + low * _M_HIGH  # pyright: ignore
    low = low * _M_LOW + more_low
    return above + more_high + (_ONE if low < more_low else _ZERO), low


@kernel(eager=True, nogil=True)
def _word(high, low):
    """What a state gives."""
    turn, word = high >> _TURN, high ^ low
    return (word >> turn) | (word << ((_ZERO - turn) & _BITS))


@kernel(eager=True, nogil=True)
def _uniform(word):
    return np.float64(np.int64(word >> _ELEVEN)) * 2.0**-53


@kernel(eager=True, nogil=True)
def _start(seed):
    """The state that four words make, and what is added to it."""
    more_high, more_low = (seed[2] << _ONE) | (seed[3] >> _BITS), (seed[3] << _ONE) | _ONE
    low = more_low + seed[1]
    high = more_high + seed[0] + (_ONE if low < more_low else _ZERO)
    high, low = _advance(high, low, more_high, more_low)
    return high, low, more_high, more_low


@kernel(eager=True, nogil=True)
def _beyond(high, low, more_high, more_low):
    """How far in the tail, and the state then."""
    while True:
        high, low = _advance(high, low, more_high, more_low)
        x = -math.log1p(-_uniform(_word(high, low))) / _TAIL
        high, low = _advance(high, low, more_high, more_low)
        y = -math.log1p(-_uniform(_word(high, low)))
        if 2.0 * y > x * x:
            return x, high, low


@kernel(eager=True, nogil=True)
def fill_uniform(seeds, result):
    """Numbers in [0, 1) of generators with these seeds (generators, 4): (generators, count)."""
    for g in range(seeds.shape[0]):
        high, low, more_high, more_low = _start(seeds[g])
        for i in range(result.shape[1]):
            high, low = _advance(high, low, more_high, more_low)
            result[g, i] = _uniform(_word(high, low))


@kernel(eager=True, nogil=True)
def fill_normal(seeds, width, below, height, result):
    """The same of the normal distribution; the others are `layers`."""
    for g in range(seeds.shape[0]):
        high, low, more_high, more_low = _start(seeds[g])
        i = 0
        while i < result.shape[1]:
            high, low = _advance(high, low, more_high, more_low)
            word = _word(high, low)
            layer, place = word & _BYTE, (word >> _NINE) & _PLACE
            x = np.float64(np.int64(place)) * width[layer]
            sign = 1.0 - 2.0 * np.float64(np.int64((word >> _EIGHT) & _ONE))
            if place >= below[layer]:
                if layer == _ZERO:
                    sign = 1.0 - 2.0 * np.float64(np.int64((place >> _EIGHT) & _ONE))
                    x, high, low = _beyond(high, low, more_high, more_low)
                    x += _TAIL
                else:
                    high, low = _advance(high, low, more_high, more_low)
                    edge = height[layer]
                    rise = (height[layer - _ONE] - edge) * _uniform(_word(high, low))
                    if rise + edge >= math.exp(-0.5 * x * x):
                        continue
            result[g, i] = sign * x
            i += 1
