"""Vectors of eight for compiled code: tuples of them are small vectors and matrices.

A tuple of k vectors holds k numbers of each of eight scenarios, or samples, side by side in one
register each. Sizes are types, so that every sum below is unrolled when it is compiled: `like`
arguments are tuples whose length alone is read. Arrays are flat; eight consecutive entries are one
vector.

The compiler vectorises such loops by itself only where it can prove that no two arrays overlap,
and then keeps no vector in a register from one period to the next.
"""

# Types of Numba are called to make signatures.
# pyright: reportCallIssue=false

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, register_model

LANES = 8

_REAL, _WORD, _INDEX = ir.DoubleType(), ir.IntType(64), ir.IntType(32)
_VECTOR, _WORDS = ir.VectorType(_REAL, LANES), ir.VectorType(_WORD, LANES)
_MANTISSA, _ONE = (1 << 52) - 1, 0x3FF0000000000000
_TWO_52 = 0x4330000000000000  # the bits of 2^52: an integer below 2^52 put there is 2^52 + it


class _Lanes(types.Type):
    def __init__(self) -> None:
        super().__init__(name="EightScenarios")


@register_model(_Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _VECTOR)


_LANES = _Lanes()


def _vectors(count: int) -> types.UniTuple:
    return types.UniTuple(_LANES, count)


class _Code:
    """Instructions on vectors, for the intrinsics below."""

    def __init__(self, context: Any, builder: Any) -> None:
        self.context, self.builder = context, builder

    def place(self, kind: Any, array: Any, index: Any, shift: int) -> Any:
        data = self.context.make_array(kind)(self.context, self.builder, array).data
        return self.builder.gep(data, [self.builder.add(index, ir.Constant(_WORD, shift))])

    def vector(self, kind: Any, array: Any, index: Any, shift: int) -> Any:
        place = self.place(kind, array, index, shift)
        loaded = self.builder.load(self.builder.bitcast(place, _VECTOR.as_pointer()))
        loaded.align = 8
        return loaded

    def same(self, number: Any) -> Any:
        """One number for every scenario."""
        undefined = ir.Constant(_VECTOR, ir.Undefined)
        first = self.builder.insert_element(undefined, number, ir.Constant(_INDEX, 0))
        zeros = ir.Constant(ir.VectorType(_INDEX, LANES), [0] * LANES)
        return self.builder.shuffle_vector(first, undefined, zeros)

    def shared(self, kind: Any, array: Any, index: Any, shift: int) -> Any:
        return self.same(self.builder.load(self.place(kind, array, index, shift)))

    def fma(self, a: Any, b: Any, c: Any) -> Any:
        kind = ir.FunctionType(_VECTOR, [_VECTOR] * 3)
        name = f"llvm.fma.v{LANES}f64"
        return self.builder.call(self.builder.module.declare_intrinsic(name, fnty=kind), [a, b, c])

    def words(self, value: int) -> Any:
        return ir.Constant(_WORDS, [value] * LANES)

    def larger(self, a: Any, b: Any) -> Any:
        return self.builder.select(self.builder.fcmp_ordered(">", a, b), a, b)

    def smaller(self, a: Any, b: Any) -> Any:
        return self.builder.select(self.builder.fcmp_ordered("<", a, b), a, b)


Work = Callable[..., Any]


def _made(signature: Any, work: Work) -> tuple[Any, Callable[..., Any]]:
    """The code of an intrinsic: `work` gets every tuple of vectors unpacked, and its result packed.

    Arrays come as (kind, array), so that they can be read.
    """

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        unpacked = []
        for kind, value in zip(signature.args, arguments, strict=True):
            if isinstance(kind, types.UniTuple):
                unpacked.append(cgutils.unpack_tuple(builder, value, len(kind)))
            elif isinstance(kind, types.Array):
                unpacked.append((kind, value))
            else:
                unpacked.append(value)
        result = work(_Code(context, builder), *unpacked)
        if signature.return_type is types.void:
            return context.get_dummy_value()
        if signature.return_type is types.float64:
            return result
        return context.make_tuple(builder, signature.return_type, result)

    return signature, code


@intrinsic
def load(_, array, index, like):
    """len(like) vectors, the first at array[index]."""

    def work(code: _Code, source: Any, start: Any, _: Any) -> list[Any]:
        return [code.vector(*source, start, LANES * k) for k in range(len(like))]

    return _made(_vectors(len(like))(array, types.intp, like), work)


