"""What runs over all the taps of a table, compiled: the lifted loop, and its transform."""

from __future__ import annotations

import numpy as np

from deadtime.numerics.exponential import (
    ROUND_OFF,
    balance,
    balanced_norm,
    discretise,
    discretise_into,
    product,
)
from deadtime.numerics.kernels import kernel

_SHORT = 2.0  # |A| h up to which one series will do: larger terms would cancel
_TERMS = 40  # of that series: far more than round-off needs at `_SHORT`


@kernel
def march(Phi, Gamma, lags, F, G, x, inputs, first):
    """Run on from x and the inputs before step `first`; fill `inputs` and return the last x.

    Gamma (lags, n, m), G (m, taps·m), the oldest tap first; `inputs` (steps·m,).
    """
    m, taps = G.shape[0], G.shape[1] // G.shape[0]
    n = x.size
    moved = np.empty(n)
    for now in range(first, inputs.size // m):
        window = inputs[(now - taps) * m : now * m]
        for i in range(m):
            total = np.dot(G[i], window)
            for k in range(n):
                total += F[i, k] * x[k]
            inputs[now * m + i] = total
        for i in range(n):
            total = 0.0
            for k in range(n):
                total += Phi[i, k] * x[k]
            for k in range(m):
                arriving = 0.0
                for part in range(lags.size):
                    arriving += Gamma[part, i, k] * inputs[(now - lags[part]) * m + k]
                total += arriving
            moved[i] = total
        x[:] = moved
    return x


@kernel
def transform(G, w):
    """Σ_j G_j w^j and Σ_j j G_j w^j, (points, m, m), for G (taps, m, m) and w (points,)."""
    taps, m, _ = G.shape
    value = np.zeros((w.size, m, m), np.complex128)
    slope = np.zeros((w.size, m, m), np.complex128)
    for i in range(w.size):
        power = 1.0 + 0.0j
        for j in range(taps):
            power *= w[i]
            for a in range(m):
                for b in range(m):
                    term = power * G[j, a, b]
                    value[i, a, b] += term
                    slope[i, a, b] += (j + 1.0) * term
    return value, slope


@kernel
def cut_inputs(A, B, step, delays):
    """N, Γ_early, Γ_late and e^{A(h − φ)} B for each delay, a little below 0 too.

    Γ_late = Γ(h − φ) and Γ_early = Γ(h) − Γ(h − φ), whose round-off is no more than p has anyway.
    While |A| h is small, Γ(τ) = Σ_k A^k B τ^{k+1}/(k + 1)! has the same terms for all delays.
    """
    n, m = B.shape
    count, points = np.empty(delays.size), delays.size
    early, late, last = np.empty((points, n, m)), np.empty((points, n, m)), np.empty((points, n, m))
    longest = step
    for i in range(points):
        # Not snapped to whole periods as a `Window` is: p must be continuous in the delay.
        count[i] = max(1.0, np.ceil(delays[i] / step))
        longest = max(longest, count[i] * step - delays[i])
    size = balanced_norm(A, balance(A)) * longest
    terms, length, bound = np.empty((_TERMS, n, m)), 1, 1.0
    for row in range(n):
        for column in range(m):
            terms[0, row, column] = B[row, column]
    while bound > ROUND_OFF and size <= _SHORT and length < _TERMS:
        product(A, terms[length - 1], terms[length])
        for row in range(n):
            for column in range(m):
                terms[length, row, column] /= length + 1.0
        length += 1
        bound *= size / length
    whole = discretise(A, B, step)[1]
    Phi = np.empty((n, n))
    for i in range(points):
        rest = count[i] * step - delays[i]
        if size <= _SHORT:
            for row in range(n):
                for column in range(m):
                    total = 0.0
                    for k in range(length - 1, -1, -1):
                        total = rest * (total + terms[k, row, column])
                    late[i, row, column] = total
        else:
            discretise_into(A, B, rest, Phi, late[i])
        product(A, late[i], last[i])
        for row in range(n):
            for column in range(m):
                last[i, row, column] += B[row, column]
                early[i, row, column] = whole[row, column] - late[i, row, column]
    return count, early, late, last
