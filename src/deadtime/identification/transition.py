"""Transition matrices and noise covariances of a plant over a time τ, and their derivatives by A.

    Φ(τ) = e^{Aτ} = W₀,   W_{j+1}(τ) = ∫₀^τ W_j(s) ds,   W = W₁,   ∂W_j/∂A_ab

All W_j up to W_q are the first row of blocks of exp τZ, Z = [[A, I, 0], [0, 0, I], [0, 0, 0]] for
q = 2, and the derivative of an exponential in the direction E is the corner of exp[[Z, E], [0, Z]]
(Van Loan, IEEE Trans. Automat. Control 23(3), 1978). Likewise

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
    """Φ and its repeated integrals W_j at times, W_0 = Φ, and their derivatives by A_ab.

    by_A : the third index is a n + b
    """

    integrals: Float[np.ndarray, "integral time n n"]
    by_A: Float[np.ndarray, "integral time nn n n"]

    @property
    def Phi(self) -> Float[np.ndarray, "time n n"]:
        return self.integrals[0]

    @property
    def W(self) -> Float[np.ndarray, "time n n"]:
        return self.integrals[1]

    @property
    def Phi_by_A(self) -> Float[np.ndarray, "time nn n n"]:
        return self.by_A[0]

    @property
    def W_by_A(self) -> Float[np.ndarray, "time nn n n"]:
        return self.by_A[1]


def transitions_of(
    A: Square, times: Float[np.ndarray, " time"], slopes: bool = True, order: int = 1
) -> TransitionMaps:
    """Φ, its integrals up to W_order, and their derivatives at times, seconds.

    Without `slopes` there are no derivatives.

    Examples
    --------
    >>> transitions_of(np.array([[0.0]]), np.array([2.0])).W_by_A.ravel()
    array([2.])
    >>> transitions_of(np.array([[0.0]]), np.array([2.0]), order=2).integrals.ravel()
    array([1., 2., 2.])
    """
    from scipy.linalg import expm

    n, count = len(A), order + 1
    if not slopes:
        integrals = plain_transitions(A[None], times, order)[:, 0]
        return TransitionMaps(integrals, np.empty((count, times.size, 0, n, n)))
    size = count * n
    # The chain twice on the diagonal; above it the direction E_ab, one a matrix.
    joint = np.zeros((times.size, n * n, 2 * size, 2 * size))
    joint[..., :size, :size] = joint[..., size:, size:] = _chain(A, count)
    a, b = np.divmod(np.arange(n * n), n)
    joint[:, np.arange(n * n), a, size + b] = 1.0
    with np.errstate(all="ignore"):  # of a trial far out e^{Aτ} overflows: it is no maximum
        E = expm(joint * times[:, None, None, None])[..., :n, :]
    E = E.reshape(*E.shape[:3], 2, count, n)  # (time, direction, row, half, integral, column)
    return TransitionMaps(
        np.moveaxis(E[:, 0, :, 0], 2, 0).copy(), np.moveaxis(E[:, :, :, 1], 3, 0).copy()
    )


def _chain(A: np.ndarray, count: int) -> np.ndarray:
    """Z of the module, with `count` blocks a row, for one A or many."""
    n = A.shape[-1]
    Z = np.empty((*A.shape[:-2], count * n, count * n))
    Z[:] = np.eye(count * n, k=n)
    Z[..., :n, :n] = A
    return Z


def plain_transitions(
    A: Float[np.ndarray, "many n n"], times: Float[np.ndarray, " time"], order: int = 1
) -> Float[np.ndarray, "integral many time n n"]:
    """Φ and its integrals up to W_order, of many matrices at times."""
    many, n = A.shape[:2]
    size = order * n
    mode, unit = np.repeat(np.arange(many), times.size), np.tile(np.eye(size), (many, 1, 1))
    each = discretise_all(_chain(A, order), unit, mode, np.tile(times, many))
    Phi, W = (one.reshape(many, times.size, size, order, n)[:, :, :n] for one in each)
    # e^{Zτ} has the integrals up to the last but one, its own integral has the last.
    return np.moveaxis(np.concatenate((Phi, W[..., -1:, :]), axis=-2), -2, 0).copy()


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
