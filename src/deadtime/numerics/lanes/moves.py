"""Vectors from memory, to memory, and of numbers."""

# Types of Numba are called to make signatures.
# pyright: reportCallIssue=false

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from deadtime.numerics.lanes.code import INDEX, LANES, VECTOR, WORD, Code, make_code, vectors


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
    """Put vectors into an array, the first at array[index]."""

    def work(code: Code, target: Any, start: Any, given: Any) -> None:
        for k, value in enumerate(given):
            place = code.place(*target, start, LANES * k)
            code.builder.store(value, code.builder.bitcast(place, VECTOR.as_pointer())).align = 8

    return make_code(types.void(array, types.intp, values), work)


@intrinsic
def spread(_, array, index, stride, values):
    """array[index + l·stride + i] = entry l of vector i: each scenario's numbers side by side."""

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
