"""What white noise does to a linear system: covariances after a while, and their square roots."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import read_only

_ROUND_OFF = 1e-14  # of a variance
_NODES, _PIECES = 8, 512  # of a rule that is exact to round-off over a time constant


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
    return noise_covariances(A[None], W, np.array([tau]))[0]


def noise_covariances(
    A: Float[np.ndarray, "count n n"],
    W: Float[np.ndarray, "*count n n"],
    tau: Float[np.ndarray, " count"],
) -> Float[np.ndarray, "count n n"]:
    """`noise_covariance` of many, of one W or of one each; not finite where e^{Aτ} is not."""
    count, n = A.shape[:2]
    size = np.abs(W).max(axis=(-2, -1), keepdims=True)
    if not size.any():
        return np.zeros(A.shape)
    size = np.where(size > 0.0, size, 1.0)
    with np.errstate(over="ignore", invalid="ignore"):
        span = 2.0 * tau * np.abs(A).sum(axis=1).max(axis=1)
        finite = np.isfinite(span)
        doublings = np.ceil(np.log2(np.maximum(np.where(finite, span, 1.0), 1.0)))
        joint = np.zeros((count, 2 * n, 2 * n))
        joint[:, :n, :n], joint[:, :n, n:], joint[:, n:, n:] = -A, W / size, A.transpose(0, 2, 1)
        joint[~finite] = 0.0
        E = transitions(joint, tau / 2.0**doublings)
        Phi = E[:, n:, n:].transpose(0, 2, 1)
        Q = np.where(finite[:, None, None], Phi @ E[:, :n, n:], np.nan)
        for i in range(int(doublings.max(initial=0.0))):
            on = doublings > i
            P = Phi[on]
            Q[on], Phi[on] = Q[on] + P @ Q[on] @ P.transpose(0, 2, 1), P @ P
        return 0.5 * size * (Q + Q.transpose(0, 2, 1))


def switched_covariances(
    A: Float[np.ndarray, "mode n n"], W: Float[np.ndarray, "mode n n"], tau: float
) -> Float[np.ndarray, "mode mode n n"]:
    """What noise of intensity W_σ adds in τ seconds that begin in mode i and end in mode j.

        Q_ij = (1/τ) ∫₀^τ (e^{A_j s} Q_i(τ − s) e^{A_jᵀ s} + Q_j(s)) ds

    is the mean over s, the time spent in j, which is spread evenly. By Gauss and Legendre's rule on
    pieces of [0, τ] over which e^{As} changes by a factor of about e, of which there are at most
    512: what decays faster than that has gone.

    Examples
    --------
    >>> A, W = np.zeros((2, 1, 1)), np.array([[[1.0]], [[3.0]]])
    >>> switched_covariances(A, W, 0.5)[..., 0, 0].round(9)
    array([[0.5, 1. ],
           [1. , 1.5]])
    """
    from deadtime.numerics.accumulated import rates

    modes, n, _ = A.shape
    pieces = int(np.clip(np.ceil(rates(A).max() * tau), 1, _PIECES))
    nodes, share = np.polynomial.legendre.leggauss(_NODES)
    s = (np.arange(pieces)[:, None] + 0.5 * (1.0 + nodes)).ravel() * (tau / pieces)
    share = np.tile(0.5 * share / pieces, pieces)
    many = np.repeat(A, s.size, axis=0), np.tile(s, modes)
    Phi = transitions(*many).reshape(modes, s.size, n, n)
    Q = noise_covariances(many[0], np.repeat(W, s.size, axis=0), many[1]).reshape(Phi.shape)
    result = np.empty((modes, modes, n, n))
    for i, j in np.ndindex(modes, modes):
        # Nodes lie symmetrically: those of τ − s are those of s, read backwards.
        moved = Phi[j] @ Q[i, ::-1] @ Phi[j].transpose(0, 2, 1) + Q[j]
        result[i, j] = np.tensordot(share, 0.5 * (moved + moved.transpose(0, 2, 1)), 1)
    return result


def transition(A: Float[np.ndarray, "n n"], tau: float) -> Float[np.ndarray, "n n"]:
    """e^{Aτ}."""
    return transitions(A[None], np.array([tau]))[0]


def transitions(
    A: Float[np.ndarray, "count n n"], tau: Float[np.ndarray, " count"]
) -> Float[np.ndarray, "count n n"]:
    """e^{Aτ} of many."""
    from deadtime.numerics.exponential import discretise_each

    none = np.zeros((*A.shape[:2], 1))
    return discretise_each(read_only(A), read_only(none), read_only(tau))[0]


def square_root(Q: Float[np.ndarray, "*many n n"]) -> Float[np.ndarray, "*many n n"]:
    """L with L Lᵀ = Q, Q positive semidefinite up to round-off, whatever the units of its rows."""
    unit = np.sqrt(np.diagonal(Q, axis1=-2, axis2=-1))
    scale = np.where(unit > 0.0, unit, 1.0)
    values, vectors = np.linalg.eigh(Q / (scale[..., :, None] * scale[..., None, :]))
    return unit[..., :, None] * vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]


def lower_root(Q: Float[np.ndarray, "*many n n"]) -> Float[np.ndarray, "*many n n"]:
    """Cholesky's L, L Lᵀ = Q, which moves little where Q does; a Q that is singular has one, too.

    Q is positive semidefinite up to round-off, whatever the units of its rows. Of a row that those
    before it determine up to 1e-14 of itself, nothing else is left.

    Examples
    --------
    >>> lower_root(np.array([[4.0, 2.0], [2.0, 2.0]])), lower_root(np.ones((2, 2)))
    (array([[2., 0.],
           [1., 1.]]), array([[1., 0.],
           [1., 0.]]))
    """
    unit = np.sqrt(np.diagonal(Q, axis1=-2, axis2=-1))
    scale = np.where(unit > 0.0, unit, 1.0)
    C = Q / (scale[..., :, None] * scale[..., None, :])
    L = np.zeros(Q.shape)
    for j in range(Q.shape[-1]):
        rest = C[..., j:, j] - (L[..., j:, :j] * L[..., j : j + 1, :j]).sum(axis=-1)
        spent = rest[..., :1] <= _ROUND_OFF  # not where it is no number, for that is to be seen
        root = np.sqrt(np.where(spent, 1.0, rest[..., :1]))
        L[..., j:, j] = np.where(spent, 0.0, rest / root)
    return unit[..., :, None] * L
