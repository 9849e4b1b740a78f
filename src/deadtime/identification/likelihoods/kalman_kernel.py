"""Kernels of Kalman's filter over a log: with derivatives by the unknowns, and for hidden modes.

    x⁻ = Φ x + a,      P⁻ = Φ P Φᵀ + Q,    g = P⁻ c,    s = cᵀ g + R,    e = y − cᵀ x⁻,
    x = x⁻ + g e/s,    P = P⁻ − g gᵀ/s,

sensor by sensor: their errors are independent, so no matrix is inverted.

`tangents` also has the derivatives of each line by all unknowns. P depends on A and the noise only.

`filter_modes` has a normal state x_i, P_i and a probability for each mode i. Each is predicted over
a period by the filter of the mode in which the period begins, or by halves of two if the mode
changes within it, and corrected by the measurements. Then the states that lead to mode j are mixed
to one normal with their mean and covariance (Kim, J. Econometrics 60, 1994; if a period depends on
the mode at its beginning alone, it is the filter of Blom and Bar-Shalom, IEEE Trans. Automat.
Control 33(8), 1988).
"""

from __future__ import annotations

import math

import numpy as np

from deadtime.numerics.exponential import product
from deadtime.numerics.kernels import kernel


@kernel
def reset(x, P, P0):
    """The prior: mean 0 and covariance P0."""
    for i in range(x.size):
        x[i] = 0.0
        for j in range(x.size):
            P[i, j] = P0[i, j]


@kernel
def predict_mean(x, Phi, moved, new_x):
    n = x.size
    for i in range(n):
        total = moved[i]
        for j in range(n):
            total += Phi[i, j] * x[j]
        new_x[i] = total


@kernel
def predict_covariance(P, Phi, Q, new_P, spare):
    n = P.shape[0]
    product(Phi, P, spare)
    for i in range(n):
        for j in range(i + 1):
            total = Q[i, j]
            for c in range(n):
                total += spare[i, c] * Phi[j, c]
            new_P[i, j] = total
            new_P[j, i] = total


@kernel
def innovation(y, R, c, x, P, gain):
    """The error and the variance of a measurement by a sensor c = (n,); P c in `gain`."""
    e, s = y, R
    for i in range(x.size):
        total = 0.0
        for j in range(x.size):
            total += P[i, j] * c[j]
        gain[i] = total
        s += c[i] * total
        e -= c[i] * x[i]
    return e, s


@kernel
def correct(x, P, gain, e, s):
    for i in range(x.size):
        x[i] += gain[i] * e / s
        for j in range(x.size):
            P[i, j] -= gain[i] * gain[j] / s


@kernel
def tangents(
    y, start, mode, kind, Phi, by_Phi, Q, by_Q, added, by_added, own, noisy, C, R, of_R, wide, P0,
    now, out,
):  # fmt: skip
    """A stretch of the filter from the state `now`, which is updated to its end in place.

    y : (T, p), NaN where nothing was measured; start : (T,), whether the prior of a sample's state
    is P0 and independent of all before. mode, …, by_added : of the periods that lead to
    samples, see `FilterPeriods`. own, noisy, wide : see `Places`. C : (p, n), R : (p,), of_R :
    (q, p), its derivatives. now : x (n,), P (n, n) and their derivatives (size, n), (q, n, n).
    out : errors and variances (T, p), 0 and 1 where nothing was measured, and their derivatives
    (T, p, size), (T, p, q).
    """
    samples, sensors = y.shape
    x, P, by_x, by_P = now
    error, variance, by_e, by_s = out
    n = x.size
    led_x, led_P, spare, gain = np.empty(n), np.empty((n, n)), np.empty((n, n)), np.empty(n)
    for k in range(samples):
        i, m = kind[k], mode[k]
        if start[k]:
            reset(x, P, P0)
            by_x[:] = 0.0
            by_P[:] = 0.0
        else:
            predict_mean(x, Phi[i], added[k], led_x)
            predict_covariance(P, Phi[i], Q[i], led_P, spare)
            predict_mean_tangents(x, by_x, Phi[i], by_Phi[i], by_added[k], own[m])
            predict_covariance_tangents(P, by_P, Phi[i], by_Phi[i], by_Q[i], noisy[m], spare)
            for a in range(n):
                x[a] = led_x[a]
                for b in range(n):
                    P[a, b] = led_P[a, b]
        for s in range(sensors):
            error[k, s], variance[k, s] = 0.0, 1.0
            by_e[k, s, :] = 0.0
            by_s[k, s, :] = 0.0
            if y[k, s] == y[k, s]:
                e, whole = innovation(y[k, s], R[s], C[s], x, P, gain)
                correct_tangents(
                    e, whole, C[s], of_R[:, s], wide, gain, by_x, by_P, by_e[k, s], by_s[k, s]
                )
                correct(x, P, gain, e, whole)
                error[k, s], variance[k, s] = e, whole


