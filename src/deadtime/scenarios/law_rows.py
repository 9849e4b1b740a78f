"""What factorised and dense rows keep of past inputs, eight scenarios at once: see `kernel`."""

# Intrinsics take one argument less than the functions that declare them.
# pyright: reportCallIssue=false

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deadtime.numerics.kernels import inner_kernel, kernel
from deadtime.numerics.lanes import LANES, first_of, load, product, same, store, times, total
from deadtime.scenarios.side_by_side import row_of_mode

_ONE = (0.0,)
_FOUR, _FIVE = (0.0,) * 4, (0.0,) * 5


@kernel(eager=True, nogil=True)
def dot(a, i, b, j, length):
    """Σ a[i + k] b[j + k] over a length that is a multiple of 8."""
    sums = same(0.0, _FOUR)
    k = 0
    while k + 4 * LANES <= length:
        sums = times(load(a, i + k, _FOUR), load(b, j + k, _FOUR), sums)
        k += 4 * LANES
    rest = same(0.0, _ONE)
    while k < length:
        rest = times(load(a, i + k, _ONE), load(b, j + k, _ONE), rest)
        k += LANES
    return total(first_of(sums, rest, rest, _FIVE))


@inner_kernel
def refill(shape, factored, ring, period, now, carry):
    """What the previous block of inputs adds to each sum of the coming one.

    With s_r = Σ_{i ≥ r} S^{W−1−i} Γ u_{k−W+i}, the sum r periods on gets H S^r s_r. Nothing is
    subtracted, so nothing cancels.
    """
    m, asked = len(shape.u), len(shape.rows)
    q = len(shape.b)
    s = same(0.0, shape.b)
    place = now
    for r in range(factored.length - 1, -1, -1):
        place = period - 1 if place == 0 else place - 1
        u = load(ring, place * m * LANES, shape.u)
        s = product(factored.ahead, r * q * m, u, s)
        sums = product(factored.behind, r * asked * q, s, same(0.0, shape.rows))
        store(carry, r * asked * LANES, sums)


class RowWindow(NamedTuple):
    """Memory of dense rows.

    line : scenario by scenario, inputs twice over, so that N of them lie side by side wherever the
    ring begins;  sums : of all inputs but the latest;  row : each scenario's, and where its head is
    """

    line: np.ndarray
    sums: np.ndarray
    row: np.ndarray
    head: np.ndarray


@kernel(eager=True, nogil=True)
def window_of(shape, dense):
    """The memory of dense rows at time 0."""
    m, row = len(shape.u), np.zeros(LANES, np.int64)
    line = np.zeros((2 * dense.taps * m + LANES) * LANES)
    return RowWindow(line, np.empty(m * LANES), row, row.copy())


@inner_kernel
def choose_rows(dense, work, window, k):
    """The row of every scenario by its mode and age."""
    for lane in range(LANES):
        age = k - work.began[lane]
        window.row[lane] = row_of_mode(dense.apart, dense.ages, work.mode[lane], age)


@inner_kernel
def sum_dense(shape, dense, window, place):
    """Sums of all inputs but the latest, scenario by scenario.

    They do not wait for what the last period gave: a processor works on both at once.
    """
    m, head = len(shape.u), len(shape.head)
    width = window.line.size // LANES
    for lane in range(LANES):
        row = window.row[lane]
        window.head[lane] = row * head
        start = lane * width + (place + 1) * m
        for i in range(m):
            begin = (row * m + i) * dense.width
            window.sums[lane * m + i] = dot(dense.rest, begin, window.line, start, dense.width)
