"""Where a trajectory under a held input crosses from region to region, compiled.

A region is a polyhedron {x: G x ≤ h}; rows first[r], …, first[r + 1] − 1 of G and h are those of
region r. The trajectory leaves it at the first time at which some g(s) = row·x(s) − h is
positive. While |A|τ ≤ 1/2, g is to round-off the polynomial

    g(s) = g(0) + row·(v s + A v s²/2! + A² v s³/3! + …),    v = A x + B u,

and a polynomial lies between the least and the greatest of its Bernstein coefficients on an
interval. So an interval on which all of them are ≤ 0 holds no crossing, which is a proof and not
a sample; any other is halved, the left half first, down to 2⁻⁴⁸ of the piece. What enters and
leaves a region between two samples is found, however short its stay.

g is known to its round-off β only (`deadtime.switching.motion.round_off`), so that a trajectory
along a boundary would cross it at random: what is looked for is g > β, and the zero of g before
it is the crossing. Which region is entered is asked where g = β. At the crossing both modes point
at the boundary if row·(A_i x + B_i u) is positive in the one and negative in the other, beyond
the round-off of either: the plant chatters.

This module needs Numba, so it is imported where it is used.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from deadtime.exponential import held, multiply
from deadtime.switching.motion import ROUND_OFF

_DEPTH = 48
_LAST_TERM = 1e-18
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
def _spread(noise, x, u):
    """The round-off M|x| + N|u| of x."""
    M, N = noise
    return _times(M, np.abs(x)) + _times(N, np.abs(u))


@njit(cache=True)
def _band(row, offset, spread):
    """β, the round-off of row·x − offset."""
    return _dot(np.abs(row), spread) + ROUND_OFF * abs(offset)


@njit(cache=True)
def _zero_before(c, s, band):
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


@njit(cache=True)
def leaving(A, B, noise, rows, offsets, x, u, tau):
    """When within (0, τ] the trajectory first leaves {rows·x ≤ offsets}, beyond round-off.

    Returns the time of the crossing, the time at which it is beyond round-off, and its row; −1 for
    the times if it stays. It starts inside: an offset exceeded at the start is round-off.
    """
    parts, size = _parts(A, tau)
    terms, bound = 1, 1.0
    while bound > _LAST_TERM and terms < _MOST_TERMS:
        terms += 1
        bound *= size / terms
    short = tau / parts
    c = np.empty((offsets.size, terms + 1))
    for part in range(parts):
        spread = _spread(noise, x, u)
        term = _move((A, B), x, u)
        for j in range(offsets.size):
            c[j, 0] = _dot(rows[j], x) - offsets[j]
        x = x.copy()
        for k in range(1, terms + 1):
            term *= short / k
            x += term
            for j in range(offsets.size):
                c[j, k] = _dot(rows[j], term)
            term = _times(A, term)
        beyond, row = 2.0, -1
        for j in range(offsets.size):
            risen = c[j].copy()
            risen[0] = min(c[j, 0] - _band(rows[j], offsets[j], spread), 0.0)
            s = first_positive(risen)
            if 0.0 < s < beyond:
                beyond, row = s, j
        if row >= 0:
            s = _zero_before(c[row], beyond, _band(rows[row], offsets[row], spread))
            return (part + s) * short, (part + beyond) * short, row
    return -1.0, -1.0, -1


@njit(cache=True)
def _entered(regions, spread, x, left):
    """The region other than `left` that holds x, or is nearest to it in units of round-off."""
    rows, offsets, first, _ = regions
    best, result = np.inf, left
    for r in range(first.size - 1):
        if r != left:
            outside = -np.inf
            for j in range(first[r], first[r + 1]):
                band = _band(rows[j], offsets[j], spread) + 1e-300
                outside = max(outside, (_dot(rows[j], x) - offsets[j]) / band)
            if outside < best:
                best, result = outside, r
    return result


@njit(cache=True)
def _slope(plant, mode, row, x, u):
    """row·(A x + B u) in a mode, and its round-off."""
    A, B, M, N = plant
    spread = _spread((M[mode], N[mode]), x, u)
    noise = _times(np.abs(A[mode]), spread) + ROUND_OFF * _times(np.abs(B[mode]), np.abs(u))
    return _dot(row, _move((A[mode], B[mode]), x, u)), 4.0 * _dot(np.abs(row), noise)


@njit(cache=True)
def _facing(plant, regions, x, u, region, entered, j):
    """Whether both regions' modes point at the boundary, row j, that leads from one to the other.

    They do if beyond round-off the one leaves through it and the other returns through it.
    """
    A, B, M, N = plant
    rows, offsets, _, modes = regions
    mode, other = modes[region], modes[entered]
    away, doubt = _slope(plant, mode, rows[j], x, u)
    if not away > doubt:
        return False
    back, doubt = _slope(plant, other, rows[j], x, u)
    if not back < -doubt:
        return False
    spread = _spread((M[other], N[other]), x, u)
    ahead = 2.0 * _band(rows[j], offsets[j], spread) / -back
    beyond = x + ahead * _move((A[other], B[other]), x, u)
    return modes[_entered(regions, spread, beyond, entered)] == mode


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

    `plant` is A, B and the round-off M, N; `regions` rows, offsets, first rows, modes; `piece`
    its length, and Φ, Γ and `bend` over it, for every mode. Fills `at` and `to` with the times and
    new modes of the switches; more crossings than they hold are chattering. Returns x and the
    region at the end, how many switches there were, and (time, other mode, whether both modes
    point at their boundary) of chattering: from that time, −1 for none, the mode was held.
    """
    (A, B, M, N), (rows, offsets, first, modes) = plant, regions
    tau, Phi, Gamma, bend = piece
    mode = modes[region]
    end = _move((Phi[mode], Gamma[mode]), x, u)
    own = slice(first[region], first[region + 1])
    if _stays(A[mode], B[mode], bend[mode, own], rows[own], offsets[own], x, end, u):
        return end, region, 0, -1.0, mode, False
    start, crossings, switches, other = 0.0, 0, 0, mode
    chatter, facing = -1.0, False
    while chatter < 0.0:
        mode = modes[region]
        own = slice(first[region], first[region + 1])
        noise = M[mode], N[mode]
        s, beyond, row = leaving(
            A[mode], B[mode], noise, rows[own], offsets[own], x, u, tau - start
        )
        if s < 0.0:
            break
        ahead = _move(held(A[mode], B[mode], beyond), x, u)
        x = _move(held(A[mode], B[mode], s), x, u)
        start = min(start + s, tau)
        entered = _entered(regions, _spread(noise, ahead, u), ahead, region)
        switched = modes[entered] != mode
        crossings += 1
        facing = switched and _facing(plant, regions, x, u, region, entered, first[region] + row)
        if facing or crossings > at.size:
            chatter, other = start, modes[entered]
            continue
        if switched:
            at[switches], to[switches] = start, modes[entered]
            switches += 1
        region = entered
    if crossings > 0:
        mode = modes[region]
        end = _move(held(A[mode], B[mode], tau - start), x, u)
    return end, region, switches, chatter, other, facing


@njit(cache=True)
def follow(plant, regions, pieces, kinds, inputs, x, region):
    """Run over many pieces, number p of kind kinds[p] under inputs[p].

    `pieces` are the lengths, Φ, Γ, `bend` and the most crossings of every kind. Returns x and the
    region at the end, and (piece, time in it, mode, other mode, whether both point at their
    boundary) of chattering, at which it stops; the piece is −1 for none.
    """
    lengths, Phi, Gamma, bend, most = pieces
    modes = regions[3]
    at, to = np.empty(most.max()), np.empty(most.max(), np.int64)
    for p in range(kinds.size):
        i = kinds[p]
        piece = lengths[i], Phi[i], Gamma[i], bend[i]
        x, region, _, chatter, other, facing = advance(
            plant, regions, piece, x, inputs[p], region, at[: most[i]], to[: most[i]]
        )
        if chatter >= 0.0:
            return x, region, p, chatter, modes[region], other, facing
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