@intrinsic
def store(_, array, index, values):
    """Put vectors into an array, the first at array[index]."""

    def work(code: _Code, target: Any, start: Any, given: Any) -> None:
        for k, value in enumerate(given):
            place = code.place(*target, start, LANES * k)
            code.builder.store(value, code.builder.bitcast(place, _VECTOR.as_pointer())).align = 8

    return _made(types.void(array, types.intp, values), work)


@intrinsic
def spread(_, array, index, stride, values):
    """array[index + l·stride + i] = entry l of vector i: each scenario's numbers side by side."""

    def work(code: _Code, target: Any, start: Any, width: Any, given: Any) -> None:
        for lane in range(LANES):
            shift = code.builder.mul(width, ir.Constant(_WORD, lane))
            first = code.builder.add(start, shift)
            for i, vector in enumerate(given):
                entry = code.builder.extract_element(vector, ir.Constant(_INDEX, lane))
                code.builder.store(entry, code.place(*target, first, i))

    return _made(types.void(array, types.intp, types.intp, values), work)


@intrinsic
def gather(_, array, places, like):
    """Vectors with array[places[l] + i] as entry l of vector i."""

    def work(code: _Code, source: Any, starts: Any, _: Any) -> list[Any]:
        result = [ir.Constant(_VECTOR, ir.Undefined)] * len(like)
        zero = ir.Constant(_WORD, 0)
        for lane in range(LANES):
            start = code.builder.load(code.place(*starts, zero, lane))
            for i in range(len(like)):
                entry = code.builder.load(code.place(*source, start, i))
                index = ir.Constant(_INDEX, lane)
                result[i] = code.builder.insert_element(result[i], entry, index)
        return result

    return _made(_vectors(len(like))(array, places, like), work)


@intrinsic
def same(_, value, like):
    """len(like) vectors of one number."""

    def work(code: _Code, number: Any, _: Any) -> list[Any]:
        return [code.same(number)] * len(like)

    return _made(_vectors(len(like))(types.float64, like), work)


@intrinsic
def first_of(_, a, b, c, like):
    """The first len(like) vectors of a, b and c."""

    def work(code: _Code, *parts: Any) -> list[Any]:
        return [vector for part in parts[:3] for vector in part][: len(like)]

    return _made(_vectors(len(like))(a, b, c, like), work)


@intrinsic
def own_product(_, array, index, z, to):
    """to + M z, M (len(to), len(z)) a matrix of each scenario's own, at array[index]."""
    width = len(z)

    def work(code: _Code, source: Any, start: Any, factors: Any, sums: Any) -> list[Any]:
        result = []
        for i, total in enumerate(sums):
            for j, factor in enumerate(factors):
                entry = code.vector(*source, start, LANES * (i * width + j))
                total = code.fma(entry, factor, total)
            result.append(total)
        return result

    return _made(to(array, types.intp, z, to), work)


@intrinsic
def product(_, array, index, z, to):
    """to + M z, M (len(to), len(z)) one matrix for all scenarios, at array[index]."""
    width = len(z)

    def work(code: _Code, source: Any, start: Any, factors: Any, sums: Any) -> list[Any]:
        result = []
        for i, total in enumerate(sums):
            for j, factor in enumerate(factors):
                total = code.fma(code.shared(*source, start, i * width + j), factor, total)
            result.append(total)
        return result

    return _made(to(array, types.intp, z, to), work)


@intrinsic
def matrix_product(_, matrix, z, to):
    """to + M z, M (len(to), len(z)) given as vectors, row by row."""
    width = len(z)

    def work(code: _Code, entries: Any, factors: Any, sums: Any) -> list[Any]:
        result = []
        for i, total in enumerate(sums):
            for entry, factor in zip(entries[i * width : (i + 1) * width], factors, strict=True):
                total = code.fma(entry, factor, total)
            result.append(total)
        return result

    return _made(to(matrix, z, to), work)


@intrinsic
def table_product(_, left, right, to):
    """to + L R, L (rows, n), R (n, columns) and the sum given as vectors, row by row."""

    def work(code: _Code, rows: Any, table: Any, sums: Any) -> list[Any]:
        # rows·n, n·columns and rows·columns are the lengths of the three.
        n = next(k for k in range(1, len(left) + 1) if k * k * len(to) == len(left) * len(right))
        columns, result = len(right) // n, []
        for place, total in enumerate(sums):
            i, j = divmod(place, columns)
            for k in range(n):
                total = code.fma(rows[i * n + k], table[k * columns + j], total)
            result.append(total)
        return result

    return _made(to(left, right, to), work)