@kernel
def predict_mean_tangents(x, by_x, Phi, by_Phi, by_added, own):
    """The derivatives of x over a period, from x before it."""
    n = x.size
    spare = np.empty(n)
    for a in range(by_x.shape[0]):
        for i in range(n):
            spare[i] = by_x[a, i]
        for i in range(n):
            total = 0.0
            for j in range(n):
                total += Phi[i, j] * spare[j]
            by_x[a, i] = total
    for c in range(own.size):
        if own[c] < 0:
            continue
        for i in range(n):
            total = by_added[c, i]
            if c < n * n:  # A's
                for j in range(n):
                    total += by_Phi[c, i, j] * x[j]
            by_x[own[c], i] += total


@kernel
def predict_covariance_tangents(P, by_P, Phi, by_Phi, by_Q, noisy, across):
    """The derivatives of P over a period, from P before it; `across` is Φ P."""
    n = P.shape[0]
    spare = np.empty((n, n))
    for c in range(by_P.shape[0]):
        product(Phi, by_P[c], spare)
        for i in range(n):
            for j in range(i + 1):
                total = 0.0
                for d in range(n):
                    total += spare[i, d] * Phi[j, d]
                by_P[c, i, j] = total
                by_P[c, j, i] = total
    for c in range(noisy.size):
        w = noisy[c]
        if w < 0:
            continue
        if c < n * n:  # A's: ∂Φ P Φᵀ and its transpose
            for i in range(n):
                for j in range(n):
                    total = 0.0
                    for d in range(n):
                        total += by_Phi[c, i, d] * across[j, d]
                    spare[i, j] = total
            for i in range(n):
                for j in range(n):
                    by_P[w, i, j] += spare[i, j] + spare[j, i]
        for i in range(n):
            for j in range(n):
                by_P[w, i, j] += by_Q[c, i, j]


@kernel
def correct_tangents(e, s, c, of_R, wide, gain, by_x, by_P, by_e, by_s):
    """The derivatives of x, P and a measurement's error and variance, x and P before it."""
    n = gain.size
    slope = np.empty(n)
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


