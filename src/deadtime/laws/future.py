"""The rows of a forecast that is one known switching signal, compiled.

From t_k the forecast runs over N − 1 whole steps of the plant and then φ. With Φ⁰, Γ⁰ over the
first φ of a step and Φ¹, Γ¹ over the rest of it, u_{k−j} acts during phase 1 of step
k − j + N − 1 (for j < N; the phase of u_{k−N} is past) and phase 0 of step k − j + N. The
functional R = K_σ(t_k+D) is carried backwards from t_k + D over these phases: each adds R Γ to
the tap of its input and turns R into R Φ. What remains of R at t_k is F.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from deadtime.exponential import phases


@njit(cache=True, nogil=True)
def _carry_back(R, Phi, Gamma, i, G, k, j, scratch):
    """G[k, j] += R Γ_i, then R ← R Φ_i, in place; by entries, for views cost more than they do."""
    m, n = R.shape
    for a in range(m):
        for b in range(m):
            total = G[k, j, a, b]
            for c in range(n):
                total += R[a, c] * Gamma[i, c, b]
            G[k, j, a, b] = total
        for b in range(n):
            total = 0.0
            for c in range(n):
                total += R[a, c] * Phi[i, c, b]
            scratch[b] = total
        for b in range(n):
            R[a, b] = scratch[b]


@njit(cache=True, nogil=True)
def future_rows(A, B, final_gain, step, phase, count, cut_step, cut_offset, cut_mode):
    """F (steps, m, n) and G (steps, N, m, m) along a known signal.

    `final_gain` (steps, m, n) is K_σ(t_k + D) for every sample.
    """
    steps, m, n = final_gain.shape
    total = steps + count - 1
    index, Phi, Gamma, _, _, _ = phases(A, B, step, phase, cut_step, cut_offset, cut_mode, total)
    F, G = np.empty((steps, m, n)), np.zeros((steps, count, m, m))
    R, scratch = np.empty((m, n)), np.empty(n)
    for k in range(steps):
        R[:] = final_gain[k]
        for j in range(1, count + 1):
            _carry_back(R, Phi, Gamma, index[k + count - j, 0], G, k, j - 1, scratch)
            if j < count and phase < step:
                i = index[k + count - 1 - j, 1]
                _carry_back(R, Phi, Gamma, i, G, k, j - 1, scratch)
        F[k] = R
    return F, G
