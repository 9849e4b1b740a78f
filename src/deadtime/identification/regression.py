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
from jaxtyping import Bool, Float, Int

from deadtime.identification.log.recording import Part
from deadtime.identification.parameters import Layout, Vector
from deadtime.identification.scoring import Evaluation
from deadtime.identification.transition import transitions_of

_BLOCK = 4_000_000  # numbers of a log that are stacked at a time
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


class LagRoots(NamedTuple):
    """An evenly sampled log, as roots over x_{k+1}, x_k and u_{k−low}, …, u_{k−high} per mode.

    With a constant term a column of ones comes last.
    """

    root: list[Float[np.ndarray, "z z"]]
    periods: Int[np.ndarray, " mode"] | Float[np.ndarray, " mode"]
    low: int
    high: int

    def columns(self, n: int, m: int, lags: Int[np.ndarray, " m"]) -> Int[np.ndarray, " m"]:
        """Where u_{k−l} of every input lies."""
        return 2 * n + (lags - self.low) * m + np.arange(m)


def rows_of(part: Part, low: int, high: int, within: bool) -> np.ndarray:
    """The periods k of a part that can be used: all that acts in them is known.

    `within`: whether the mode may change at any time, so that of a period that begins and ends in
    other modes nothing is known.
    """
    good, count = known_ends(part, within), part.time.size - 1
    if not part.rests:
        good[: min(high, count)] = False
    lost = np.concatenate(([0], np.cumsum(~np.isfinite(part.input).all(axis=1))))
    k = np.flatnonzero(good)
    return k[lost[np.maximum(k - low + 1, 0)] == lost[np.maximum(k - high, 0)]]


def known_ends(part: Part, within: bool) -> Bool[np.ndarray, " period"]:
    """Whether states at both ends of a period are known, and the mode in it: see `rows_of`."""
    known = np.asarray(np.isfinite(part.output).all(axis=1))
    good = known[:-1] & known[1:]
    return good & (part.mode[:-1] == part.mode[1:]) if within else good


def inputs_at(part: Part, rows: Int[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape m"]:
    """The inputs of rows of a part; before its first row that one's if it rests, else NaN."""
    u = part.input[np.maximum(rows, 0)]
    return u if part.rests or not (rows < 0).any() else np.where(rows[..., None] < 0, np.nan, u)


def stacked(part: Part, k: np.ndarray, low: int, high: int, constant: bool) -> np.ndarray:
    """z = (x_{k+1}, x_k, u_{k−low}, …, u_{k−high}) of periods, and 1 for a constant term."""
    lags = np.arange(low, high + 1)
    u = inputs_at(part, k[:, None] - lags).reshape(k.size, lags.size * part.input.shape[1])
    return np.hstack((part.output[k + 1], part.output[k], u, np.ones((k.size, int(constant)))))


def lags_of(
    parts: tuple[Part, ...], layout: Layout, low: int, high: int, within: bool, root: bool = True
) -> LagRoots:
    """The sums of a log, in blocks; as a Gram matrix in place of its root where `root` is False."""
    size = 2 * layout.n + (high - low + 1) * layout.m + layout.constant
    sums = [np.zeros((0 if root else size, size)) for _ in range(layout.modes)]
    counts, block = np.zeros(layout.modes, np.int64), max(size, _BLOCK // size)
    for part in parts:
        rows = rows_of(part, low, high, within)
        for start in range(0, rows.size, block):
            k = rows[start : start + block]
            z = stacked(part, k, low, high, layout.constant)
            for i in np.unique(part.mode[k]):
                own = z[part.mode[k] == i]
                counts[i] += len(own)
                if root:
                    sums[i] = np.linalg.qr(np.vstack((sums[i], own)), mode="r")
                else:
                    sums[i] += own.T @ own
    return LagRoots(sums, counts, low, high)


def even_terms(
    lags: LagRoots, layout: Layout, step: float, cells: Int[np.ndarray, "mode m"], theta: np.ndarray
) -> list[Term]:
    """The regressions of evenly sampled logs; input j of mode i is read in cell N of its delay.

    x_{k+1} = Φ(h) x_k + Σ_j [(W(h) − W(s_j)) b_j u_{j,k−N} + W(s_j) b_j u_{j,k−N+1}] + W(h) c
              + w_k,
    s_j = N h − D_j:    u_{k−N} acts until D_j − (N − 1) h, and u_{k−N+1} after it
    """
    A, B, delays = layout.split(theta)
    n, m, terms = layout.n, layout.m, []
    for i in range(layout.modes):
        P, by_P = period_weights(A[i], B[i], cells[i] * step - delays[i], step)
        place = np.concatenate((layout.of_A[i].ravel(), layout.of_B[i].ravel(), layout.of_delay[i]))
        read = [lags.columns(n, m, cells[i]), lags.columns(n, m, cells[i] - 1)]
        ones = np.arange(lags.root[i].shape[1])[-1:] if layout.constant else np.zeros(0, int)
        root = lags.root[i][:, np.concatenate((np.arange(2 * n), *read, ones))]
        terms.append(Term(root, lags.periods[i].item(), P, by_P, place))
    return terms


def period_weights(
    A: Float[np.ndarray, "n n"],
    B: Float[np.ndarray, "n acting"],
    rest: Float[np.ndarray, " m"],
    step: float,
) -> tuple[Float[np.ndarray, "n r"], Float[np.ndarray, "own n r"]]:
    """What a period makes of x_k, u_{k−N} and u_{k−N+1}, and of 1; with its derivatives.

    rest : s_j = N h − D_j, how long the newer input acts, seconds. Derivatives are by A, B, and D.
    """
    (n, acting), m = B.shape, rest.size
    over, width = transitions_of(A, np.append(rest, step)), n + m + acting
    P, by_P = np.zeros((n, width)), np.zeros((n * n + n * acting + m, n, width))
    P[:, :n], by_P[: n * n, :, :n] = over.Phi[-1], over.Phi_by_A[-1]
    for j in range(m):
        b, own, old, new = B[:, j], over.W[j], n + j, n + m + j
        whole = over.W[-1] - own
        P[:, old], P[:, new] = whole @ b, own @ b
        by_P[: n * n, :, new] = over.W_by_A[j] @ b
        by_P[: n * n, :, old] = over.W_by_A[-1] @ b - by_P[: n * n, :, new]
        of_b = n * n + np.arange(n) * acting + j
        by_P[of_b, :, old], by_P[of_b, :, new] = whole.T, own.T
        by_P[n * n + n * acting + j, :, old] = over.Phi[j] @ b
        by_P[n * n + n * acting + j, :, new] = -over.Phi[j] @ b
    if acting > m:  # the constant term
        P[:, -1], by_P[: n * n, :, -1] = over.W[-1] @ B[:, m], over.W_by_A[-1] @ B[:, m]
        by_P[n * n + np.arange(n) * acting + m, :, -1] = over.W[-1].T
    return P, by_P
