"""Crossings of a trajectory under a held input from region to region, compiled.

The trajectory leaves a region when one of its g (see `switching.rules.boundaries`) becomes
positive. For |A|τ ≤ 1/2 the state equals its Taylor polynomial to round-off,

    x(s) = x + v s + A v s²/2! + A² v s³/3! + …,    v = A x + B u,

so that g(x(s)) is a polynomial, and `first_positive` proves by Bernstein coefficients where it is
first positive: a stay in a region between two samples is found, however short. For quadratic g
the parts are half as long, because products of two series need as many terms.

A trajectory along a boundary would cross it at random, because g has the round-off β. So the first
g > β is found, and the crossing is the zero of g before it. The entered region is that of the state
with g = β. If both modes' fields point at the boundary there, beyond their round-off, the plant
slides along it (`deadtime.switching.rules.boundaries`).
"""

from __future__ import annotations

import numpy as np

from deadtime.numerics.exponential import discretise, multiply
from deadtime.numerics.kernels import kernel
from deadtime.numerics.polynomials import first_positive, zero_before
from deadtime.switching.rules.boundaries import (
    LOST,
    STAYS,
    band,
    dot,
    height,
    largest,
    move,
    nearest,
    own,
    product,
    slide,
    slope,
    spread_of,
    times,
)

_LAST_TERM = 1e-18  # relative: later terms of a Taylor series do not change a double
_MOST_TERMS = 16  # 2⁻¹⁶/16! is below that, for |A|τ ≤ 1/2
MOST_PARTS = 2**17  # of a piece
NONE, PILED_UP, STRAYED = 0, 1, 2  # reasons for the end of a trajectory, see `Chatter`
# Beside no boundary. A literal −1 has a type of its own in Numba, for which all would be compiled
# again.
_INSIDE = (np.int64(-1), np.int64(-1))


@kernel(eager=True)
def _parts(A, tau):
    """The least power of two of parts of τ with |A|τ ≤ 1/2 each, and |A|τ of a part.

    It is at most `MOST_PARTS`: `RegionMotion` refuses longer pieces.
    """
    size = 0.0
    for i in range(A.shape[0]):
        size = max(size, np.abs(A[i]).sum() * tau)
    parts = 1
    while size > 0.5 and parts < MOST_PARTS:
        size *= 0.5
        parts *= 2
    return parts, size


@kernel(eager=True)
def growth(A, tau):
    """An upper bound on |e^{As}|_∞ over [0, τ]: its maximum on a grid, times e^{|A| spacing}."""
    parts, size = _parts(A, tau)
    Phi, _ = discretise(A, np.zeros((A.shape[0], 1)), tau / parts)
    power, largest = np.eye(A.shape[0]), 1.0
    for _ in range(parts):
        power = multiply(Phi, power)
        for i in range(A.shape[0]):
            largest = max(largest, np.abs(power[i]).sum())
    return min(largest * np.exp(size), 1e300)


@kernel(eager=True)
def _heights(boundaries, taylor):
    """The Taylor coefficients of every g along x(s) = Σ taylor[k] s^k."""
    forms, rows, _ = boundaries
    terms = taylor.shape[0]
    c = np.zeros((rows.shape[0], terms))
    for j in range(rows.shape[0]):
        c[j, 0] = height(boundaries, j, taylor[0])
        for k in range(1, terms):
            c[j, k] = dot(rows[j], taylor[k])
            if forms.size:
                for a in range(k + 1):
                    c[j, k] += product(forms[j], taylor[a], taylor[k - a])
    return c


