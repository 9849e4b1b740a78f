"""What a plant does in a while, and how that moves with its matrix.

    Φ(τ) = e^{Aτ},   W(τ) = ∫₀^τ e^{As} ds,   ∂Φ/∂A_ab, ∂W/∂A_ab

Both are in exp τ[[A, I], [0, 0]], and the derivative of an exponential in the direction E is the
corner of exp[[Z, E], [0, Z]] (Van Loan, IEEE Trans. Automat. Control 23(3), 1978).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.numerics.exponential import discretise_all


class TransitionMaps(NamedTuple):
    """Φ and W of times, and their derivatives by A_ab, a n + b their place."""

    Phi: Float[np.ndarray, "time n n"]
    W: Float[np.ndarray, "time n n"]
    Phi_by_A: Float[np.ndarray, "time n*n n n"]
    W_by_A: Float[np.ndarray, "time n*n n n"]


def transitions_of(
    A: Float[np.ndarray, "n n"], times: Float[np.ndarray, " time"]
) -> TransitionMaps:
    """Φ, W and their derivatives at times, seconds.

    Examples
    --------
    >>> transitions_of(np.array([[0.0]]), np.array([2.0])).W_by_A.ravel()
    array([2.])
    """
    from scipy.linalg import expm

    n = len(A)
    size = 2 * n
    joint = np.zeros((times.size, n * n, 2 * size, 2 * size))
    for place in (0, size):
        joint[..., place : place + n, place : place + n] = A
        joint[..., place : place + n, place + n : place + size] = np.eye(n)
    a, b = np.divmod(np.arange(n * n), n)
    joint[:, np.arange(n * n), a, size + b] = 1.0
    with np.errstate(all="ignore"):  # of a trial far out e^{Aτ} overflows: it is no maximum
        E = expm(joint * times[:, None, None, None])
    whole = E[:, 0, :size, :size]
    moved = E[:, :, :size, size:]
    return TransitionMaps(
        whole[:, :n, :n], whole[:, :n, n:], moved[..., :n, :n], moved[..., :n, n:]
    )


def plain_transitions(
    A: Float[np.ndarray, "many n n"], times: Float[np.ndarray, " time"]
) -> tuple[Float[np.ndarray, "many time n n"], Float[np.ndarray, "many time n n"]]:
    """Φ and W of many matrices at times."""
    many, n = A.shape[:2]
    mode, unit = np.repeat(np.arange(many), times.size), np.tile(np.eye(n), (many, 1, 1))
    each = discretise_all(np.ascontiguousarray(A), unit, mode, np.tile(times, many))
    Phi, W = (one.reshape(many, times.size, n, n) for one in each)
    return Phi, W


def nodes_of(longest: float, rate: float) -> Float[np.ndarray, " node"]:
    """Times in [0, longest] between which Φ and W of |A| = `rate` are interpolated to round-off.

    Chebyshev's points; the coefficients of e^{aτ} fall as a^k/k!.
    """
    count = 16 + int(np.ceil(1.5 * rate * longest))
    angle = np.pi * np.arange(count) / (count - 1)
    return 0.5 * longest * (1.0 - np.cos(angle))


def interpolation(
    nodes: Float[np.ndarray, " node"], times: Float[np.ndarray, " time"]
) -> Float[np.ndarray, "time node"]:
    """Weights of the values at nodes (Berrut and Trefethen, SIAM Review 46(3), 2004).

    Examples
    --------
    >>> nodes = nodes_of(1.0, 1.0)
    >>> weights = interpolation(nodes, np.array([0.3]))
    >>> (weights @ np.exp(nodes) / np.exp(0.3)).round(12)
    array([1.])
    """
    sign = (-1.0) ** np.arange(nodes.size)
    sign[[0, -1]] *= 0.5
    apart = times[:, None] - nodes
    at = apart == 0.0
    weight = sign / np.where(at, 1.0, apart)
    weight = np.where(at.any(axis=1, keepdims=True), at.astype(float), weight)
    return weight / weight.sum(axis=1, keepdims=True)
