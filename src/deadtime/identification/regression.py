"""Maximum likelihood where states are measured: what a period adds is noise of any covariance.

    x_{k+1} = P_σ(θ) r_k + w_k,    w ~ N(0, S_σ),    r_k: the state and the inputs that act

The covariance that maximises the likelihood is that of the residuals, so

    log L(θ) = −½ Σ_i N_i (log det S_i(θ) + n (1 + log 2π)),    S_i = Σ e eᵀ / N_i.

All that it asks of the log of mode i is Σ z zᵀ, z = (x_{k+1}, r_k), of which a square root is kept:
the triangular factor of the stacked z, block by block, so that no digit is lost to squaring.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.identification.parameters import Vector
from deadtime.identification.scoring import Evaluation

_APART = 1e-8  # of variances: information to which double precision does not lose another one


class Term(NamedTuple):
    """The regression of one mode.

    root : (rows, n + r), rootᵀ root = Σ z zᵀ
    periods : N_i, or the sum of weights
    P : (n, r), by_P : (unknowns, n, r) its derivatives, place : (unknowns,) whose
    """

    root: Float[np.ndarray, "row z"]
    periods: float
    P: Float[np.ndarray, "n r"]
    by_P: Float[np.ndarray, "own n r"]
    place: Int[np.ndarray, " own"]


def concentrated(terms: list[Term], size: int) -> tuple[Evaluation, Float[np.ndarray, "mode n n"]]:
    """The log likelihood of all modes, and the covariances S_i that it is largest with."""
    value, score, information, covariances = 0.0, np.zeros(size), np.zeros((size, size)), []
    for term in terms:
        count, P, n = term.periods, term.P, len(term.P)
        y, r = term.root[:, :n], term.root[:, n:]
        e = y - r @ P.T
        S = e.T @ e / count
        if not np.isfinite(S).all():  # of a trial far out, whose exponential overflows
            nothing = Evaluation(-np.inf, score, np.eye(size))
            return nothing, np.full((len(terms), n, n), np.nan)
        S = floored(S, P[:, :n], y, count)
        L = np.linalg.cholesky(S)
        add_score(term, e, L, score, information)
        value -= 0.5 * count * (2.0 * np.log(np.diagonal(L)).sum() + n * np.log(2.0 * np.pi * np.e))
        covariances.append(S)
    return Evaluation(value, score, information), np.array(covariances)


def add_score(
    term: Term, e: np.ndarray, L: np.ndarray, score: Vector, information: np.ndarray
) -> None:
    """What residuals e (rows, n) of covariance L Lᵀ tell of P, in place."""
    place, r = term.place, term.root[:, len(L) :]
    white = np.linalg.solve(L, e.T)
    moved = np.linalg.solve(L, term.by_P @ r.T).reshape(len(place), -1)
    score[place] += moved @ white.ravel()
    information[np.ix_(place, place)] += moved @ moved.T


def floored(
    S: Float[np.ndarray, "n n"], Phi: Float[np.ndarray, "n n"], y: np.ndarray, total: float
) -> Float[np.ndarray, "n n"]:
    """The covariance S of residuals of y, of weight `total`, never singular: of no noise, too.

    A state without noise beside noisy ones, or noises that are multiples of each other, would tell
    some combinations of unknowns so well that beside them others are lost to round-off. So each
    state has 1e-4 of the deviation of its noise by itself, and of what Φ − I makes of the others',
    once and again, as noise that acts on dx/dt spreads from state to state.
    """
    M = Phi - np.eye(len(S))
    M /= max(1.0, float(np.abs(np.linalg.eigvals(M)).max()))
    spread, moved = np.diag(np.diagonal(S)), S
    for _ in range(len(S) - 1):
        moved = M @ moved @ M.T
        spread = spread + moved
    least = 1e-24 * (y**2).sum(axis=0) / total + np.finfo(float).tiny
    return S + _APART * spread + np.diag(least)


def log_density(
    z: Float[np.ndarray, "period z"], P: Float[np.ndarray, "n r"], S: Float[np.ndarray, "n n"]
) -> Float[np.ndarray, " period"]:
    """log N(x_{k+1} − P r_k; 0, S) of rows z = (x_{k+1}, r_k)."""
    n, L = len(P), np.linalg.cholesky(S)
    white = np.linalg.solve(L, (z[:, :n] - z[:, n:] @ P.T).T)
    constant = 2.0 * np.log(np.diagonal(L)).sum() + n * np.log(2.0 * np.pi)
    return -0.5 * ((white**2).sum(axis=0) + constant)


def rooted(z: Float[np.ndarray, "period z"], weight: Float[np.ndarray, " period"]) -> np.ndarray:
    """R with RᵀR = Σ w z zᵀ, R triangular."""
    return np.asarray(np.linalg.qr(np.sqrt(weight)[:, None] * z, mode="r"))