@kernel(eager=True)
def exit_time(A, B, noise, boundaries, x, u, tau):
    """The first exit of the trajectory from a region in (0, τ], beyond round-off.

    Returns the time of the crossing, the time at which it is beyond round-off, and the number of
    the boundary; −1 if it stays. It starts inside: a g that is positive at the start is round-off.
    """
    parts, size = _parts(A, 2.0 * tau if boundaries[0].size else tau)
    terms, bound = 1, 1.0
    while bound > _LAST_TERM and terms < _MOST_TERMS:
        terms += 1
        bound *= size / terms
    short = tau / parts
    taylor = np.empty((terms + 1, x.size))
    for part in range(parts):
        spread = spread_of(noise, x, u)
        term = move((A, B), x, u)
        taylor[0] = x
        ahead = x.copy()
        for k in range(1, terms + 1):
            term *= short / k
            taylor[k] = term
            ahead += term
            term = times(A, term)
        # c[j, k] = coefficient k of g_j over this part, as a polynomial in s of [0, 1].
        c = _heights(boundaries, taylor)
        beyond, row, doubt = 2.0, -1, 0.0
        for j in range(c.shape[0]):
            risen = c[j].copy()
            uncertain = band(boundaries, j, x, spread)
            risen[0] = min(c[j, 0] - uncertain, 0.0)  # inside at the start, to round-off
            s = first_positive(risen)
            if 0.0 < s < beyond:
                beyond, row, doubt = s, j, uncertain
        if row >= 0:
            s = zero_before(c[row], beyond, doubt)
            return (part + s) * short, (part + beyond) * short, row
        x = ahead
    return -1.0, -1.0, -1


@kernel(eager=True)
def _facing(plant, regions, x, u, region, entered, j):
    """Whether the fields of both regions' modes point at boundary j between them.

    The trajectory has just left through it, so the first field need only not point inwards; the
    second one must point back beyond round-off.
    """
    A, B, M, N = plant
    forms, rows, offsets, _, modes = regions
    boundaries = forms, rows, offsets
    mode, other = modes[region], modes[entered]
    away, doubt = slope(plant, mode, boundaries, j, x, u)
    if not away > -doubt:
        return False
    back, doubt = slope(plant, other, boundaries, j, x, u)
    if not back < -doubt:
        return False
    spread = spread_of((M[other], N[other]), x, u)
    ahead = 2.0 * band(boundaries, j, x, spread) / -back
    beyond = x + ahead * move((A[other], B[other]), x, u)
    return modes[nearest(regions, spread, beyond, entered)] == mode


@kernel(eager=True)
def _leads_on(plant, regions, x, u, entered, j):
    """Whether the field beyond boundary j points away from it, beyond round-off."""
    forms, rows, offsets, _, modes = regions
    ahead, doubt = slope(plant, modes[entered], (forms, rows, offsets), j, x, u)
    return ahead > doubt


@kernel(eager=True)
def region_of_mode(plant, regions, x, region, mode):
    """The region of a mode that contains x to round-off; else `region`, which contains x.

    On a boundary the reported mode determines the side of x, and x alone does not.
    """
    forms, rows, offsets, first, modes = regions
    boundaries = forms, rows, offsets
    spread = times(plant[2][modes[region]], np.abs(x))
    for r in range(modes.size):
        inside = modes[r] == mode and mode != modes[region]
        for j in range(first[r], first[r + 1]):
            inside = inside and height(boundaries, j, x) <= band(boundaries, j, x, spread)
        if inside:
            return r
    return region


@kernel(eager=True)
def _stays(A, B, bend, regions, region, x, end, u):
    """Whether a trajectory provably stays in a region over a whole piece.

    With b = bend[j], g_j exceeds its chord by at most |v|(b₀ + b₁|v| + b₂|x|).
    """
    forms, rows, offsets, first, _ = regions
    boundaries = forms, rows, offsets
    v, size = largest(move((A, B), x, u)), largest(x)
    for j in range(first[region], first[region + 1]):
        highest = max(height(boundaries, j, x), height(boundaries, j, end))
        if not highest + v * (bend[j, 0] + bend[j, 1] * v + bend[j, 2] * size) <= 0.0:
            return False
    return True


