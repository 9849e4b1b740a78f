"""Linear systems under white noise: transitions and covariances, and square roots of these.

Over a piece of τ seconds dx/dt = J x + w, E[w(t) w(s)ᵀ] = W δ(t − s), has the transition Φ and adds
the covariance Q,

    Φ = Σ_k (Jτ)ᵏ/k!,    Q = Σ_k S_k τ^{k+1},    S_0 = W,  (k + 2) S_{k+1} = J S_k + S_k Jᵀ.

The series are about τ = 0, so that short pieces have full relative precision; their coefficients
are the same for all pieces. A long piece is halved until the series converge fast, then doubled,
Φ(2τ) = Φ², Q(2τ) = Q + Φ Q Φᵀ: a sum of positive terms, without cancellation. Consecutive pieces
are composed likewise. Many pieces are compiled, which takes a third of NumPy's time, with bitwise
equal results.
"""

from __future__ import annotations

import functools
import math

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import read_only
from deadtime.numerics.exponential import (
    ROUND_OFF,
    balanced,
    discretise_each,
    product,
    products,
)
from deadtime.numerics.kernels import kernel

_MANY = 100_000  # numbers in the arguments from which compiling pays
_LONGEST = 1100  # doublings: more than the exponents of doubles


def accumulate(
    J: Float[np.ndarray, "mode N N"],
    W: Float[np.ndarray, "*mode N N"] | None,
    rate: Float[np.ndarray, " mode"],
    mode: Int[np.ndarray, "count piece"],
    tau: Float[np.ndarray, "count piece"],
) -> tuple[Float[np.ndarray, "count N N"], Float[np.ndarray, "count N N"]]:
    """Transition M and covariance Q over stretches of pieces, tau seconds (0 for none) in a mode.

    `rate` (1/s) is the norm of J in units in which it is balanced; W is one matrix or one per mode,
    None for no noise.

    Examples
    --------
    >>> J, W = np.array([[[0.0, 1.0], [0.0, 0.0]]]), np.diag([0.0, 3.0])
    >>> pieces = np.zeros((1, 2), np.int64), np.array([[0.5, 1.5]])
    >>> M, Q = accumulate(J, W, np.ones(1), *pieces)
    >>> M[0].round(9), Q[0].round(9)
    (array([[1., 2.],
           [0., 1.]]), array([[8., 6.],
           [6., 6.]]))
    """
    size = np.where(rate > 0.0, rate, 1.0)
    longest = float((size[mode] * tau).max(initial=0.0))
    Phi, S = _terms(J, np.zeros(J.shape[1:]) if W is None else W, size, min(longest, 0.5))
    M, Q = np.empty((2, len(tau), *J.shape[1:]))
    given = np.array(mode, np.int64), np.array(tau, float)  # the kernel is compiled for one type
    with np.errstate(over="ignore", invalid="ignore"):
        _follow(Phi, S, size, *given, W is not None, M, Q)
    return M, Q


def rates(A: Float[np.ndarray, "mode n n"]) -> Float[np.ndarray, " mode"]:
    """The norms of A, 1/s, in units in which it is balanced."""
    return balanced(np.ascontiguousarray(A))[1]


