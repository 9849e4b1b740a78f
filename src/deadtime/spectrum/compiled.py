"""What runs over all the taps of a table, compiled: the lifted loop, and its transform."""

from __future__ import annotations

import numpy as np
from numba import njit

from deadtime.numerics.exponential import ROUND_OFF, balance, discretise, multiply, norm

_SHORT = 2.0  # |A| h up to which one series will do: larger terms would cancel


@njit(cache=True)
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


@njit(cache=True)
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


@njit(cache=True)
def cut_inputs(A, B, step, delays):
    """N, Γ_early, Γ_late and e^{A(h − φ)} B for each delay, a little below 0 too.

    Γ_late = Γ(h − φ) and Γ_early = Γ(h) − Γ(h − φ), whose round-off is no more than p has anyway.
    While |A| h is small, Γ(τ) = Σ_k A^k B τ^{k+1}/(k + 1)! has the same terms for all delays.
    """
    n, m = B.shape
    # Not snapped to whole periods as a `Window` is: p must be continuous in the delay.
    count = np.maximum(1.0, np.ceil(delays / step))
    rest = count * step - delays
    early, late, last = np.empty((3, delays.size, n, m))
    unit = balance(A)
    size = norm(A * unit / unit.reshape(n, 1)) * max(step, rest.max())
    terms, bound = [B / 1.0], 1.0
    while bound > ROUND_OFF and size <= _SHORT:
        terms.append(multiply(A, terms[-1]) / (len(terms) + 1.0))
        bound *= size / len(terms)
    whole = discretise(A, B, step)[1]
    for i in range(delays.size):
        if size <= _SHORT:
            total = late[i]
            total[:] = 0.0
            for k in range(len(terms) - 1, -1, -1):
                for row in range(n):
                    for column in range(m):
                        total[row, column] = rest[i] * (total[row, column] + terms[k][row, column])
        else:
            late[i] = discretise(A, B, rest[i])[1]
        early[i] = whole - late[i]
        last[i] = B + multiply(A, late[i])
    return count, early, late, last