@kernel(eager=True)
def advance(plant, regions, piece, x, u, region, beside, legs):
    """Move over one piece, from region to region and along boundaries.

    `plant` is A, B and the round-off M, N; `piece` is its length, Φ, Γ and `bend` over it for every
    mode, and the most crossings; more are chattering. `beside` is the region beyond the boundary
    along which x slides at the start, and its number, −1 for none: x crosses it if the field beyond
    points away. The legs after the first one, which is in `region`, are written to `legs`: times,
    states, regions and, if they slide, `beside`. Returns x, the region and `beside` at the end, the
    number of these legs, and reason, time and other region of a halt, after which the mode is held.
    """
    (A, B, M, N), first, modes = plant, regions[3], regions[4]
    at, states, places, others, along = legs
    tau, Phi, Gamma, bend, most = piece
    mode = modes[region]
    end = move((Phi[mode], Gamma[mode]), x, u)
    entered, row = beside
    slides = entered >= 0 and _facing(plant, regions, x, u, region, entered, row)
    crosses = entered >= 0 and not slides and _leads_on(plant, regions, x, u, entered, row)
    if not (slides or crosses) and _stays(A[mode], B[mode], bend[mode], regions, region, x, end, u):
        return end, region, _INSIDE, 0, (NONE, -1.0, -1)
    start, crossings, count = 0.0, 0, 0
    halt = (NONE, -1.0, -1)
    while True:
        if not (slides or crosses):
            mode, noise = modes[region], (M[modes[region]], N[modes[region]])
            s, beyond, row = exit_time(
                A[mode], B[mode], noise, own(regions, region), x, u, tau - start
            )
            if s < 0.0:
                break
            ahead = move(discretise(A[mode], B[mode], beyond), x, u)
            x = move(discretise(A[mode], B[mode], s), x, u)
            start = min(start + s, tau)
            entered = nearest(regions, spread_of(noise, ahead, u), ahead, region)
            row += first[region]  # from the number within the region to that of all boundaries
        crossings += 1
        if crossings > most:
            halt = (PILED_UP, start, entered)
            break
        if modes[entered] == modes[region]:  # no switch, and no new leg
            region = entered
            continue
        at[count], states[count] = start, x
        if crosses or not (slides or _facing(plant, regions, x, u, region, entered, row)):
            region, crosses = entered, False
            places[count], others[count], along[count] = region, -1, -1
            count += 1
            continue
        places[count], others[count], along[count] = region, entered, row
        count += 1
        between = region, entered, row
        x, lasted, how, following = slide(plant, regions, between, x, u, tau - start)
        start = min(start + lasted, tau)
        if how == STAYS:
            return x, region, (entered, row), count, halt
        if how == LOST:
            halt = (STRAYED, start, entered)
            break
        slides, region = False, following
        at[count], states[count] = start, x
        places[count], others[count], along[count] = region, -1, -1
        count += 1
    mode = modes[region]
    if crossings > 0:
        end = move(discretise(A[mode], B[mode], tau - start), x, u)
    return end, region, _INSIDE, count, halt


@kernel(eager=True)
def room(most, n):
    """Arrays for the legs of a piece with at most so many crossings."""
    size = 2 * most
    return (
        np.empty(size),
        np.empty((size, n)),
        np.empty(size, np.int64),
        np.empty(size, np.int64),
        np.empty(size, np.int64),
    )


@kernel(eager=True)
def follow(plant, regions, pieces, kinds, inputs, x, region):
    """Move over many pieces, number p of kind kinds[p] under inputs[p].

    `pieces` are the lengths, Φ, Γ, `bend` and the most crossings of every kind. Returns x, the
    region and `beside` at the end, and (piece, reason, time in it, region, other region) of a halt;
    the piece is −1 for none.
    """
    lengths, Phi, Gamma, bend, most = pieces
    beside, legs = _INSIDE, room(most.max(), x.size)
    for p in range(kinds.size):
        i = kinds[p]
        piece = lengths[i], Phi[i], Gamma[i], bend[i], most[i]
        x, region, beside, _, halt = advance(
            plant, regions, piece, x, inputs[p], region, beside, legs
        )
        if halt[0] != NONE:
            return x, region, _INSIDE, (p, halt[0], halt[1], region, halt[2])
    return x, region, beside, (-1, NONE, -1.0, region, region)


@kernel(eager=True)
def path_in_modes(Phi, Gamma, kinds, inputs, x):
    """x (pieces, samples, n) at the samples of every piece, with one mode held.

    `Phi` (lengths, samples, n, n) and `Gamma` are the transitions from the start of a piece to its
    samples, the last of which is its end.
    """
    samples = Phi.shape[1]
    path = np.empty((kinds.size, samples, x.size))
    for p in range(kinds.size):
        i = kinds[p]
        for s in range(samples):
            path[p, s] = move((Phi[i, s], Gamma[i, s]), x, inputs[p])
        x = path[p, samples - 1]
    return path
