"""Intrinsics on tuples of vectors: loads and stores, choices, mantissas, and sums of products."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from deadtime.numerics.lanes.code import INDEX, LANES, REAL, VECTOR, WORD, Code, make_code, vectors

# Types of Numba are called to make signatures.
# pyright: reportCallIssue=false


_MANTISSA, _ONE = (1 << 52) - 1, 0x3FF0000000000000
_TWO_52 = 0x4330000000000000  # the bits of 2^52; with an integer i < 2^52 in its mantissa 2^52 + i


def _by_entry(instruction: Callable[..., Any]) -> Callable[..., list[Any]]:
    def work(code: Code, *parts: Any) -> list[Any]:
        return [instruction(code, *entries) for entries in zip(*parts, strict=True)]

    return work


@intrinsic
def larger(_, a, b):
    """The larger one, entry by entry; b where a is not a number."""
    return make_code(a(a, b), _by_entry(Code.larger))


@intrinsic
def smaller(_, a, b):
    """The smaller one, entry by entry; b where a is not a number."""
    return make_code(a(a, b), _by_entry(Code.smaller))


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
    """The row of each scenario, from consecutive rows of len(like) vectors."""
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
    return make_code(a(a), _by_entry(mantissa_of))


@intrinsic
def exponent(_, a):
    """The e of `mantissa`, as a float."""
    return make_code(a(a), _by_entry(exponent_of))


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


@intrinsic
def load(_, array, index, like):
    """len(like) vectors, the first at array[index]."""

    def work(code: Code, source: Any, start: Any, _: Any) -> list[Any]:
        return [code.vector(*source, start, LANES * k) for k in range(len(like))]

    return make_code(vectors(len(like))(array, types.intp, like), work)


@intrinsic
def load_each(_, array, places, like, all_like):
    """len(like) vectors from each of the places, the first of them at array[place]."""

    def work(code: Code, source: Any, starts: Any, *_: Any) -> list[Any]:
        zero, result = ir.Constant(WORD, 0), []
        for place in range(len(all_like) // len(like)):
            start = code.builder.load(code.place(*starts, zero, place))
            result += [code.vector(*source, start, LANES * k) for k in range(len(like))]
        return result

    return make_code(vectors(len(all_like))(array, places, like, all_like), work)


@intrinsic
def store(_, array, index, values):
    """Store vectors into an array, the first at array[index]."""

    def work(code: Code, target: Any, start: Any, given: Any) -> None:
        for k, value in enumerate(given):
            place = code.place(*target, start, LANES * k)
            code.builder.store(value, code.builder.bitcast(place, VECTOR.as_pointer())).align = 8

    return make_code(types.void(array, types.intp, values), work)


@intrinsic
def spread(_, array, index, stride, values):
    """array[index + l·stride + i] = entry l of vector i: the numbers of a scenario in a row."""

    def work(code: Code, target: Any, start: Any, width: Any, given: Any) -> None:
        for lane in range(LANES):
            shift = code.builder.mul(width, ir.Constant(WORD, lane))
            first = code.builder.add(start, shift)
            for i, vector in enumerate(given):
                entry = code.builder.extract_element(vector, ir.Constant(INDEX, lane))
                code.builder.store(entry, code.place(*target, first, i))

    return make_code(types.void(array, types.intp, types.intp, values), work)


@intrinsic
def gather(_, array, places, like):
    """Vectors with array[places[l] + i] as entry l of vector i."""

    def work(code: Code, source: Any, starts: Any, _: Any) -> list[Any]:
        result = [ir.Constant(VECTOR, ir.Undefined)] * len(like)
        zero = ir.Constant(WORD, 0)
        for lane in range(LANES):
            start = code.builder.load(code.place(*starts, zero, lane))
            for i in range(len(like)):
                entry = code.builder.load(code.place(*source, start, i))
                index = ir.Constant(INDEX, lane)
                result[i] = code.builder.insert_element(result[i], entry, index)
        return result

    return make_code(vectors(len(like))(array, places, like), work)


@intrinsic
def same(_, value, like):
    """len(like) vectors of one number."""

    def work(code: Code, number: Any, _: Any) -> list[Any]:
        return [code.same(number)] * len(like)

    return make_code(vectors(len(like))(types.float64, like), work)


@intrinsic
def first_of(_, a, b, c, like):
    """The first len(like) vectors of a, b and c."""

    def work(code: Code, *parts: Any) -> list[Any]:
        return [vector for part in parts[:3] for vector in part][: len(like)]

    return make_code(vectors(len(like))(a, b, c, like), work)


def _combine(code: Code, entry: Callable[[int, int], Any], factors: Any, sums: Any) -> list[Any]:
    """sum_i + Σ_j entry(i, j) factor_j."""
    result = []
    for i, total in enumerate(sums):
        for j, factor in enumerate(factors):
            total = code.fma(entry(i, j), factor, total)
        result.append(total)
    return result


@intrinsic
def own_product(_, array, index, z, to):
    """to + M z, M (len(to), len(z)) a matrix of each scenario's own, at array[index]."""
    width = len(z)

    def work(code: Code, source: Any, start: Any, factors: Any, sums: Any) -> list[Any]:
        def entry(i: int, j: int) -> Any:
            return code.vector(*source, start, LANES * (i * width + j))

        return _combine(code, entry, factors, sums)

    return make_code(to(array, types.intp, z, to), work)


