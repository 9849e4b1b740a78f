"""Where a polynomial on [0, 1] is first positive, by proof, compiled.

A polynomial lies between the least and the greatest of its Bernstein coefficients on an interval.
So an interval on which all of them are ≤ 0 holds no positive value, which is a proof and not a
sample; any other is halved, the left half first, down to 2⁻⁴⁸.
"""

from __future__ import annotations

import numpy as np

from deadtime.numerics.kernels import kernel

_DEPTH = 48


@kernel(eager=True)
def _bernstein(c):
    """The Bernstein coefficients on [0, 1] of the polynomial Σ c_k s^k."""
    degree = c.size - 1
    b = c.copy()
    choose = 1.0
    for k in range(1, degree + 1):
        choose *= (degree - k + 1) / k
        b[k] /= choose
    for j in range(degree, 0, -1):
        for i in range(j, degree + 1):
            b[i] += b[i - 1]
    return b


@kernel(eager=True)
def first_positive(c):
    """Where in (0, 1] Σ c_k s^k first exceeds 0, to 2⁻⁴⁸ and at the right end; −1 if nowhere."""
    b = _bernstein(c)
    if not b.max() > 0.0:
        return -1.0
    stack = np.empty((_DEPTH + 2, c.size))
    start, level = np.zeros(_DEPTH + 2), np.zeros(_DEPTH + 2, np.int64)
    stack[0] = b
    top = 0
    while top >= 0:
        b = stack[top].copy()
        a, depth = start[top], level[top]
        top -= 1
        if not b.max() > 0.0:  # neither where it is not a number
            continue
        width = 0.5**depth
        if depth == _DEPTH:
            # A touch is no crossing: the polynomial itself must be positive at the end.
            if b[-1] > 0.0:
                return a + width
            continue
        right, left = stack[top + 1], stack[top + 2]
        for k in range(c.size):
            left[k], right[c.size - 1 - k] = b[0], b[c.size - 1 - k]
            for i in range(c.size - 1 - k):
                b[i] = 0.5 * (b[i] + b[i + 1])
        start[top + 1], start[top + 2] = a + 0.5 * width, a
        level[top + 1] = level[top + 2] = depth + 1
        top += 2
    return -1.0


@kernel(eager=True)
def zero_before(c, s, band):
    """The zero of Σ c_k s^k next to `s`, where it exceeds `band`; `s` itself if there is none."""
    root = s
    for _ in range(4):
        value, slope = 0.0, 0.0
        for k in range(c.size - 1, -1, -1):
            slope = slope * root + value
            value = value * root + c[k]
        if not slope > 0.0:
            return s
        root = min(max(root - value / slope, 0.0), s)
    value = 0.0
    for k in range(c.size - 1, -1, -1):
        value = value * root + c[k]
    return root if abs(value) <= band or root == 0.0 else s