def _terms(
    J: np.ndarray, W: np.ndarray, size: np.ndarray, longest: float
) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of Φ and Q in s = size·τ ≤ `longest`, (mode, term, N, N), the highest last."""
    N, J = J.shape[1], J / size[:, None, None]
    # |S_k| grows as (2 size)ᵏ/(k + 1)!, because J acts on both sides.
    count = next(k for k in range(2, 60) if (2.0 * longest) ** k / math.factorial(k) < ROUND_OFF)
    Phi, S = np.empty((2, len(J), count + 2, N, N))
    Phi[:, 0], S[:, 0] = np.eye(N), W / size[:, None, None]
    for k in range(1, count + 2):
        Phi[:, k] = Phi[:, k - 1] @ J / k
        half = J @ S[:, k - 1]
        S[:, k] = (half + half.transpose(0, 2, 1)) / (k + 1)
    return Phi, S


def _follow_by_numpy(Phi, S, size, mode, tau, noisy, M, Q):
    """`_follow` by array operations on all stretches, which are in the last axis."""
    N = M.shape[1]
    moved = np.repeat(np.eye(N)[:, :, None], len(tau), axis=2)
    added = np.zeros(moved.shape)
    for p in range(tau.shape[1]):
        (on,) = np.nonzero(tau[:, p] > 0.0)
        a, s = mode[on, p], size[mode[on, p]] * tau[on, p]
        doublings = np.zeros(on.size, np.int64)
        # An infinite s would be halved without end but for the limit.
        while (long := (s > 0.5) & (doublings < _LONGEST)).any():
            s[long] *= 0.5
            doublings[long] += 1
        P, R = _horner(Phi, a, s), _horner(S, a, s) * s if noisy else np.zeros((N, N, on.size))
        for i in range(int(doublings.max(initial=0))):
            (more,) = np.nonzero(doublings > i)
            own = P[:, :, more]
            if noisy:
                R[:, :, more] += _congruence_all(own, R[:, :, more])
            P[:, :, more] = products(own, own)
        if noisy:
            added[:, :, on] = _congruence_all(P, added[:, :, on]) + R
        moved[:, :, on] = products(P, moved[:, :, on])
    M[:], Q[:] = moved.transpose(2, 0, 1), added.transpose(2, 0, 1)


def _horner(terms: np.ndarray, mode: np.ndarray, s: np.ndarray) -> np.ndarray:
    highest, *lower = terms[mode].transpose(1, 2, 3, 0)[::-1]
    return functools.reduce(lambda value, term: value * s + term, lower, highest)


def _congruence_all(P: np.ndarray, R: np.ndarray) -> np.ndarray:
    return products(products(P, R), P.transpose(1, 0, 2))


@kernel(nogil=True, plain=_follow_by_numpy, large=_MANY)
def _follow(Phi, S, size, mode, tau, noisy, M, Q):
    """Fill M and Q of every stretch; the other arguments are those of `_follow_by_numpy`."""
    N = Phi.shape[2]
    P, R, half, spare = np.empty((N, N)), np.zeros((N, N)), np.empty((N, N)), np.empty((N, N))
    for e in range(tau.shape[0]):
        for i in range(N):
            for j in range(N):
                M[e, i, j] = 1.0 if i == j else 0.0
                Q[e, i, j] = 0.0
        for p in range(tau.shape[1]):
            if tau[e, p] <= 0.0:
                continue
            a, s, doublings = mode[e, p], size[mode[e, p]] * tau[e, p], 0
            while s > 0.5 and doublings < _LONGEST:
                s *= 0.5
                doublings += 1
            _horner_into(Phi, a, s, 1.0, P)
            if noisy:
                _horner_into(S, a, s, s, R)
            for _ in range(doublings):
                if noisy:
                    _congruence(P, R, half, spare)
                    for i in range(N):
                        for j in range(N):
                            R[i, j] += spare[i, j]
                product(P, P, spare)
                for i in range(N):
                    for j in range(N):
                        P[i, j] = spare[i, j]
            if noisy:
                _congruence(P, Q[e], half, spare)
                for i in range(N):
                    for j in range(N):
                        Q[e, i, j] = spare[i, j] + R[i, j]
            product(P, M[e], spare)
            for i in range(N):
                for j in range(N):
                    M[e, i, j] = spare[i, j]


@kernel(eager=True, nogil=True)
def _horner_into(terms, a, s, scale, result):
    """result = scale Σ terms[a, k] sᵏ, by Horner's rule."""
    # The loops over entries are the inner ones, on flat arrays, so that they are vectorised.
    value, given = result.reshape(-1), terms.reshape(-1)
    size, last = value.size, terms.shape[1] - 1
    at = (a * (last + 1) + last) * size
    for i in range(size):
        value[i] = given[at + i]
    for _ in range(last):
        at -= size
        for i in range(size):
            value[i] = value[i] * s + given[at + i]
    for i in range(size):
        value[i] *= scale


@kernel(eager=True, nogil=True)
def _congruence(P, R, half, result):
    """result = P R Pᵀ."""
    product(P, R, half)
    for i in range(P.shape[0]):
        for j in range(P.shape[0]):
            total = half[i, 0] * P[j, 0]
            for k in range(1, P.shape[0]):
                total += half[i, k] * P[j, k]
            result[i, j] = total


