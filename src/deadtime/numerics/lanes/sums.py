"""Sums of products of vectors."""

# Types of Numba are called to make signatures.
# pyright: reportCallIssue=false

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from deadtime.numerics.lanes.code import INDEX, LANES, REAL, Code, make_code


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

    def work(code: Code, *parts: Any) -> list[Any]:
        return [code.fma(*entries) for entries in zip(*parts, strict=True)]

    return make_code(to(a, b, to), work)


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
