"""Kalman's filter over a log and its derivatives by all unknowns in one pass, for kernels.

    x⁻ = Φ x + a,      P⁻ = Φ P Φᵀ + Q,    g = P⁻ c,    s = cᵀ g + R,    e = y − cᵀ x⁻,
    x = x⁻ + g e/s,    P = P⁻ − g gᵀ/s,

sensor by sensor, each line with its derivative. Few unknowns move P: those of A and of the noise.
"""

from __future__ import annotations

import numpy as np

from deadtime.numerics.exponential import product
from deadtime.numerics.kernels import kernel


@kernel
def tangents(
    y, start, mode, kind, Phi, by_Phi, Q, by_Q, added, by_added, own, noisy, C, R, of_R, wide, P0,
    now, out,
):  # fmt: skip
    """A stretch of the filter, the state before it in `now`, which is brought to its end.

    y : (T, p), NaN where nothing was measured; start : (T,), whether nothing is known of the state
    of a sample but P0, whatever was before. mode, …, by_added : of the periods that lead to
    samples, see `Periods`. own, noisy, wide : see `Places`. C : (p, n), R : (p,), of_R : (q, p),
    its derivatives. now : x (n,), P (n, n) and their derivatives (size, n), (q, n, n). out :
    errors and variances (T, p), 0 and 1 where nothing was measured, and their derivatives
    (T, p, size), (T, p, q). Sensors err independently, so one after the other is the same as all
    at once, and nothing is inverted.
    """
    samples, sensors = y.shape
    x, P, by_x, by_P = now
    error, variance, by_e, by_s = out
    for k in range(samples):
        i, m = kind[k], mode[k]
        if start[k]:
            begin(x, P, by_x, by_P, P0)
        else:
            carry_mean(x, by_x, Phi[i], by_Phi[i], added[k], by_added[k], own[m])
            carry_variance(P, by_P, Phi[i], by_Phi[i], Q[i], by_Q[i], noisy[m])
        for s in range(sensors):
            error[k, s], variance[k, s] = 0.0, 1.0
            by_e[k, s, :] = 0.0
            by_s[k, s, :] = 0.0
            if y[k, s] == y[k, s]:
                off, whole = y[k, s], R[s]
                found = measure(
                    off, whole, C[s], of_R[:, s], wide, x, P, by_x, by_P, by_e[k, s], by_s[k, s]
                )
                error[k, s], variance[k, s] = found


@kernel
def begin(x, P, by_x, by_P, P0):
    """Nothing is known of the state but P0, whatever the unknowns."""
    n = x.size
    for i in range(n):
        x[i] = 0.0
        for j in range(n):
            P[i, j] = P0[i, j]
        for a in range(by_x.shape[0]):
            by_x[a, i] = 0.0
        for c in range(by_P.shape[0]):
            for j in range(n):
                by_P[c, i, j] = 0.0


@kernel
def carry_mean(x, by_x, Phi, by_Phi, added, by_added, own):
    """x and its derivatives over a period."""
    n = x.size
    before, spare = np.empty(n), np.empty(n)
    for i in range(n):
        before[i] = x[i]
    for a in range(by_x.shape[0]):
        for i in range(n):
            spare[i] = by_x[a, i]
        for i in range(n):
            total = 0.0
            for j in range(n):
                total += Phi[i, j] * spare[j]
            by_x[a, i] = total
    for i in range(n):
        total = added[i]
        for j in range(n):
            total += Phi[i, j] * before[j]
        x[i] = total
    for c in range(own.size):
        if own[c] < 0:
            continue
        for i in range(n):
            total = by_added[c, i]
            if c < n * n:  # A's
                for j in range(n):
                    total += by_Phi[c, i, j] * before[j]
            by_x[own[c], i] += total


@kernel
def carry_variance(P, by_P, Phi, by_Phi, Q, by_Q, noisy):
    """P and its derivatives over a period."""
    n = P.shape[0]
    across, spare = np.empty((n, n)), np.empty((n, n))
    for c in range(by_P.shape[0]):
        product(Phi, by_P[c], spare)
        for i in range(n):
            for j in range(i + 1):
                total = 0.0
                for d in range(n):
                    total += spare[i, d] * Phi[j, d]
                by_P[c, i, j] = total
                by_P[c, j, i] = total
    for i in range(n):  # P Φᵀ
        for j in range(n):
            total = 0.0
            for d in range(n):
                total += P[i, d] * Phi[j, d]
            across[i, j] = total
    for c in range(noisy.size):
        w = noisy[c]
        if w < 0:
            continue
        if c < n * n:  # A's
            product(by_Phi[c], across, spare)
            for i in range(n):
                for j in range(n):
                    by_P[w, i, j] += spare[i, j] + spare[j, i]
        for i in range(n):
            for j in range(n):
                by_P[w, i, j] += by_Q[c, i, j]
    for i in range(n):
        for j in range(i + 1):
            total = Q[i, j]
            for d in range(n):
                total += Phi[i, d] * across[d, j]
            P[i, j] = total
            P[j, i] = total


@kernel
def measure(y, R, c, of_R, wide, x, P, by_x, by_P, by_e, by_s):
    """What a sensor c = (n,) adds: its error and variance, with their derivatives, in place."""
    n = x.size
    gain, slope = np.empty(n), np.empty(n)
    e, s = y, R
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += P[i, j] * c[j]
        gain[i] = total
        s += c[i] * total
        e -= c[i] * x[i]
    for a in range(by_x.shape[0]):
        total = 0.0
        for i in range(n):
            total -= c[i] * by_x[a, i]
        by_e[a] = total
        for i in range(n):
            by_x[a, i] += gain[i] * total / s
    for w in range(by_P.shape[0]):
        total = of_R[w]
        for i in range(n):
            slope[i] = 0.0
            for j in range(n):
                slope[i] += by_P[w, i, j] * c[j]
            total += c[i] * slope[i]
        by_s[w] = total
        for i in range(n):
            part = slope[i] - gain[i] * total / s
            by_x[wide[w], i] += part * e / s
            for j in range(n):
                by_P[w, i, j] -= (part * gain[j] + gain[i] * slope[j]) / s
    for i in range(n):
        x[i] += gain[i] * e / s
        for j in range(n):
            P[i, j] -= gain[i] * gain[j] / s
    return e, s
