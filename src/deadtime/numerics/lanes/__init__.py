"""Vectors of eight for compiled code: tuples of them are small vectors and matrices.

A tuple of k vectors holds k numbers of each of eight scenarios, or samples, side by side in one
register each. Sizes are types, so that every sum below is unrolled when it is compiled: `like`
arguments are tuples whose length alone is read. Arrays are flat; eight consecutive entries are one
vector.

The compiler vectorises such loops by itself only where it can prove that no two arrays overlap,
and then keeps no vector in a register from one period to the next.
"""

from deadtime.numerics.lanes.code import LANES, KnownNumbers
from deadtime.numerics.lanes.intrinsics import (
    block_product,
    choose,
    exponent,
    first_of,
    gather,
    larger,
    load,
    load_each,
    mantissa,
    matrix_product,
    own_form,
    own_product,
    product,
    same,
    smaller,
    spread,
    squares,
    store,
    times,
    total,
    where_larger,
)
from deadtime.numerics.lanes.operators import lanes_of

__all__ = [
    "LANES",
    "KnownNumbers",
    "block_product",
    "choose",
    "exponent",
    "first_of",
    "gather",
    "lanes_of",
    "larger",
    "load",
    "load_each",
    "mantissa",
    "matrix_product",
    "own_form",
    "own_product",
    "product",
    "same",
    "smaller",
    "spread",
    "squares",
    "store",
    "times",
    "total",
    "where_larger",
]
