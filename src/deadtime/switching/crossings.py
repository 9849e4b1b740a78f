"""Where a trajectory under a held input crosses from region to region, compiled.

A region is a polyhedron {x: G x ≤ h}; rows first[r], …, first[r + 1] − 1 of G and h are those of
region r. The trajectory leaves it at the first time at which some g(s) = row·x(s) − h is
positive. While |A|τ ≤ 1/2, g is to round-off the polynomial

    g(s) = g(0) + row·(v s + A v s²/2! + A² v s³/3! + …),    v = A x + B u,

and a polynomial lies between the least and the greatest of its Bernstein coefficients on an
interval. So an interval on which all of them are ≤ 0 holds no crossing, which is a proof and not
a sample; any other is halved, the left half first, down to 2⁻⁴⁸ of the piece. What enters and
leaves a region between two samples is found, however short its stay.

This module needs Numba, so it is imported where it is used.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from deadtime.exponential import held, multiply

MOST = 50  # crossings of boundaries within one piece; more are chattering
INSTANT = 1e-10  # of a piece: a region left that soon, and for the one before, was never entered
_DEPTH = 48
_ROUND_OFF = 1e-18
_MOST_TERMS = 16


@njit(cache=True)
def _times(M, x):
    """M x."""
    result = np.zeros(M.shape[0])
    for i in range(M.shape[0]):
        for j in range(x.size):
            result[i] += M[i, j] * x[j]
    return result


@njit(cache=True)
def _move(transition, x, u):
    """Φ x + Γ u."""
    Phi, Gamma = transition
    return _times(Phi, x) + _times(Gamma, u)


@njit(cache=True)
def _dot(a, b):
    total = 0.0
    for i in range(a.size):
        total += a[i] * b[i]
    return total


@njit(cache=True)
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


@njit(cache=True)
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


@njit(cache=True)
def _parts(A, tau):
    """The least power of two that cuts τ into parts with |A|τ ≤ 1/2, and |A|τ of a part."""
    size = 0.0
    for i in range(A.shape[0]):
        size = max(size, np.abs(A[i]).sum() * tau)
    parts = 1
    while size > 0.5:
        size *= 0.5
        parts *= 2
    return parts, size


@njit(cache=True)
def growth(A, tau):
    """An upper bound on |e^{As}|_∞ over [0, τ]: its maximum on a grid, times e^{|A| spacing}."""
    parts, size = _parts(A, tau)
    Phi, _ = held(A, np.zeros((A.shape[0], 1)), tau / parts)
    power, largest = np.eye(A.shape[0]), 1.0
    for _ in range(parts):
        power = multiply(Phi, power)
        for i in range(A.shape[0]):
            largest = max(largest, np.abs(power[i]).sum())
    return min(largest * np.exp(size), 1e300)


@njit(cache=True)
def leaving(A, B, rows, offsets, x, u, tau):
    """When within (0, τ] the trajectory first leaves {rows·x ≤ offsets}; −1 if it stays.

    It starts inside: an offset exceeded at the start is round-off.
    """
    parts, size = _parts(A, tau)
    terms, bound = 1, 1.0
    while bound > _ROUND_OFF and terms < _MOST_TERMS:
        terms += 1
        bound *= size / terms
    short = tau / parts
    c = np.empty((offsets.size, terms + 1))
    for part in range(parts):
        term = _move((A, B), x, u)
        for j in range(offsets.size):
            c[j, 0] = min(_dot(rows[j], x) - offsets[j], 0.0)
        x = x.copy()
        for k in range(1, terms + 1):
            term *= short / k
            x += term
            for j in range(offsets.size):
                c[j, k] = _dot(rows[j], term)
            term = _times(A, term)
        first = 2.0
        for j in range(offsets.size):
            s = first_positive(c[j])
            if 0.0 < s < first:
                first = s
        if first <= 1.0:
            return (part + first) * short
    return -1.0


@njit(cache=True)
def _entered(rows, offsets, norms, first, x, left):
    """The region other than `left` that holds x, or is nearest to it."""
    best, result = np.inf, left
    for r in range(first.size - 1):
        if r != left:
            outside = -np.inf
            for j in range(first[r], first[r + 1]):
                outside = max(outside, (_dot(rows[j], x) - offsets[j]) / norms[j])
            if outside < best:
                best, result = outside, r
    return result


@njit(cache=True)
def _stays(A, B, bend, rows, offsets, x, end, u):
    """Whether all g are negative over a whole piece, since |g''| ≤ 8 bend·max|v|/τ²."""
    steepest = np.abs(_move((A, B), x, u)).max()
    for j in range(offsets.size):
        highest = max(_dot(rows[j], x), _dot(rows[j], end)) - offsets[j]
        if not highest + bend[j] * steepest <= 0.0:
            return False
    return True


@njit(cache=True)
def advance(plant, regions, piece, x, u, region, at, to):
    """Run over one piece, from region to region.

    `plant` is A, B; `regions` rows, offsets, the rows' lengths, first rows, modes; `piece` its
    length, and Φ, Γ and `bend` over it, for every mode. Fills `at` and `to` with the times and
    new modes of the switches. Returns x and the region at the end, how many switches there were,
    and (time, other mode, whether it came back at once) of chattering: from that time, −1 for
    none, the mode was held.
    """
    (A, B), (rows, offsets, norms, first, modes) = plant, regions
    tau, Phi, Gamma, bend = piece
    mode = modes[region]
    end = _move((Phi[mode], Gamma[mode]), x, u)
    own = slice(first[region], first[region + 1])
    if _stays(A[mode], B[mode], bend[mode, own], rows[own], offsets[own], x, end, u):
        return end, region, 0, -1.0, mode, False
    start, crossings, switches, left, other = 0.0, 0, 0, -1, mode
    chatter, back = -1.0, False
    while chatter < 0.0:
        mode = modes[region]
        own = slice(first[region], first[region + 1])
        s = leaving(A[mode], B[mode], rows[own], offsets[own], x, u, tau - start)
        if s < 0.0:
            break
        x = _move(held(A[mode], B[mode], s), x, u)
        start = min(start + s, tau)
        entered = _entered(rows, offsets, norms, first, x, region)
        switched = modes[entered] != mode
        back = switched and entered == left and start - at[switches - 1] <= INSTANT * tau
        crossings += 1
        if back:
            chatter, other, region = start, mode, entered
            switches -= 1
        elif crossings > MOST:
            chatter, other = start, modes[entered]
        else:
            if switched:
                at[switches], to[switches] = start, modes[entered]
                switches += 1
            left, region = region, entered
    if crossings > 0:
        mode = modes[region]
        end = _move(held(A[mode], B[mode], tau - start), x, u)
    return end, region, switches, chatter, other, back


@njit(cache=True)
def follow(plant, regions, pieces, kinds, inputs, x, region):
    """Run over many pieces, number p of kind kinds[p] under inputs[p].

    `pieces` are the lengths, Φ, Γ and `bend` of every kind. Returns x and the region at the end,
    and (piece, time in it, mode, other mode, whether it came back at once) of chattering, at
    which it stops; the piece is −1 for none.
    """
    lengths, Phi, Gamma, bend = pieces
    modes = regions[4]
    at, to = np.empty(MOST), np.empty(MOST, np.int64)
    for p in range(kinds.size):
        i = kinds[p]
        piece = lengths[i], Phi[i], Gamma[i], bend[i]
        x, region, _, chatter, other, back = advance(
            plant, regions, piece, x, inputs[p], region, at, to
        )
        if chatter >= 0.0:
            return x, region, p, chatter, modes[region], other, back
    return x, region, -1, -1.0, modes[region], modes[region], False


@njit(cache=True)
def frozen_path(Phi, Gamma, kinds, inputs, x):
    """x (pieces, samples, n) at the samples of every piece, in one mode throughout.

    `Phi` (lengths, samples, n, n) and `Gamma` lead from the start of a piece to its samples, the
    last of them its end.
    """
    samples = Phi.shape[1]
    path = np.empty((kinds.size, samples, x.size))
    for p in range(kinds.size):
        i = kinds[p]
        for s in range(samples):
            path[p, s] = _move((Phi[i, s], Gamma[i, s]), x, inputs[p])
        x = path[p, samples - 1]
    return path
