"""What runs over all the taps of a table, compiled: the lifted loop, and its transform."""

from __future__ import annotations

import numpy as np

from deadtime.numerics.kernels import kernel

_POWERS = 200_000  # of w that are held at a time


@kernel(eager=True)
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


def transform(G, w):
    """Σ_j G_j w^j and Σ_j j G_j w^j, (points, m, m), for G (taps, m, m) and w (points,)."""
    taps, m, _ = G.shape
    flat = G.reshape(taps, m * m)
    both = np.concatenate((flat, flat * np.arange(1.0, taps + 1.0)[:, None]), axis=1)
    result = np.empty((w.size, 2 * m * m), np.complex128)
    size = max(1, _POWERS // taps)
    for start in range(0, w.size, size):
        some = w[start : start + size, None]
        with np.errstate(all="ignore"):  # far outside the unit circle powers overflow
            result[start : start + size] = np.cumprod(np.repeat(some, taps, axis=1), axis=1) @ both
    value, slope = result.reshape(-1, 2, m, m).transpose(1, 0, 2, 3)
    return value, slope
