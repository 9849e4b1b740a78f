"""Polynomials: the proved first positive argument, compiled, and Gauss–Legendre collocation.

A polynomial lies between the least and the greatest of its Bernstein coefficients on an interval.
So an interval on which all of them are ≤ 0 contains no positive value, which is a proof; other
intervals are bisected, the left half first, down to 2⁻⁴⁸.

In collocation a function on a segment is represented by its values at the interior Gauss nodes and
at both ends. Integrals from the start of the segment to a node use the values at the Gauss nodes.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.numerics.kernels import kernel

_DEPTH = 48  # bisections


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
    """The first s in (0, 1] with Σ c_k s^k > 0, to 2⁻⁴⁸, as the right end; −1 if there is none."""
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
        if not b.max() > 0.0:  # or NaN
            continue
        width = 0.5**depth
        if depth == _DEPTH:
            # A tangent zero is no crossing: the polynomial itself must be positive at the end.
            if b[-1] > 0.0:
                return a + width
            continue
        # De Casteljau's scheme; the left half is on top of the stack, as the first zero is wanted.
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
    """The zero of Σ c_k s^k before `s`, where it exceeds `band`; `s` itself if there is none."""
    # Newton's method from s: four steps suffice, as the value at s is about the band.
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


class Nodes(NamedTuple):
    """Nodes of a segment mapped to [0, 1].

    points : the p Gauss nodes;  integral : Q with ∫₀^{c_k} f = Σ_j Q_kj f(c_j);
    weights : ∫₀¹ f = Σ_j w_j f(c_j);  support : 0, the points, 1;  barycentric : their weights
    """

    points: Float[np.ndarray, " p"]
    integral: Float[np.ndarray, "p p"]
    weights: Float[np.ndarray, " p"]
    support: Float[np.ndarray, " p+2"]
    barycentric: Float[np.ndarray, " p+2"]


@lru_cache
def gauss(count: int) -> Nodes:
    """The nodes of order 2·count.

    Examples
    --------
    >>> nodes = gauss(4)
    >>> bool(abs(nodes.weights @ nodes.points**7 - 1 / 8) < 1e-15)
    True
    """
    z, w = np.polynomial.legendre.leggauss(count)
    values = np.polynomial.legendre.legvander(z, count)
    # ∫_{−1}^{z} L_j = (L_{j+1}(z) − L_{j−1}(z)) / (2j + 1), and z + 1 for j = 0.
    ahead = np.empty((count, count))
    ahead[:, 0] = z + 1.0
    for j in range(1, count):
        ahead[:, j] = (values[:, j + 1] - values[:, j - 1]) / (2 * j + 1)
    expand = (values[:, :count] * w[:, None]).T * (np.arange(count)[:, None] + 0.5)
    support = np.concatenate(([0.0], (z + 1.0) / 2.0, [1.0]))
    difference = support[:, None] - support[None, :] + np.eye(count + 2)
    barycentric = 1.0 / difference.prod(axis=1)
    barycentric /= np.abs(barycentric).max()  # a common factor cancels
    return Nodes((z + 1.0) / 2.0, ahead @ expand / 2.0, w / 2.0, support, barycentric)


def shares(c: np.ndarray, support: np.ndarray) -> np.ndarray:
    """The polynomials that are 1 at one support node and 0 at the others, at c, (T, nodes).

    Examples
    --------
    >>> shares(np.array([0.5]), np.array([0.0, 1.0]))
    array([[0.5, 0.5]])
    """
    same = np.eye(support.size, dtype=bool)
    apart = np.where(same, 1.0, support[:, None] - support)
    factors = np.where(same, 1.0, (c[:, None, None] - support) / apart)
    return factors.prod(axis=2)
