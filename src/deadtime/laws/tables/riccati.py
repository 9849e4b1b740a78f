"""Coupled Riccati equations of the lifted loop, solved by value iteration, compiled.

Row θ of the table is a mode i and, where ages count, an age a. On ξ = (x, u_{k−N}, …, u_{k−1}),
the oldest input first, and η = (ξ, u_k), the cost to go is ξᵀP_θ ξ with

    P_θ = W / W_uu,    W = stage + (M_i η)ᵀ E_θ(P) (M_i η),    E_θ(P) = Σ_θ' P(θ → θ') P_θ',

W / W_uu the Schur complement W_ξξ − W_ξu W_uu⁻¹ W_uξ, and u_k = −W_uu⁻¹ W_uξ ξ. M_i drops the
oldest input and moves the state by x' = L_i y, y = (x, u_{k−N}, u_{k−N+1}, …) with the inputs that
act in a period, so the blocks of W are those of E, shifted, but for the rows and columns of y: a
backup takes O(d²) operations, d = n + N m. Of symmetric matrices the lower triangle is kept.

Starting from P = 0 backups in any order increase P towards its least solution, the optimal
cost, or without bound where no causal law has a finite one. A sweep lets the last age of every
mode, which follows itself, settle for a while, then goes back through the ages to the first, so
that what a new sojourn costs passes at once through a whole one.
"""

from __future__ import annotations

import numpy as np

from deadtime.base.errors import ArgumentError, InfeasibleError
from deadtime.numerics.exponential import gramian
from deadtime.numerics.kernels import kernel

# A sweep that changes no gain and no trace by more than this, relatively, is the last one.
TOLERANCE = 1e-11
# Every so many sweeps the increase of P must have become smaller; a bounded P stays below HUGE.
BATCH, MOST_SWEEPS, HUGE = 100, 10_000, 1e60
# P never shrinks; by more than this, relatively, it does so only for round-off.
ROUGH = 1e-6


@kernel(eager=True)
def _pieces(E, L, stage, weight, cross, quad, forced, uu):
    """Add the state's motion to the shifted E, and fill the rows of W that belong to u_k.

    cross (N m, y) is [E_ux L], quad LᵀE_xx L + stage; forced W_uξ, and uu W_uu.
    """
    m, d = forced.shape
    n, near = L.shape
    old = n + m  # W's rows and columns from here on are E's from n on
    for y in range(near):
        for r in range(d - n):
            cross[r, y] = 0.0
            for x in range(n):
                cross[r, y] += E[n + r, x] * L[x, y]
        for c in range(y + 1):
            quad[y, c] = stage[y, c]
            for x in range(n):
                for z in range(n):
                    quad[y, c] += L[x, y] * E[max(x, z), min(x, z)] * L[z, c]
    for a in range(m):
        r = d + a
        for c in range(r + 1):
            value = E[r - m, c - m] if c >= old else 0.0
            if c < near:
                value += cross[r - old, c]
            if r < near and c >= old:
                value += cross[c - old, r]
            if r < near:
                value += quad[r, c]
            if c < d:
                forced[a, c] = value
            else:
                uu[a, c - d] = value + weight[a, c - d]


@kernel(eager=True)
def _solve(uu, forced, gain):
    """gain ← −W_uu⁻¹ W_uξ by Cholesky's method, in the lower triangle of uu."""
    m, d = forced.shape
    for a in range(m):
        for b in range(a + 1):
            for c in range(b):
                uu[a, b] -= uu[a, c] * uu[b, c]
            uu[a, b] = np.sqrt(uu[a, a]) if a == b else uu[a, b] / uu[b, b]
    for c in range(d):
        for a in range(m):
            gain[a, c] = -forced[a, c]
            for b in range(a):
                gain[a, c] -= uu[a, b] * gain[b, c]
            gain[a, c] /= uu[a, a]
        for a in range(m - 1, -1, -1):
            for b in range(a + 1, m):
                gain[a, c] -= uu[b, a] * gain[b, c]
            gain[a, c] /= uu[a, a]


@kernel(eager=True)
def _backup(E, L, stage, weight, scratch, P, gain):
    """P ← W / W_uu and gain ← −W_uu⁻¹ W_uξ from E; `weight` is h R."""
    m, d = gain.shape
    n, near = L.shape
    old = n + m
    cross, quad, forced, uu = scratch
    _pieces(E, L, stage, weight, cross, quad, forced, uu)
    _solve(uu, forced, gain)
    for r in range(d):
        for c in range(min(old, r + 1)):
            P[r, c] = cross[r - old, c] if r >= old else 0.0
        for c in range(old, r + 1):
            P[r, c] = E[r - m, c - m]
        for c in range(old, min(near, r + 1)):
            P[r, c] += cross[r - old, c]
        if r < near:
            for c in range(old, r + 1):
                P[r, c] += cross[c - old, r]
            for c in range(r + 1):
                P[r, c] += quad[r, c]
        for a in range(m):
            for c in range(r + 1):
                P[r, c] += forced[a, r] * gain[a, c]


