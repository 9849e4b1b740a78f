"""Transition matrices and noise covariances of a plant over a time τ, and their derivatives by A.

    Φ(τ) = e^{Aτ},   W(τ) = ∫₀^τ e^{As} ds,   ∂Φ/∂A_ab, ∂W/∂A_ab

Both are in exp τ[[A, I], [0, 0]], and the derivative of an exponential in the direction E is the
corner of exp[[Z, E], [0, Z]] (Van Loan, IEEE Trans. Automat. Control 23(3), 1978). Likewise

    ∂Q/∂A_ab = ∫₀^τ (∂Φ W Φᵀ + Φ W ∂Φᵀ) ds,    Q(τ) = ∫₀^τ Φ W Φᵀ ds

is a corner of the covariance that noise of intensity diag(0, W) adds to [[A, E_ab], [0, A]].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.identification.parameters import Nodes, Square, Squares
from deadtime.numerics.covariance import accumulate, noise_covariances, rates
from deadtime.numerics.exponential import discretise_all


class TransitionMaps(NamedTuple):
    """Φ and W of times, and their derivatives by A_ab, a n + b their place."""

    Phi: Float[np.ndarray, "time n n"]
    W: Float[np.ndarray, "time n n"]
    Phi_by_A: Float[np.ndarray, "time n*n n n"]
    W_by_A: Float[np.ndarray, "time n*n n n"]


def transitions_of(
    A: Square, times: Float[np.ndarray, " time"], slopes: bool = True
) -> TransitionMaps:
    """Φ, W and their derivatives at times, seconds; without `slopes` none of these.

    Examples
    --------
    >>> transitions_of(np.array([[0.0]]), np.array([2.0])).W_by_A.ravel()
    array([2.])
    """
    from scipy.linalg import expm

    n, size = len(A), 2 * len(A)
    if not slopes:
        Phi, W = (one[0] for one in plain_transitions(A[None], times))
        return TransitionMaps(Phi, W, *np.empty((2, times.size, 0, n, n)))
    # [[A, I], [0, 0]] twice on the diagonal; above it the direction E_ab, one a matrix.
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


def nodes_of(longest: float, rate: float) -> Nodes:
    """Times in [0, longest] between which Φ and W of |A| = `rate` are interpolated to round-off.

    Chebyshev's points; the coefficients of e^{aτ} fall as a^k/k!.
    """
    count = 16 + int(np.ceil(1.5 * rate * longest))
    angle = np.pi * np.arange(count) / (count - 1)
    return 0.5 * longest * (1.0 - np.cos(angle))


def interpolation(
    nodes: Nodes, times: Float[np.ndarray, " time"]
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


def noise_tables(
    A: Square, L: Square, times: Float[np.ndarray, " time"], slopes: bool = True
) -> tuple[Float[np.ndarray, "time n n"], Float[np.ndarray, "time q n n"]]:
    """Q after times, W = L Lᵀ, and its derivatives by A and by the lower triangle of L.

    The diagonal of L is known by its logarithm. Without `slopes` there are no derivatives.

    Examples
    --------
    >>> Q, by_Q = noise_tables(np.zeros((1, 1)), np.array([[2.0]]), np.array([0.5]))
    >>> Q.ravel(), by_Q.ravel()    # W τ, its derivatives W τ² and 2 W τ
    (array([2.]), array([1., 4.]))
    """
    n, count = len(A), times.size
    if not slopes:
        return noise_covariances(A[None], L @ L.T, times), np.empty((count, 0, n, n))
    # The noise of [[A, E_ab], [0, A]] is in the second half, so the corner of its covariance is the
    # effect through E_ab; that of diag(A, A) with δL Lᵀ in the corner is the effect of δL.
    (a, b), (row, column), of_A = np.indices((n, n)).reshape(2, -1), np.tril_indices(n), n * n
    joint, noise = np.zeros((2, of_A + row.size, 2 * n, 2 * n))
    joint[:, :n, :n] = joint[:, n:, n:] = A
    joint[np.arange(of_A), a, n + b] = 1.0
    noise[:, n:, n:] = L @ L.T
    unit = np.where(row == column, np.diagonal(L)[row], 1.0)
    noise[of_A + np.arange(row.size), row, n:] = unit[:, None] * L[:, column].T
    noise[of_A:, n:, :n] = noise[of_A:, :n, n:].swapaxes(1, 2)
    many, rate = len(joint), rates(A[None]).repeat(len(joint))
    mode = np.indices((many, count))[0].reshape(-1, 1)
    with np.errstate(over="ignore", invalid="ignore"):
        Q = accumulate(joint, noise, rate, mode, np.tile(times, many)[:, None])[1]
    Q = Q.reshape(-1, count, 2 * n, 2 * n).swapaxes(0, 1)
    return Q[:, 0, n:, n:].copy(), Q[..., :n, n:] + Q[..., n:, :n]


def continuous(A: Squares, S: Squares, step: float) -> Squares:
    """W of which a period makes S = ∫₀^h e^{As} W e^{Aᵀs} ds, mode by mode, positive semidefinite.

    Examples
    --------
    >>> W = continuous(np.array([[[-1.0]]]), np.array([[[0.5 * (1.0 - np.exp(-0.4))]]]), 0.2)
    >>> W.round(12)
    array([[[1.]]])
    """
    result = np.empty(S.shape)
    for i, one in enumerate(A):
        W = np.linalg.lstsq(_images(one, step), S[i].ravel(), rcond=None)[0].reshape(one.shape)
        values, vectors = np.linalg.eigh(0.5 * (W + W.T))
        W = (vectors * np.maximum(values, 0.0)) @ vectors.T
        result[i] = 0.5 * (W + W.T)  # symmetric to the last bit
    return result


def _images(A: Square, step: float) -> Float[np.ndarray, "nn nn"]:
    """The matrix of the linear map from a symmetric W to S, both row by row."""
    n = len(A)
    units = np.eye(n * n).reshape(n * n, n, n)
    units = 0.5 * (units + units.transpose(0, 2, 1))
    S = noise_covariances(np.repeat(A[None], n * n, axis=0), units, np.full(n * n, step))
    return S.reshape(n * n, n * n).T


def intensity_errors(
    A: Squares, W: Squares, step: float, spare: Int[np.ndarray, " mode"]
) -> Float[np.ndarray, " variance"]:
    """The standard errors of the diagonals of W, mode by mode, from `spare` periods of each.

    W_aa is linear in S, Σ G_bc S_bc, and S is Wishart's: its variance is 2 tr(G S G S) / spare. So
    W of a position has an error even if it is 0, because noise of the speed enters S of a position.

    Examples
    --------
    >>> A, W = np.array([[[0.0, 1.0], [0.0, 0.0]]]), np.array([np.diag([0.0, 3.0])])
    >>> (intensity_errors(A, W, 0.1, np.array([200])) * [1000.0, 1.0]).round(3)
    array([0.354, 0.3  ])
    """
    modes, n, _ = A.shape
    errors, S = np.empty((modes, n)), noise_covariances(A, W, np.full(modes, step))
    for i, one in enumerate(A):
        G = np.linalg.pinv(_images(one, step))[:: n + 1].reshape(n, n, n)
        GS = 0.5 * (G + G.transpose(0, 2, 1)) @ S[i]
        errors[i] = np.sqrt(2.0 * np.einsum("abc,acb->a", GS, GS) / spare[i])
    return errors.ravel()
