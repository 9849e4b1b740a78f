"""What white noise does to a linear system: covariances after a while, and their square roots."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import read_only


def noise_covariance(
    A: Float[np.ndarray, "n n"], W: Float[np.ndarray, "n n"], tau: float
) -> Float[np.ndarray, "n n"]:
    """Q(τ) = ∫₀^τ e^{As} W e^{Aᵀs} ds: the covariance that noise of intensity W adds in τ seconds.

    The exponential of [[−A, W], [0, Aᵀ]] holds e^{−Aτ} Q in its corner (Van Loan, IEEE Trans.
    Automat. Control 23(3), 1978). It is taken of a piece short enough that e^{−Aτ} is harmless,
    and Q(2τ) = Q(τ) + e^{Aτ} Q(τ) e^{Aᵀτ} does the rest.

    Examples
    --------
    >>> noise_covariance(np.array([[0.0, 1.0], [0.0, 0.0]]), np.diag([0.0, 3.0]), 2.0).round(9)
    array([[8., 6.],
           [6., 6.]])
    """
    n, size = A.shape[0], float(np.abs(W).max())
    if tau == 0.0 or size == 0.0:
        return np.zeros((n, n))
    with np.errstate(over="ignore", invalid="ignore"):
        return _covariance(A, W, tau, size)


def _covariance(A: np.ndarray, W: np.ndarray, tau: float, size: float) -> np.ndarray:
    """`noise_covariance` with |W|_max = `size`; not finite where e^{Aτ} is not."""
    n, span = A.shape[0], 2.0 * tau * float(np.abs(A).sum(axis=0).max())
    if not math.isfinite(span):
        return np.full((n, n), np.nan)
    doublings = max(0, math.ceil(math.log2(max(span, 1.0))))
    short = tau / 2.0**doublings
    E = transition(np.block([[-A, W / size], [np.zeros((n, n)), A.T]]), short)
    Phi = E[n:, n:].T
    Q = Phi @ E[:n, n:]
    for _ in range(doublings):
        Q, Phi = Q + Phi @ Q @ Phi.T, Phi @ Phi
    return 0.5 * size * (Q + Q.T)


def transition(A: Float[np.ndarray, "n n"], tau: float) -> Float[np.ndarray, "n n"]:
    """e^{Aτ}."""
    from deadtime.numerics.exponential import discretise

    return discretise(read_only(A), read_only(np.zeros((A.shape[0], 1))), tau)[0]


def square_root(Q: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    """L with L Lᵀ = Q, Q positive semidefinite up to round-off, whatever the units of its rows."""
    unit = np.sqrt(np.diag(Q))
    scale = np.where(unit > 0.0, unit, 1.0)
    values, vectors = np.linalg.eigh(Q / np.outer(scale, scale))
    return unit[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