@kernel(eager=True)
def sweep(P, gain, L, stage, weight, hazard, transition, visits):
    """Back up the ages `visits`, in their order, of every mode: P and gain in place.

    P (modes, ages, d, d), gain (modes, ages, m, d). Returns the largest relative changes of a
    gain and of a trace, up and down, at the last visit of an age.
    """
    modes, ages, d, _ = P.shape
    m, (n, near) = gain.shape[2], L.shape[1:]
    E, fresh = np.zeros((d, d)), np.zeros((modes, d, d))
    scratch = (np.empty((d - n, near)), np.empty((near, near)), np.empty((m, d)), np.empty((m, m)))
    for i in range(modes):
        for j in range(modes):
            for r in range(d):
                for c in range(r + 1):
                    fresh[i, r, c] += transition[i, j] * P[j, 0, r, c]
    moved = grown = shrunk = 0.0
    for i in range(modes):
        for visit in range(visits.size):
            a = visits[visit]
            after, new = P[i, min(a + 1, ages - 1)], fresh[i]
            for r in range(d):
                for c in range(r + 1):
                    E[r, c] = after[r, c] + hazard[i, a] * (new[r, c] - after[r, c])
            before, trace = gain[i, a].copy(), np.trace(P[i, a])
            _backup(E, L[i], stage[i], weight, scratch, P[i, a], gain[i, a])
            if visit + 1 == visits.size or visits[visit + 1] != a:
                size, now = np.abs(gain[i, a]).max(), np.trace(P[i, a])
                if size > 0.0:
                    moved = max(moved, np.abs(gain[i, a] - before).max() / size)
                grown, shrunk = max(grown, (now - trace) / now), max(shrunk, (trace - now) / now)
    return moved, grown, shrunk


def period(sampled, Q):
    """L (modes, n, y), and the stage costs as forms in y = (x, u_{k−N}, u_{k−N+1}, …).

    ∫ xᵀQx over a period, the mode and all inputs held.
    """
    modes, n, m = sampled.plant.B.shape
    oldest, newest = sampled.longest_lag, int(sampled.every_stretch.lag.min())
    width = n + (oldest - newest + 1) * m
    L, stage = np.zeros((modes, n, width)), np.zeros((modes, width, width))
    inputs = np.arange(m)
    for i in range(modes):
        A, B = sampled.plant.A[i], sampled.plant.B[i]
        L[i, :, :n] = np.eye(n)
        for Phi, Gamma, (start, stop, lag) in sampled.pieces(i):
            acting = np.zeros((m, width))
            acting[inputs, n + (oldest - lag) * m + inputs] = 1.0
            z = np.concatenate((L[i], acting))
            stage[i] += z.T @ gramian(A, B, stop - start, Q) @ z
            L[i] = Phi @ L[i] + Gamma @ acting
    return L, stage


def solve(L, stage, weight, hazard, transition, count, step):
    """P (modes, ages, d, d), lower triangles, and gain (modes, ages, m, d); `count` is N."""
    (modes, ages), n, m = hazard.shape, L.shape[1], weight.shape[0]
    d = n + count * m
    P, gain = np.zeros((modes, ages, d, d)), np.zeros((modes, ages, m, d))
    chain = hazard, transition
    last = np.full(max(ages, count), ages - 1)
    visits = np.concatenate((last, np.arange(ages - 1)[::-1]))
    increase = np.inf
    for k in range(MOST_SWEEPS):
        moved, grown, shrunk = sweep(P, gain, L, stage, weight, *chain, visits)
        settled = max(moved, grown, shrunk)
        if settled <= TOLERANCE:
            return P, gain
        if not (shrunk <= ROUGH and np.isfinite(P.max())):
            raise ArgumentError(
                "plant is too unstable for so long a delay: the costs grow by e^{2·A·delay} over "
                "it, and double precision loses those of the inputs beside them."
            )
        if P.max() > HUGE:
            break
        if (k + 1) % BATCH == 0:
            before, increase = increase, grown * np.trace(P, axis1=2, axis2=3).max()
            if increase >= before and settled <= ROUGH:  # all that is left is round-off
                return P, gain
            if increase >= before:
                break
    rate = _growth(P, gain, L, weight, *chain, count) / step
    raise InfeasibleError(
        "no causal law with a finite expected cost was found, so none to stabilise in mean square: "
        f"under the best one E|x|² grows at {rate:+.3g} 1/s. The modes are too far apart for how "
        "unpredictably they switch, or the delay is too long."
    )


def _growth(P, gain, L, weight, hazard, transition, count):
    """ln of the factor by which the least cost to go grows a period when it is all that counts."""
    visits, nothing = np.arange(P.shape[1]), np.zeros((L.shape[0], L.shape[2], L.shape[2]))
    total = 0.0
    for k in range(8 * count):
        P *= HUGE / P.max()
        sweep(P, gain, L, nothing, weight, hazard, transition, visits)
        total += np.log(P.max() / HUGE) if k >= 4 * count else 0.0
    return total / (4 * count)
