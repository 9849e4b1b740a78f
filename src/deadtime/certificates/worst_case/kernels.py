"""The compiled loop over a cycle, forwards and transposed.

Both run the weighted loop, x̃_k = w^k x_k and ũ_k = w^k u_k, so that a long cycle neither
overflows nor underflows when w is near 1/(growth over a period):

    ũ_k = F x̃_k + Σ_j w^j G_j ũ_{k−j},
    x̃_{k+1} = w (Φ₁ (Φ₀ x̃_k + w^N Γ₀ ũ_{k−N}) + w^{N−1} Γ₁ ũ_{k−N+1}).

A period begins with its sample.
`index`, Φ, Γ are a phase table (`numerics.exponential.phases`); row c of the law is F[c] and
G[c] (m, taps·m), weighted, the oldest input first. This module needs Numba, so it is imported
where it is used.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, fastmath={"reassoc", "contract"})
def _dot(a, b):
    """Σ a_i b_i, summed in any order (so that it vectorises)."""
    total = 0.0
    for i in range(a.size):
        total += a[i] * b[i]
    return total


@njit(cache=True)
def _control(F, G, x, pipe, now):
    """u = F x + G (past inputs), into its place in the pipe."""
    m, window = G.shape
    for i in range(m):
        pipe[now + i] = _dot(G[i], pipe[now - window : now]) + _dot(F[i], x)


@njit(cache=True)
def forward(index, Phi, Gamma, count, weight, F, G, rows, repeats, x, inputs, states):
    """Run `repeats` cycles from x and the first rows of `inputs` (W + samples, m), in place.

    `states` (samples, n) gets x̃ at the end of every period.
    """
    n, m, cycle = x.size, G.shape[1], rows.size
    first, second = weight**count, weight ** (count - 1)
    past = inputs.shape[0] - repeats * cycle
    pipe = inputs.reshape(-1)
    middle = np.empty(n)
    for k in range(repeats * cycle):
        step = k % cycle
        row, now = rows[step], past + k
        _control(F[row], G[row], x, pipe, now * m)
        acts = now - count
        e, f = index[step]
        for i in range(n):
            total = 0.0
            for j in range(m):
                total += Gamma[e, i, j] * inputs[acts, j]
            total *= first
            for j in range(n):
                total += Phi[e, i, j] * x[j]
            middle[i] = total
        for i in range(n):
            total = 0.0
            for j in range(m):
                total += Gamma[f, i, j] * inputs[acts + 1, j]
            total *= second
            for j in range(n):
                total += Phi[f, i, j] * middle[j]
            x[i] = weight * total
            states[k, i] = x[i]


@njit(cache=True)
def after(index, Phi, Gamma, count, weight, F, G, rows, repeats, held, z):
    """The lifted state z = (x, the `held` last inputs, the oldest first) after some cycles."""
    n, m, samples = F.shape[2], F.shape[1], repeats * rows.size
    x, result = z[:n].copy(), np.empty(z.size)
    inputs, states = np.empty((held + samples, m)), np.empty((samples, n))
    inputs[:held] = z[n:].copy().reshape(held, m)
    forward(index, Phi, Gamma, count, weight, F, G, rows, repeats, x, inputs, states)
    result[:n] = x
    result[n:] = inputs[samples:].reshape(-1)
    return result


@njit(cache=True)
def _felt(F, G, p, pipe, now):
    """`_control`, transposed."""
    m, window = G.shape
    for i in range(m):
        u = pipe[now + i]
        for j in range(p.size):
            p[j] += F[i, j] * u
        for j in range(window):
            pipe[now - window + j] += G[i, j] * u


@njit(cache=True)
def transposed(index, Phi, Gamma, count, weight, F, G, rows, p, inputs):
    """Carry a functional of the lifted state back over one cycle, in place.

    It is (p, the last W rows of `inputs` (W + samples, m)) at the end, and (p, the first W) at
    the start; the other rows of `inputs` must be 0 at first.
    """
    n, m, cycle = p.size, G.shape[1], rows.size
    first, second = weight**count, weight ** (count - 1)
    past = inputs.shape[0] - cycle
    pipe = inputs.reshape(-1)
    middle = np.empty(n)
    for k in range(cycle - 1, -1, -1):
        row, now = rows[k], past + k
        acts = now - count
        e, f = index[k]
        for j in range(m):
            for i in range(n):
                inputs[acts + 1, j] += weight * second * Gamma[f, i, j] * p[i]
        for j in range(n):
            middle[j] = 0.0
            for i in range(n):
                middle[j] += weight * Phi[f, i, j] * p[i]
        for j in range(m):
            for i in range(n):
                inputs[acts, j] += first * Gamma[e, i, j] * middle[i]
        for j in range(n):
            p[j] = 0.0
            for i in range(n):
                p[j] += Phi[e, i, j] * middle[i]
        _felt(F[row], G[row], p, pipe, now * m)
