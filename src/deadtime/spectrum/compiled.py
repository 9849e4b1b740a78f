"""What runs over all the taps of a table, compiled: the lifted loop, and its transform."""

from __future__ import annotations

import numpy as np

from deadtime.numerics.kernels import kernel


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
