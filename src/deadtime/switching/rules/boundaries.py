"""Boundaries between regions as zeros of g(x) = xᵀQx + row·x − offset, compiled.

Region r is where all of its g are ≤ 0; those numbered first[r], …, first[r + 1] − 1 are its own.
Polyhedra have no Q: `forms` is then empty. A tuple `boundaries` is (forms, rows, offsets), a tuple
`regions` has first and the mode of every region besides.

A state is known up to its spread M|x| + N|u| only (`switching.rules.motion.round_off`), and so
g up to its band β, and the direction in which a vector field crosses a boundary.
"""

from __future__ import annotations

import numpy as np

from deadtime.numerics.kernels import kernel
from deadtime.switching.rules.motion import ROUND_OFF


@kernel(eager=True)
def times(M, x):
    """M x."""
    result = np.zeros(M.shape[0])
    for i in range(M.shape[0]):
        for j in range(x.size):
            result[i] += M[i, j] * x[j]
    return result


@kernel(eager=True)
def move(transition, x, u):
    """Φ x + Γ u."""
    Phi, Gamma = transition
    result = np.empty(x.size)
    for i in range(x.size):
        free, forced = 0.0, 0.0
        for j in range(x.size):
            free += Phi[i, j] * x[j]
        for j in range(u.size):
            forced += Gamma[i, j] * u[j]
        result[i] = free + forced
    return result


@kernel(eager=True)
def dot(a, b):
    """a·b."""
    total = 0.0
    for i in range(a.size):
        total += a[i] * b[i]
    return total


@kernel(eager=True)
def largest(a):
    """The largest |a_i|; NaN if one is."""
    result = 0.0
    for value in a:
        result = abs(value) if not abs(value) <= result else result
    return result


@kernel(eager=True)
def product(Q, a, b):
    """aᵀ Q b."""
    total = 0.0
    for i in range(a.size):
        for j in range(b.size):
            total += a[i] * Q[i, j] * b[j]
    return total


@kernel(eager=True)
def own(regions, r):
    """The boundaries of one region."""
    forms, rows, offsets, first, _ = regions
    part = slice(first[r], first[r + 1])
    return forms[part], rows[part], offsets[part]


@kernel(eager=True)
def height(boundaries, j, x):
    """g_j(x)."""
    forms, rows, offsets = boundaries
    value = dot(rows[j], x) - offsets[j]
    if forms.size:
        value += product(forms[j], x, x)
    return value


@kernel(eager=True)
def gradient(boundaries, j, x):
    """∇g_j(x) = 2 Q x + row."""
    forms, rows, _ = boundaries
    result = rows[j].copy()
    if forms.size:
        result += 2.0 * times(forms[j], x)
    return result


@kernel(eager=True)
def spread_of(noise, x, u):
    """The round-off M|x| + N|u| of x."""
    M, N = noise
    return times(M, np.abs(x)) + times(N, np.abs(u))


@kernel(eager=True)
def band(boundaries, j, x, spread):
    """β, the round-off of g_j(x)."""
    forms, rows, offsets = boundaries
    result = dot(np.abs(rows[j]), spread) + ROUND_OFF * abs(offsets[j])
    if forms.size:
        Q, size = np.abs(forms[j]), np.abs(x)
        result += 2.0 * product(Q, size, spread) + ROUND_OFF * product(Q, size, size)
    return result


@kernel(eager=True)
def slope(plant, mode, boundaries, j, x, u):
    """∇g·(A x + B u) in a mode, and its round-off."""
    A, B, M, N = plant
    spread = spread_of((M[mode], N[mode]), x, u)
    noise = times(np.abs(A[mode]), spread) + ROUND_OFF * times(np.abs(B[mode]), np.abs(u))
    normal, field = gradient(boundaries, j, x), move((A[mode], B[mode]), x, u)
    doubt = dot(np.abs(normal), noise)
    if boundaries[0].size:
        doubt += 2.0 * product(np.abs(boundaries[0][j]), spread, np.abs(field))
    return dot(normal, field), 4.0 * doubt


@kernel(eager=True)
def nearest(regions, spread, x, left):
    """The region other than `left` that holds x, or is nearest to it in units of round-off."""
    forms, rows, offsets, first, _ = regions
    boundaries = forms, rows, offsets
    best, result = np.inf, left
    for r in range(first.size - 1):
        if r != left:
            outside = -np.inf
            for j in range(first[r], first[r + 1]):
                doubt = band(boundaries, j, x, spread) + 1e-300
                outside = max(outside, height(boundaries, j, x) / doubt)
            if outside < best:
                best, result = outside, r
    return result