_SPENT = 1e-14  # share of a variance that counts as round-off
_NODES, _PIECES = 8, 512  # of a Gauss rule, exact to round-off over a time constant


def noise_covariance(
    A: Float[np.ndarray, "n n"], W: Float[np.ndarray, "n n"], tau: float
) -> Float[np.ndarray, "n n"]:
    """Q(τ) = ∫₀^τ e^{As} W e^{Aᵀs} ds: the covariance that noise of intensity W adds in τ seconds.

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
    tau: Float[np.ndarray, " each"],
) -> Float[np.ndarray, "all n n"]:
    """`noise_covariance` of many systems, with one W or one each; not finite where e^{Aτ} is not.

    There are k times for each system, those of a system consecutive in tau.
    """
    mode = np.repeat(np.arange(len(A)), tau.size // len(A))[:, None]
    with np.errstate(over="ignore", invalid="ignore"):
        Q = accumulate(A, W, rates(A), mode, tau[:, None])[1]
        return 0.5 * (Q + Q.transpose(0, 2, 1))


def switched_covariances(
    A: Float[np.ndarray, "mode n n"], W: Float[np.ndarray, "mode n n"], tau: float
) -> Float[np.ndarray, "mode mode n n"]:
    """The covariances that noise W_σ adds in τ seconds that begin in mode i and end in mode j.

        Q_ij = (1/τ) ∫₀^τ (e^{A_j s} Q_i(τ − s) e^{A_jᵀ s} + Q_j(s)) ds

    is the mean over the time s in mode j, which is uniformly distributed. The integral is computed
    by Gauss–Legendre quadrature on pieces of [0, τ] over which e^{As} changes by a factor of about
    e, at most 512: modes that decay faster are negligible.

    Examples
    --------
    >>> A, W = np.zeros((2, 1, 1)), np.array([[[1.0]], [[3.0]]])
    >>> switched_covariances(A, W, 0.5)[..., 0, 0].round(9)
    array([[0.5, 1. ],
           [1. , 1.5]])
    """
    modes, n, _ = A.shape
    pieces = int(np.clip(np.ceil(rates(A).max() * tau), 1, _PIECES))
    nodes, share = np.polynomial.legendre.leggauss(_NODES)
    s = (np.arange(pieces)[:, None] + 0.5 * (1.0 + nodes)).ravel() * (tau / pieces)
    share = np.tile(0.5 * share / pieces, pieces)
    mode = np.repeat(np.arange(modes), s.size)[:, None]
    Phi, Q = accumulate(A, W, rates(A), mode, np.tile(s, modes)[:, None])
    Phi, Q = Phi.reshape(modes, s.size, n, n), Q.reshape(modes, s.size, n, n)
    result = np.empty((modes, modes, n, n))
    for i, j in np.ndindex(modes, modes):
        # The nodes are symmetric: Q_i at τ − s is Q_i at the nodes s in reverse order.
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
    none = np.zeros((*A.shape[:2], 1))
    return discretise_each(read_only(A), read_only(none), read_only(tau))[0]


def square_root(Q: Float[np.ndarray, "*many n n"]) -> Float[np.ndarray, "*many n n"]:
    """L with L Lᵀ = Q, Q positive semidefinite up to round-off, in any units of its rows."""
    # Of the correlations, so that variances of any magnitude keep their relative precision.
    unit = np.sqrt(np.diagonal(Q, axis1=-2, axis2=-1))
    scale = np.where(unit > 0.0, unit, 1.0)
    values, vectors = np.linalg.eigh(Q / (scale[..., :, None] * scale[..., None, :]))
    return unit[..., :, None] * vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]


def lower_root(Q: Float[np.ndarray, "*many n n"]) -> Float[np.ndarray, "*many n n"]:
    """The Cholesky factor L, L Lᵀ = Q, also of a singular Q; it is continuous in Q.

    Q is positive semidefinite up to round-off, in any units of its rows. A row that depends on the
    rows before it up to 1e-14 of its variance has zeros from the diagonal on.

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
        spent = rest[..., :1] <= _SPENT  # False for NaN, which is to propagate
        root = np.sqrt(np.where(spent, 1.0, rest[..., :1]))
        L[..., j:, j] = np.where(spent, 0.0, rest / root)
    return unit[..., :, None] * L