@kernel
def filter_modes(y, start, kind, Phi, moved, Q, C, R, P0, chain, which, within, stay, move, gained):
    """Log densities of the measurements after every period, and log L by sample, in place.

    y : (T, p), NaN where nothing was measured; start : (T,), whether the prior of a state is P0.
    Phi, Q : (modes, kinds, n, n), moved : (modes, T, n), kind : (T,), of the period that
    leads to a sample. C : (p, n), R : (p,). chain : (kinds, modes, modes), logs of probabilities,
    which : (T − 1,); within : whether the mode changes within periods. stay : (T − 1, modes) and
    move : (T − 1, modes, modes), of periods that end in the mode that they begin in, and of others;
    gained : (T,).
    """
    samples, n, modes = y.shape[0], P0.shape[0], chain.shape[1]
    x, P = np.zeros((modes, n)), np.zeros((modes, n, n))
    led_x, led_P = np.zeros((modes, modes, n)), np.zeros((modes, modes, n, n))
    chance, after, share = np.empty(modes), np.empty(modes), np.empty(modes)
    density, spare, gain = np.zeros((modes, modes)), np.zeros((3, n, n)), np.zeros((2, n))
    for i in range(modes):
        chance[i] = -math.log(modes)
        reset(x[i], P[i], P0)
        gained[0] = update(x[i], P[i], y[0], C, R, gain[0])
    for k in range(1, samples):
        at = kind[k]
        for i in range(modes):
            for j in range(modes):
                if i != j and not within:
                    continue
                if start[k]:
                    reset(led_x[i, j], led_P[i, j], P0)
                elif i == j:
                    predict_mean(x[i], Phi[i, at], moved[i, k], led_x[i, i])
                    predict_covariance(P[i], Phi[i, at], Q[i, at], led_P[i, i], spare[0])
                else:
                    own = Phi[i, at], moved[i, k], Q[i, at]
                    other = Phi[j, at], moved[j, k], Q[j, at]
                    predict_halves(x[i], P[i], *own, *other, led_x[i, j], led_P[i, j], spare, gain)
                density[i, j] = update(led_x[i, j], led_P[i, j], y[k], C, R, gain[0])
            stay[k - 1, i] = density[i, i]
            for j in range(modes):
                move[k - 1, i, j] = density[i, j] if within else density[i, i]
        largest, of = -math.inf, which[k - 1]
        for j in range(modes):
            top, total = -math.inf, 0.0
            for i in range(modes):
                share[i] = chance[i] + chain[of, i, j] + move[k - 1, i, j]
                top = max(top, share[i])
            for i in range(modes):
                share[i] = math.exp(share[i] - top)
                total += share[i]
            after[j] = top + math.log(total)
            largest = max(largest, after[j])
            for i in range(modes):
                share[i] /= total
            mix(led_x, led_P, share, j, within, x[j], P[j])
        total = 0.0
        for j in range(modes):
            total += math.exp(after[j] - largest)
        gained[k] = largest + math.log(total)
        for j in range(modes):
            chance[j] = after[j] - gained[k]


@kernel
def predict_halves(x, P, Phi, moved, Q, other, other_moved, other_Q, new_x, new_P, spare, ends):
    """A state over a period that is partly in one mode and partly in another, share unknown."""
    n = x.size
    predict_mean(x, Phi, moved, ends[0])
    predict_mean(x, other, other_moved, ends[1])
    for i in range(n):
        for j in range(n):
            spare[1, i, j] = 0.5 * (Phi[i, j] + other[i, j])
            spare[2, i, j] = 0.5 * (Q[i, j] + other_Q[i, j])
    predict_covariance(P, spare[1], spare[2], new_P, spare[0])
    for i in range(n):
        new_x[i] = 0.5 * (ends[0, i] + ends[1, i])
        for j in range(n):
            new_P[i, j] += (ends[0, i] - ends[1, i]) * (ends[0, j] - ends[1, j]) / 12.0


@kernel
def update(x, P, y, C, R, gain):
    """A state corrected by its measurements, in place; their log density."""
    density = 0.0
    for s in range(y.size):
        if y[s] == y[s]:
            e, whole = innovation(y[s], R[s], C[s], x, P, gain)
            correct(x, P, gain, e, whole)
            density -= 0.5 * (e * e / whole + math.log(2.0 * math.pi * whole))
    return density


@kernel
def mix(led_x, led_P, share, j, within, x, P):
    """The mean and covariance of the states that lead to mode j, in place."""
    n = x.size
    for a in range(n):
        x[a] = 0.0
        for b in range(n):
            P[a, b] = 0.0
    for i in range(share.size):
        to = j if within else i
        for a in range(n):
            x[a] += share[i] * led_x[i, to, a]
    for i in range(share.size):
        to = j if within else i
        for a in range(n):
            for b in range(n):
                apart = (led_x[i, to, a] - x[a]) * (led_x[i, to, b] - x[b])
                P[a, b] += share[i] * (led_P[i, to, a, b] + apart)
