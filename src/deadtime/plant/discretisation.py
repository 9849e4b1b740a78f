"""One mode at a period: what a held input and white noise do to it, exactly.

With the input held for h seconds,

    x(t + h) = Φ x(t) + Γ u,    Φ = I + A W,  Γ = W B,  W = ∫₀^h e^{As} ds.

Poles and ranks are asked of the difference quotient (x(t + h) − x(t))/h = (W/h)(A x + B u)
instead: it tends to (A, B) as h → 0, where Φ → I and Γ → 0, has no cancellation, and a gain
gives it the eigenvalues (z − 1)/h where Φ + ΓK has the eigenvalues z.
"""

from __future__ import annotations

import numpy as np

from deadtime.base.checks import read_only
from deadtime.base.errors import ArgumentError


def finite_discretisation(
    A: np.ndarray, B: np.ndarray, step: float
) -> tuple[np.ndarray, np.ndarray]:
    """Φ and Γ of one mode over a step; refused where they are beyond what floats hold."""
    from deadtime.numerics.exponential import discretise

    Phi, Gamma = discretise(read_only(A), read_only(B), step)
    if not (np.isfinite(Phi).all() and np.isfinite(Gamma).all()):
        raise ArgumentError(
            f"step = {step:g} s is too long: within it the plant grows beyond what floats hold."
        )
    return Phi, Gamma


def quotient(A: np.ndarray, B: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """((Φ − I)/h, Γ/h)."""
    mean = finite_discretisation(A, np.eye(A.shape[0]), step)[1] / step
    return mean @ A, mean @ B


def quotient_poles(poles: np.ndarray, step: float, i: int) -> np.ndarray:
    """(e^{ph} − 1)/h for poles p in 1/s, which must not oscillate faster than samples can."""
    turning = np.abs(np.imag(poles))
    if (turning >= np.pi * (1.0 - 1e-9) / step).any():
        worst = poles[np.argmax(turning)]
        raise ArgumentError(
            f"poles of mode {i}: {worst:g} oscillates faster than a period of {step:g} s shows: "
            f"|Im p| must be below π/h = {np.pi / step:.4g} 1/s; shorten the step."
        )
    with np.errstate(over="ignore", invalid="ignore"):  # a step too long is refused elsewhere
        return np.expm1(poles * step) / step
