"""The table of a law which forecasts that the mode never changes.

A forecast "mode i for ever" gives, with the input held over each period, the exact functional

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
from deadtime.numerics.exponential import held, held_modes, multiply
from deadtime.plant import Window


@njit(cache=True)
def _rows(A, B, K, weights, count, delay, step, phase):
    """Σ_i w_i of the rows above: F (m, n), G (N, m, m), and Φ(h), Γ(h) of every mode."""
    m, n = K.shape[1:]
    F, G = np.zeros((m, n)), np.zeros((count, m, m))
    Phi, Gamma = held_modes(A, B, step)
    for i in range(A.shape[0]):
        row = weights[i] * K[i]
        F += multiply(row, held(A[i], B[i], delay)[0])
        for j in range(count - 1):
            G[j] += multiply(row, Gamma[i])
            row = multiply(row, Phi[i])
        G[count - 1] += multiply(row, held(A[i], B[i], phase)[1])
    return F, G, Phi, Gamma


def frozen_table(
    A: Float[np.ndarray, "mode n n"],
    B: Float[np.ndarray, "mode n m"],
    K: Float[np.ndarray, "mode m n"],
    weights: Float[np.ndarray, " mode"],
    window: Window,
) -> Feedback:
    """The one-row table Σ_i w_i K_i P_i, with its factorisation (S block-diagonal over modes)."""
    count, step = window.count, window.step
    F, G, Phi, Gamma = _rows(A, B, K, read_only(weights), count, window.delay, step, window.phase)
    modes, n, m = B.shape
    H = (weights[:, None, None] * K).transpose(1, 0, 2).reshape(1, m, modes * n)
    S = np.zeros((modes * n, modes * n))
    for i in range(modes):
        S[i * n : (i + 1) * n, i * n : (i + 1) * n] = Phi[i]
    factor = Factor(H, S, Gamma.reshape(modes * n, m), G[None, -1])
    return Feedback(F[None], G[None], "none", step, factor=factor)
