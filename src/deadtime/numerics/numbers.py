"""Functions of numbers for plain loops, beside `math`, for one scenario or for eight.

The formulas of a running law are written once, for numbers that are floats in a single run, and in
a batch vectors with one float per scenario of eight (`deadtime.numerics.lanes`). Compiled code has
the same operators for both. A condition that differs between scenarios cannot be a branch; `where`
selects one of two values instead.
"""

from __future__ import annotations

import math

import numpy as np


def where(condition, a, b):
    """a where the condition holds, else b; both are computed."""
    return a if condition else b


def ratio(a, b):
    """a / b where b > 0, else 0."""
    return a / b if b > 0.0 else 0.0


def mantissa(a):
    """a / 2^e in [1, 2), a > 0."""
    return 2.0 * math.frexp(a)[0]


def exponent(a):
    """The e of `mantissa`, as a floating number."""
    return math.frexp(a)[1] - 1.0


def flat(array):
    """A contiguous array as one row."""
    return array.reshape(-1)


def arrays_of(*shapes: tuple[int, ...], lanes: tuple[int, ...] = ()) -> list[np.ndarray]:
    """Arrays of zeros of these shapes, each followed by `lanes`, in one buffer."""
    sizes = [math.prod(shape) * math.prod(lanes) for shape in shapes]
    buffer = np.zeros(sum(sizes) + 8)
    # Aligned to eight doubles, a cache line and a vector.
    begin = -(buffer.ctypes.data // buffer.itemsize) % 8
    arrays = []
    for shape, size in zip(shapes, sizes, strict=True):
        arrays.append(buffer[begin : begin + size].reshape(*shape, *lanes))
        begin += size
    return arrays


def room_of(memory, sizes):
    """Working memory of `sizes.room` numbers: `memory`, or registers in code for eight."""
    return memory
