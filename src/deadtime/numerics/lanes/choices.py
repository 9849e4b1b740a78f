"""The larger, the smaller, one of several; mantissas and exponents."""

# Types of Numba are called to make signatures.
# pyright: reportCallIssue=false

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from deadtime.numerics.lanes.code import LANES, VECTOR, Code, make_code, vectors

_MANTISSA, _ONE = (1 << 52) - 1, 0x3FF0000000000000
_TWO_52 = 0x4330000000000000  # the bits of 2^52: an integer below 2^52 put there is 2^52 + it


@intrinsic
def larger(_, a, b):
    """The larger one, entry by entry; b where a is not a number."""

    def work(code: Code, *parts: Any) -> list[Any]:
        return [code.larger(*entries) for entries in zip(*parts, strict=True)]

    return make_code(a(a, b), work)


@intrinsic
def smaller(_, a, b):
    """The smaller one, entry by entry; b where a is not a number."""

    def work(code: Code, *parts: Any) -> list[Any]:
        return [code.smaller(*entries) for entries in zip(*parts, strict=True)]

    return make_code(a(a, b), work)


@intrinsic
def where_larger(_, a, b, value, other):
    """`value`, one number, where a > b, and `other` elsewhere."""

    def work(code: Code, left: Any, right: Any, number: Any, rest: Any) -> list[Any]:
        new = code.same(number)
        return [
            code.builder.select(code.builder.fcmp_ordered(">", x, y), new, z)
            for x, y, z in zip(left, right, rest, strict=True)
        ]

    return make_code(other(a, b, types.float64, other), work)


@intrinsic
def choose(_, values, row, like):
    """Of rows of len(like) vectors, one after another, the row that each scenario has."""
    width = len(like)

    def work(code: Code, given: Any, rows: Any, _: Any) -> list[Any]:
        result = list(given[:width])
        for r in range(1, len(given) // max(width, 1)):
            number = ir.Constant(VECTOR, [float(r)] * LANES)
            here = code.builder.fcmp_ordered("==", rows[0], number)
            for j in range(width):
                result[j] = code.builder.select(here, given[r * width + j], result[j])
        return result

    return make_code(vectors(len(like))(values, row, like), work)


@intrinsic
def mantissa(_, a):
    """a / 2^e in [1, 2) for positive a."""

    def work(code: Code, given: Any) -> list[Any]:
        return [mantissa_of(code, vector) for vector in given]

    return make_code(a(a), work)


@intrinsic
def exponent(_, a):
    """The e of `mantissa`, as a floating number."""

    def work(code: Code, given: Any) -> list[Any]:
        return [exponent_of(code, vector) for vector in given]

    return make_code(a(a), work)


def mantissa_of(code: Code, a: Any) -> Any:
    """`mantissa` of a float or a vector."""
    build, words = code.builder, code.words_like(a)
    bits = build.and_(build.bitcast(a, words), code.bits(words, _MANTISSA))
    return build.bitcast(build.or_(bits, code.bits(words, _ONE)), a.type)


def exponent_of(code: Code, a: Any) -> Any:
    """`exponent` of a float or a vector."""
    build, words = code.builder, code.words_like(a)
    bits = build.lshr(build.bitcast(a, words), code.bits(words, 52))
    shifted = build.bitcast(build.or_(bits, code.bits(words, _TWO_52)), a.type)
    return build.fsub(shifted, code.number(a.type, 2.0**52 + 1023.0))
