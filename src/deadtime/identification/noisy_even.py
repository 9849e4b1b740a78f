"""The likelihood of an evenly sampled log with noisy sensors: one pass, of bounded memory.

Kalman's filter carries its own derivatives by all unknowns, exact but for those of a period's noise
by A, which are differences of matrices of n². Blocks of samples are summed up as they come.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from deadtime.identification.cells import cells_of
from deadtime.identification.parameters import Layout
from deadtime.identification.recording import Part
from deadtime.identification.regression import period_weights
from deadtime.identification.scoring import Evaluation
from deadtime.identification.tangent_kernel import tangents
from deadtime.numerics.covariance import noise_covariances

_BLOCK = 4096  # samples whose derivatives are kept at a time
_SMALL = 1e-5  # of |A| + 1/h, a step of differences


class Tables(NamedTuple):
    """What a period does in every mode, and its derivatives: see `tangent_kernel.tangents`."""

    Phi: Float[np.ndarray, "mode n n"]
    G: Float[np.ndarray, "mode n r"]
    Q: Float[np.ndarray, "mode n n"]
    moved: Float[np.ndarray, "mode own n z"]
    own: Int[np.ndarray, "mode own"]
    wide: Int[np.ndarray, " q"]
    of_Q: Float[np.ndarray, "mode q n n"]


def acting_evenly(part: Part, cells: Int[np.ndarray, "mode m"]) -> Float[np.ndarray, "sample r"]:
    """u_{k−N} of every input, then u_{k−N+1}, of the period that leads to each sample.

    0 where the log begins later: such periods are not used.
    """
    count, m = part.input.shape
    N = cells[part.mode[:-1]]
    z = np.zeros((count, 2 * m))
    for later in (0, 1):
        row = np.arange(count - 1)[:, None] - N + later
        u = np.take_along_axis(part.input, np.maximum(row, 0), 0)
        z[1:, later * m : (later + 1) * m] = np.where(row >= 0, np.nan_to_num(u), 0.0)
    return z


def moved_evenly(
    part: Part,
    A: Float[np.ndarray, "mode n n"],
    B: Float[np.ndarray, "mode n m"],
    delays: Float[np.ndarray, "mode m"],
    step: float,
    cells: Int[np.ndarray, "mode m"] | None = None,
) -> Float[np.ndarray, "sample n"]:
    """What inputs add in the period that leads to each sample."""
    if cells is None:
        cells = cells_of(delays.ravel(), step).reshape(delays.shape)
    z, n = acting_evenly(part, cells), A.shape[1]
    moved = np.zeros((part.time.size, n))
    kind = part.mode[:-1]
    for i, own in enumerate(kind == j for j in range(len(A))):
        G = period_weights(A[i], B[i], cells[i] * step - delays[i], step)[0][:, n:]
        moved[1:][own] = z[1:][own] @ G.T
    return moved


def tables_of(
    layout: Layout,
    theta: Float[np.ndarray, " size"],
    L: Float[np.ndarray, "n n"],
    cells: Int[np.ndarray, "mode m"],
    step: float,
    sensors: int,
) -> Tables:
    """The tables of a plant and W = L Lᵀ; the diagonal of L is known by its logarithm."""
    A, B, delays = layout.split(theta)
    n, modes = layout.n, layout.modes
    weights = [period_weights(A[i], B[i], cells[i] * step - delays[i], step) for i in range(modes)]
    P, moved = (np.array(one) for one in zip(*weights, strict=True))
    places = (layout.of_A.reshape(modes, -1), layout.of_B.reshape(modes, -1), layout.of_delay)
    rows, columns = np.tril_indices(n)
    wide = np.concatenate((layout.of_A.ravel(), layout.size + np.arange(rows.size + sensors)))
    W, of_Q = L @ L.T, np.zeros((modes, wide.size, n, n))
    time = np.full(2 * n * n, step)
    for i in range(modes):
        size = _SMALL * (np.abs(A[i]).max() + 1.0 / step)
        off = size * np.eye(n * n).reshape(-1, n, n)
        ends = noise_covariances(np.concatenate((A[i] + off, A[i] - off)), W, time)
        at = slice(i * n * n, (i + 1) * n * n)
        of_Q[i, at] = (ends[: n * n] - ends[n * n :]) / (2.0 * size)
    for c, (a, b) in enumerate(zip(rows.tolist(), columns.tolist(), strict=True)):
        change = np.zeros((n, n))
        change[a] = L[:, b] * (L[a, a] if a == b else 1.0)
        of_Q[:, modes * n * n + c] = noise_covariances(A, change + change.T, time[:modes])
    Q = noise_covariances(A, W, time[:modes])
    own = np.concatenate(places, axis=1)
    return Tables(P[:, :, :n].copy(), P[:, :, n:].copy(), Q, moved, own, wide, of_Q)


def evaluate_evenly(
    parts: tuple[Part, ...],
    starts: list[Bool[np.ndarray, " sample"]],
    acting: list[Float[np.ndarray, "sample r"]],
    tables: Tables,
    C: Float[np.ndarray, "p n"],
    R: Float[np.ndarray, " p"],
    P0: Float[np.ndarray, "n n"],
) -> Evaluation:
    """The log likelihood, its score and information, over all unknowns."""
    n, q, p = len(P0), tables.wide.size, len(C)
    size = int(tables.wide[-1]) + 1
    of_R = np.zeros((q, p))
    of_R[q - p :] = np.diag(2.0 * R)
    value, score, F = 0.0, np.zeros(size), np.zeros((size, size))
    fixed = tuple(map(np.ascontiguousarray, (*tables[:3], C, R, *tables[3:], of_R, P0)))
    for part, start, z in zip(parts, starts, acting, strict=True):
        kind = np.concatenate((part.mode[:1], part.mode[:-1]))
        now = np.zeros(n), np.zeros((n, n)), np.zeros((size, n)), np.zeros((q, n, n))
        for first in range(0, start.size, _BLOCK):
            at = slice(first, first + _BLOCK)
            count = start[at].size
            out = tuple(np.empty((count, p, *more)) for more in ((), (), (size,), (q,)))
            tangents(part.output[at], start[at], kind[at], z[at], *fixed, now, out)
            e, s = out[0].ravel(), out[1].ravel()
            if not (s.min() > 0.0 and np.isfinite(s).all() and np.isfinite(e).all()):
                return Evaluation(-np.inf, score, np.eye(size))
            by_e = out[2].reshape(-1, size) / np.sqrt(s)[:, None]
            by_s = out[3].reshape(-1, q) / s[:, None]
            known = np.count_nonzero(np.isfinite(part.output[at]))
            value -= 0.5 * (float((np.log(s) + e * e / s).sum()) + known * np.log(2.0 * np.pi))
            score -= by_e.T @ (e / np.sqrt(s))
            score[tables.wide] += by_s.T @ (0.5 * (e * e / s - 1.0))
            F += by_e.T @ by_e
            F[np.ix_(tables.wide, tables.wide)] += 0.5 * by_s.T @ by_s
    return Evaluation(value, score, F)
