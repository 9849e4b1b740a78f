"""The table of a law which forecasts that the mode never changes.

The forecast that mode i is held gives, with the input held over each period, the exact functional

    K P = K e^{AD} x_k + Σ_{j<N} K Φ(h)^{j−1} Γ(h) u_{k−j} + K Φ(h)^{N−1} Γ(φ) u_{k−N}:

u_{k−j} has left a whole period h of the delay line for j < N, but of u_{k−N} only the last φ
still lies ahead. The averaged, single-mode and mean laws are weighted sums of such rows.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numba import njit

from deadtime.base.checks import read_only
from deadtime.feedback import Factor, Feedback
from deadtime.numerics.exponential import discretise, discretise_modes, multiply
from deadtime.plant import SampledPlant


@njit(cache=True)
def place(tap, lag, G):
    """Add what a stretch gives its inputs to their taps, G (N, m, m), the youngest first."""
    m = tap.shape[0]
    for j in range(m):
        for i in range(m):
            G[lag[j] - 1, i, j] += tap[i, j]


@njit(cache=True)
def _rows(A, B, K, weights, ahead, delay):
    """Σ_i w_i of the rows above: F (m, n), G (N, m, m)."""
    m, n = K.shape[1:]
    kinds, stretches = ahead.length.size, ahead.kind.size
    F, G = np.zeros((m, n)), np.zeros((ahead.lag.max(), m, m))
    Phi, Gamma = np.empty((kinds, n, n)), np.empty((kinds, n, m))
    for i in range(A.shape[0]):
        for kind in range(kinds):
            Phi[kind], Gamma[kind] = discretise(A[i], B[i], ahead.length[kind])
        row = weights[i] * K[i]
        F += multiply(row, discretise(A[i], B[i], delay)[0])
        for p in range(stretches - 1, -1, -1):
            place(multiply(row, Gamma[ahead.kind[p]]), ahead.lag[p], G)
            row = multiply(row, Phi[ahead.kind[p]])
    return F, G


def constant_table(
    A: Float[np.ndarray, "mode n n"],
    B: Float[np.ndarray, "mode n m"],
    K: Float[np.ndarray, "mode m n"],
    weights: Float[np.ndarray, " mode"],
    sampled: SampledPlant,
) -> Feedback:
    """The one-row table Σ_i w_i K_i P_i, with its factorisation (S block-diagonal over modes)."""
    F, G = _rows(A, B, K, read_only(weights), sampled.ahead, sampled.window.delay)
    Phi, Gamma = discretise_modes(A, B, sampled.step)
    modes, n, m = B.shape
    H = (weights[:, None, None] * K).transpose(1, 0, 2).reshape(1, m, modes * n)
    S = np.zeros((modes * n, modes * n))
    for i in range(modes):
        S[i * n : (i + 1) * n, i * n : (i + 1) * n] = Phi[i]
    factor = Factor(H, S, Gamma.reshape(modes * n, m), G[None, -1])
    return Feedback(F[None], G[None], "none", sampled.step, factor=factor)
