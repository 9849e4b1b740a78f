"""Functions of numbers that plain loops need beside `math`, for one scenario or for eight.

A formula of a running law is written once, over numbers: of one run a number is a float, of a batch
it is a vector with one float of each of eight scenarios (`deadtime.numerics.lanes`), and compiled
code has the same operators for both. What differs from scenario to scenario is then no branch but a
choice between two values, `where`, and a comparison may be a vector of eight.
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
    """All numbers of an array whose rows follow each other, in one row."""
    return array.reshape(-1)


def arrays_of(*shapes: tuple[int, ...], lanes: tuple[int, ...] = ()) -> list[np.ndarray]:
    """Arrays of zeros of these shapes in one buffer, of so many scenarios if any."""
    sizes = [math.prod(shape) * math.prod(lanes) for shape in shapes]
    buffer = np.zeros(sum(sizes) + 8)
    begin = -(buffer.ctypes.data // buffer.itemsize) % 8
    arrays = []
    for shape, size in zip(shapes, sizes, strict=True):
        arrays.append(buffer[begin : begin + size].reshape(*shape, *lanes))
        begin += size
    return arrays


def room_of(memory, sizes):
    """`memory`, of `sizes.room` numbers, to work in; compiled code of eight takes registers."""
    return memory