@intrinsic
def block_product(_, array, index, z, to, block):
    """to + blkdiag(S_1, S_2, …) z, the blocks (len(block), len(block)) the same for all."""
    size = len(block)

    def work(code: _Code, source: Any, start: Any, factors: Any, sums: Any, _: Any) -> list[Any]:
        result = []
        for i, total in enumerate(sums):
            for j in range(size):
                entry = code.shared(*source, start, i * size + j)
                total = code.fma(entry, factors[i // size * size + j], total)
            result.append(total)
        return result

    return _made(to(array, types.intp, z, to, block), work)


@intrinsic
def own_form(_, array, index, z, to):
    """to + zᵀ Q z, the upper triangle of Q with its off-diagonal doubled, each scenario's own."""

    def work(code: _Code, source: Any, start: Any, factors: Any, sums: Any) -> list[Any]:
        (total,), k = sums, 0
        for i, left in enumerate(factors):
            row = code.same(ir.Constant(_REAL, 0.0))
            for right in factors[i:]:
                row = code.fma(code.vector(*source, start, LANES * k), right, row)
                k += 1
            total = code.fma(row, left, total)
        return [total]

    return _made(to(array, types.intp, z, to), work)


@intrinsic
def squares(_, z, to):
    """to + |z|²."""

    def work(code: _Code, factors: Any, sums: Any) -> list[Any]:
        (total,) = sums
        for factor in factors:
            total = code.fma(factor, factor, total)
        return [total]

    return _made(to(z, to), work)


@intrinsic
def times(_, a, b, to):
    """to + a b, entry by entry."""

    def work(code: _Code, *parts: Any) -> list[Any]:
        return [code.fma(*entries) for entries in zip(*parts, strict=True)]

    return _made(to(a, b, to), work)


@intrinsic
def larger(_, a, b):
    """The larger one, entry by entry; b where a is not a number."""

    def work(code: _Code, *parts: Any) -> list[Any]:
        return [code.larger(*entries) for entries in zip(*parts, strict=True)]

    return _made(a(a, b), work)


@intrinsic
def smaller(_, a, b):
    """The smaller one, entry by entry; b where a is not a number."""

    def work(code: _Code, *parts: Any) -> list[Any]:
        return [code.smaller(*entries) for entries in zip(*parts, strict=True)]

    return _made(a(a, b), work)


@intrinsic
def where_larger(_, a, b, value, other):
    """`value`, one number, where a > b, and `other` elsewhere."""

    def work(code: _Code, left: Any, right: Any, number: Any, rest: Any) -> list[Any]:
        new = code.same(number)
        return [
            code.builder.select(code.builder.fcmp_ordered(">", x, y), new, z)
            for x, y, z in zip(left, right, rest, strict=True)
        ]

    return _made(other(a, b, types.float64, other), work)


@intrinsic
def chosen(_, values, row, like):
    """Of rows of len(like) vectors, one after another, the row that each scenario has."""
    width = len(like)

    def work(code: _Code, given: Any, rows: Any, _: Any) -> list[Any]:
        result = list(given[:width])
        for r in range(1, len(given) // width):
            number = ir.Constant(_VECTOR, [float(r)] * LANES)
            here = code.builder.fcmp_ordered("==", rows[0], number)
            for j in range(width):
                result[j] = code.builder.select(here, given[r * width + j], result[j])
        return result

    return _made(_vectors(len(like))(values, row, like), work)


@intrinsic
def mantissa(_, a):
    """a / 2^e in [1, 2) for positive a."""

    def work(code: _Code, given: Any) -> list[Any]:
        build = code.builder
        bits = [build.bitcast(v, _WORDS) for v in given]
        bits = [build.or_(build.and_(v, code.words(_MANTISSA)), code.words(_ONE)) for v in bits]
        return [build.bitcast(v, _VECTOR) for v in bits]

    return _made(a(a), work)


@intrinsic
def exponent(_, a):
    """The e of `mantissa`, as a floating number."""

    def work(code: _Code, given: Any) -> list[Any]:
        build, result = code.builder, []
        for vector in given:
            bits = build.lshr(build.bitcast(vector, _WORDS), code.words(52))
            shifted = build.bitcast(build.or_(bits, code.words(_TWO_52)), _VECTOR)
            offset = ir.Constant(_VECTOR, [2.0**52 + 1023.0] * LANES)
            result.append(build.fsub(shifted, offset))
        return result

    return _made(a(a), work)


@intrinsic
def total(_, a):
    """The sum of all entries of all vectors."""

    def work(code: _Code, given: Any) -> Any:
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
            mask = ir.Constant(ir.VectorType(_INDEX, LANES), order)
            result = build.fadd(result, build.shuffle_vector(result, result, mask))
        result = build.extract_element(result, ir.Constant(_INDEX, 0))
        return result

    return _made(types.float64(a), work)
