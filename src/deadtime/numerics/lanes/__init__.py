"""Vectors of eight for compiled code: tuples of them are small vectors and matrices.

A tuple of k vectors holds k numbers of each of eight scenarios, or samples, each vector in one
register. Sizes are types, so that the compiler unrolls every sum: of `like` arguments only the
length of the tuple is used. Arrays are flat; eight consecutive entries are one vector:

    number            0              1
    scenario   0 1 2 3 4 5 6 7 | 0 1 2 3 4 5 6 7 | …

The compiler vectorises plain loops only if it can prove that arrays do not overlap, and even then
keeps no vector in a register from one period to the next.
"""

from deadtime.numerics.lanes.code import LANES as LANES, KnownNumbers as KnownNumbers
from deadtime.numerics.lanes.intrinsics import (
    block_product as block_product,
    choose as choose,
    exponent as exponent,
    first_of as first_of,
    gather as gather,
    larger as larger,
    load as load,
    load_each as load_each,
    mantissa as mantissa,
    matrix_product as matrix_product,
    own_form as own_form,
    own_product as own_product,
    product as product,
    same as same,
    smaller as smaller,
    spread as spread,
    squares as squares,
    store as store,
    times as times,
    total as total,
    where_larger as where_larger,
)
from deadtime.numerics.lanes.operators import lanes_of as lanes_of
