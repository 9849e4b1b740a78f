"""Logs whose rows are unevenly spaced: exact from event to event, by SciPy's exponentials."""

import numpy as np
from scipy.linalg import expm


def uneven_states(A, B, delays, noise, t, u, mode, rng):
    """The states at times t of dx/dt = A_σ x + Σ_j b_σ,j u_j(t − D_j) + white noise, from rest.

    Events are samples, where the mode changes, and arrivals of inputs; between two of them nothing
    changes. Noise has the intensity noise², in every state.
    """
    (count, m), n = u.shape, A.shape[1]
    when = np.concatenate((t, *(t + D for D in delays)))
    order = np.argsort(when, kind="stable")
    order = order[when[order] <= t[-1]]
    length = np.round(np.diff(when[order], prepend=t[0]), 12)
    lengths, which = np.unique(length, return_inverse=True)
    Phi, Gamma, root = pieces(A, B, noise, lengths)
    x, now, acting, i = np.zeros((count, n)), np.zeros(n), np.zeros(m), mode[0]
    w = rng.standard_normal((order.size, n))
    for place, (event, piece) in enumerate(zip(order.tolist(), which.tolist(), strict=True)):
        now = Phi[i, piece] @ now + Gamma[i, piece] @ acting + root[i, piece] @ w[place]
        kind, k = divmod(event, count)
        if kind == 0:
            x[k], i = now, mode[k]
        else:
            acting[kind - 1] = u[k, kind - 1]
    return x


def pieces(A, B, noise, lengths):
    """Φ, Γ and a root of the noise's covariance, of every mode and length."""
    (modes, n), m = A.shape[:2], B.shape[2]
    forced, noisy = np.zeros((modes, n + m, n + m)), np.zeros((modes, 2 * n, 2 * n))
    forced[:, :n, :n], forced[:, :n, n:] = A, B
    noisy[:, :n, :n], noisy[:, n:, n:] = -A, A.transpose(0, 2, 1)
    noisy[:, :n, n:] = noise**2 * np.eye(n)
    E, V = (expm(M[:, None] * lengths[:, None, None]) for M in (forced, noisy))
    Q = V[..., n:, n:].swapaxes(-1, -2) @ V[..., :n, n:]
    values, vectors = np.linalg.eigh(Q)
    root = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
    return E[..., :n, :n], E[..., :n, n:], root