@intrinsic
def product(_, array, index, z, to):
    """to + M z, M (len(to), len(z)) one matrix for all scenarios, at array[index]."""
    width = len(z)

    def work(code: Code, source: Any, start: Any, factors: Any, sums: Any) -> list[Any]:
        def entry(i: int, j: int) -> Any:
            return code.load_same(*source, start, i * width + j)

        return _combine(code, entry, factors, sums)

    return make_code(to(array, types.intp, z, to), work)


@intrinsic
def matrix_product(_, matrix, z, to):
    """to + M z, M (len(to), len(z)) given as vectors, row by row."""
    width = len(z)

    def work(code: Code, entries: Any, factors: Any, sums: Any) -> list[Any]:
        return _combine(code, lambda i, j: entries[i * width + j], factors, sums)

    return make_code(to(matrix, z, to), work)


@intrinsic
def block_product(_, array, index, z, to, block):
    """to + blkdiag(S_1, S_2, …) z, the blocks (len(block), len(block)) the same for all."""
    size = len(block)

    def work(code: Code, source: Any, start: Any, factors: Any, sums: Any, _: Any) -> list[Any]:
        result = []
        for i, total in enumerate(sums):
            for j in range(size):
                entry = code.load_same(*source, start, i * size + j)
                total = code.fma(entry, factors[i // size * size + j], total)
            result.append(total)
        return result

    return make_code(to(array, types.intp, z, to, block), work)


@intrinsic
def own_form(_, array, index, z, to):
    """to + zᵀ Q z, the upper triangle of Q with its off-diagonal doubled, each scenario's own."""

    def work(code: Code, source: Any, start: Any, factors: Any, sums: Any) -> list[Any]:
        (total,), k = sums, 0
        for i, left in enumerate(factors):
            row = code.same(ir.Constant(REAL, 0.0))
            for right in factors[i:]:
                row = code.fma(code.vector(*source, start, LANES * k), right, row)
                k += 1
            total = code.fma(row, left, total)
        return [total]

    return make_code(to(array, types.intp, z, to), work)


@intrinsic
def squares(_, z, to):
    """to + |z|²."""

    def work(code: Code, factors: Any, sums: Any) -> list[Any]:
        (total,) = sums
        for factor in factors:
            total = code.fma(factor, factor, total)
        return [total]

    return make_code(to(z, to), work)


@intrinsic
def times(_, a, b, to):
    """to + a b, entry by entry."""
    return make_code(to(a, b, to), _by_entry(Code.fma))


@intrinsic
def total(_, a):
    """The sum of all entries of all vectors."""

    def work(code: Code, given: Any) -> Any:
        build, vectors = code.builder, list(given)
        while len(vectors) > 1:
            vectors = [
                build.fadd(*vectors[k : k + 2]) if k + 1 < len(vectors) else vectors[k]
                for k in range(0, len(vectors), 2)
            ]
        (result,), width = vectors, LANES
        while width > 1:
            # Fold the upper half onto the lower one.
            width //= 2
            order = [*range(width, 2 * width), *[0] * (LANES - width)]
            mask = ir.Constant(ir.VectorType(INDEX, LANES), order)
            result = build.fadd(result, build.shuffle_vector(result, result, mask))
        result = build.extract_element(result, ir.Constant(INDEX, 0))
        return result

    return make_code(types.float64(a), work)
