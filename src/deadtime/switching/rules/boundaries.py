"""Boundaries between regions, zeros of g(x) = xᵀQx + row·x − offset, and slides, compiled.

Region r has the boundaries first[r], …, first[r + 1] − 1, and all of these g are ≤ 0 in it.
Polyhedra have no Q: `forms` is then empty. A tuple `boundaries` is (forms, rows, offsets); a tuple
`regions` is (forms, rows, offsets, first, modes), modes the mode of every region.

A state has the round-off M|x| + N|u| (`switching.rules.motion.round_off`), its `spread`. It causes
the round-off β of g, its `band`, and an uncertain sign of ∇g·f where a field f is nearly tangent.

Where both modes' fields point at a boundary, the motion slides along it (Filippov): f_i points out
of the region of mode i through its boundary g = 0 and f_j back into it,
a = ∇g·f_i > 0 > b = ∇g·f_j. The limit of infinitely fast switching between the modes is

    x' = (a f_j − b f_i) / (a − b),    the mean of the fields that is tangent to the boundary.

It is nonlinear even on a plane, because a and b depend on x. So it is integrated by the
extrapolated midpoint rule (Gragg, Bulirsch and Stoer) until two columns agree to the round-off of
x; otherwise the step is halved. After every step x is projected onto g = 0. The motion lasts until
a < 0 or b > 0 beyond round-off, or until another boundary of either region is reached. These
conditions are tested at the end of every step of at most 1/(2|A|), so that an event that begins and
ends within one step is missed; the end is then found by bisection.

References
----------
A. F. Filippov, Differential Equations with Discontinuous Righthand Sides, Kluwer 1988, Chapter 2.
E. Hairer, S. P. Nørsett and G. Wanner, Solving Ordinary Differential Equations I, Section II.9.
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
    """The boundaries of region r."""
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
    """The region other than `left` that contains x, or is nearest to it in units of round-off."""
    forms, rows, offsets, first, _ = regions
    boundaries = forms, rows, offsets
    best, result = np.inf, left
    for r in range(first.size - 1):
        if r != left:
            outside = -np.inf
            for j in range(first[r], first[r + 1]):
                doubt = band(boundaries, j, x, spread) + 1e-300  # x = 0 has no round-off
                outside = max(outside, height(boundaries, j, x) / doubt)
            if outside < best:
                best, result = outside, r
    return result


STAYS, BACK, ON, ELSEWHERE, LOST = 0, 1, 2, 3, 4  # end of a sliding motion, see `slide`
_COLUMNS = 9  # of the extrapolation
_HALVINGS = 40  # of a step
_SHARP = 2.0**-52  # of a step, to which its end is bisected


@kernel(eager=True)
def _field(A, B, boundaries, pair, x, u):
    """The mean of the fields of modes i and j that is tangent to boundary number `row`."""
    i, j, row = pair
    first, second = move((A[i], B[i]), x, u), move((A[j], B[j]), x, u)
    normal = gradient(boundaries, row, x)
    a, b = dot(normal, first), dot(normal, second)
    if not a - b > 0.0:
        return first
    # At rest on the boundary a and b are round-off, and their ratio may be anything.
    share = min(max(a / (a - b), 0.0), 1.0)
    return first + share * (second - first)


@kernel(eager=True)
def _step(A, B, boundaries, pair, x, u, tau):
    """x after τ, and the difference of the last two columns of the extrapolation."""
    n = x.size
    table = np.zeros((_COLUMNS, n))
    start = _field(A, B, boundaries, pair, x, u)
    error, last = np.full(n, np.inf), x
    for k in range(_COLUMNS):
        count = 2 * (k + 1)
        short = tau / count
        before, now = x, x + short * start
        for _ in range(count - 1):
            before, now = now, before + 2.0 * short * _field(A, B, boundaries, pair, now, u)
        last = 0.5 * (before + now + short * _field(A, B, boundaries, pair, now, u))
        for c in range(k):
            # Column c + 1 from column c of the row above, in place.
            ratio = (k + 1.0) / (k - c)
            better = last + (last - table[c]) / (ratio * ratio - 1.0)
            table[c] = last
            last = better
        if k:
            error = np.abs(last - table[k - 1])
        table[k] = last
        if k and error.max() <= ROUND_OFF * np.abs(last).max():
            break
    return last, error


@kernel(eager=True)
def _onto(boundaries, row, x):
    """The point of the boundary next to x."""
    for _ in range(2):  # Newton's method, twice: a quadratic boundary is curved
        normal = gradient(boundaries, row, x)
        square = dot(normal, normal)
        if square > 0.0:
            x = x - height(boundaries, row, x) / square * normal
    return x


@kernel(eager=True)
def _opposite(regions, row, entered, x):
    """The boundary of the entered region that coincides with `row`, with −∇g; −1 if none."""
    forms, rows, offsets, first, _ = regions
    boundaries = forms, rows, offsets
    normal = gradient(boundaries, row, x)
    for j in range(first[entered], first[entered + 1]):
        other = gradient(boundaries, j, x)
        if dot(normal, other) < -(1.0 - 1e-9) * np.sqrt(dot(normal, normal) * dot(other, other)):
            return j
    return -1


@kernel(eager=True)
def _ending(plant, regions, surface, x, u):
    """How the sliding motion ends at x, STAYS if not, and the region that it leaves."""
    forms, rows, offsets, first, modes = regions
    boundaries = forms, rows, offsets
    region, entered, row, opposite = surface
    M, N = plant[2:]
    spread = spread_of((M[modes[region]], N[modes[region]]), x, u)
    for r in (region, entered):
        for j in range(first[r], first[r + 1]):
            doubt = band(boundaries, j, x, spread)
            if j not in (row, opposite) and height(boundaries, j, x) > doubt:
                return ELSEWHERE, r
    a, unsure = slope(plant, modes[region], boundaries, row, x, u)
    b, doubt = slope(plant, modes[entered], boundaries, row, x, u)
    if a < -unsure:
        return BACK, region
    if b > doubt:
        return ON, region
    return STAYS, region


@kernel(eager=True)
def slide(plant, regions, between, x, u, tau):
    """Slide for at most τ; `between` are the region, the one beyond, and the boundary's number.

    Returns x, the duration, the end (STAYS: after τ; BACK or ON: into the region or the one beyond;
    ELSEWHERE: across another boundary; LOST: no step is short enough) and the region of the motion
    from there on.
    """
    forms, rows, offsets, _, modes = regions
    boundaries = forms, rows, offsets
    region, entered, row = between
    surface = region, entered, row, _opposite(regions, row, entered, x)
    pair = modes[region], modes[entered], row
    A, B, M, N = plant
    noise, beyond = (M[pair[0]], N[pair[0]]), (M[pair[1]], N[pair[1]])
    rate = max(np.abs(A[pair[0]]).sum(axis=1).max(), np.abs(A[pair[1]]).sum(axis=1).max())
    longest = tau if rate * tau <= 0.5 else 0.5 / rate
    x = _onto(boundaries, row, x)
    done, step = 0.0, longest
    while done < tau:
        step = min(step, tau - done, longest)
        y, error = _step(A, B, boundaries, pair, x, u, step)
        known = spread_of(noise, y, u) + spread_of(beyond, y, u)
        if not (error <= 4.0 * known).all():
            if step < longest * 0.5**_HALVINGS:
                return x, done, LOST, region
            step *= 0.5
            continue
        # The projection removes the drift from the boundary that integration adds.
        y = _onto(boundaries, row, y)
        end, without = _ending(plant, regions, surface, y, u)
        if end == STAYS:
            x = y
            # Exactly τ at the end, which a sum of steps may miss by round-off.
            done = tau if step == tau - done else done + step
            step *= 2.0
            continue
        low, high = 0.0, step
        while high - low > _SHARP * step:
            middle = 0.5 * (low + high)
            z = _onto(boundaries, row, _step(A, B, boundaries, pair, x, u, middle)[0])
            state, there = _ending(plant, regions, surface, z, u)
            if state == STAYS:
                low = middle
            else:
                high, y, end, without = middle, z, state, there
        if end == BACK:
            return y, done + high, end, region
        if end == ON:
            return y, done + high, end, entered
        return y, done + high, end, nearest(regions, spread_of(noise, y, u), y, without)
    return x, tau, STAYS, region
