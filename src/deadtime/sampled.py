"""One mode at a period: what a held input and white noise do to it, exactly.

With the input held for h seconds,

    x(t + h) = Φ x(t) + Γ u,    Φ = I + A W,  Γ = W B,  W = ∫₀^h e^{As} ds.

Poles and ranks are asked of the difference quotient (x(t + h) − x(t))/h = (W/h)(A x + B u)
instead: it tends to (A, B) as h → 0, where Φ → I and Γ → 0, has no cancellation, and a gain
gives it the eigenvalues (z − 1)/h where Φ + ΓK has the eigenvalues z.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from deadtime.errors import ArgumentError


def held_pair(A: np.ndarray, B: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Φ and Γ."""
    from deadtime.exponential import held

    return held(A, B, step)


def quotient(A: np.ndarray, B: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """((Φ − I)/h, Γ/h)."""
    mean = held_pair(A, np.eye(A.shape[0]), step)[1] / step
    return mean @ A, mean @ B


def quotient_poles(poles: np.ndarray, step: float, i: int) -> np.ndarray:
    """(e^{ph} − 1)/h for poles p in 1/s, which must not oscillate faster than samples can."""
    turning = np.abs(np.imag(poles))
    if (turning * step >= np.pi * (1.0 - 1e-9)).any():
        worst = poles[np.argmax(turning)]
        raise ArgumentError(
            f"poles of mode {i}: {worst:g} oscillates faster than a period of {step:g} s shows: "
            f"|Im p| must be below π/h = {np.pi / step:.4g} 1/s; shorten the step."
        )
    return np.expm1(poles * step) / step


def gramian(
    A: Float[np.ndarray, "n n"], W: Float[np.ndarray, "n n"], time: float
) -> Float[np.ndarray, "n n"]:
    """∫₀^τ e^{As} W e^{Aᵀs} ds over τ = `time`.

    The covariance that white noise of intensity W leaves behind; and, of Aᵀ, the integral of a
    square along dx/dt = A x. Over a short piece by one exponential,

        exp([[−A, W], [0, Aᵀ]] τ) = [[·, e^{−Aτ} G(τ)], [0, e^{Aᵀτ}]],

    which is then doubled: G(2τ) = G(τ) + Φ(τ) G(τ) Φ(τ)ᵀ, sums of positive terms.

    References
    ----------
    C. Van Loan, Computing integrals involving the matrix exponential, IEEE Transactions on
    Automatic Control 23 (1978) 395–404.

    Examples
    --------
    >>> import numpy as np
    >>> gramian(np.zeros((1, 1)), np.ones((1, 1)), 0.5)
    array([[0.5]])
    """
    from scipy.linalg import expm

    n = A.shape[0]
    doublings = max(0, math.ceil(math.log2(max(float(np.linalg.norm(A, 1)) * time, 1e-300) * 2.0)))
    short = time / 2.0**doublings
    block = np.zeros((2 * n, 2 * n))
    block[:n, :n], block[:n, n:], block[n:, n:] = -A, W, A.T
    whole = expm(block * short)
    Phi = whole[n:, n:].T
    G = Phi @ whole[:n, n:]
    for _ in range(doublings):
        G = G + Phi @ G @ Phi.T
        Phi = Phi @ Phi
    return (G + G.T) / 2.0
