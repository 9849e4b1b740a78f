"""What outputs are is told by what they were: A of their chains, whatever the delays.

With x the states of `Embedding`, stand-ins for them are outputs that are q periods apart,

    z_k = (y_j,k, y_j,k−q, …, y_j,k−(n_j−1)q),    all outputs j,
    z_{k+q} = M z_k + what inputs add, linear in all those since row k − (n_j − 1) q − lag.

Of M a row for each output is unknown. z has the sensors' noise, as z_{k+q} has, so a row is what is
least between both, once inputs are taken out of them: total least squares (Golub and Van Loan, SIAM
J. Numerical Analysis 17(6), 1980), which tends to the truth where the plant has no noise. It needs
not know B nor delays. log M / (q h) is A in the states z, and the rows C_j A^a, a < n_j, take it to
the chains. Fast poles want a small q, slow ones a large one, by which noise matters less.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from deadtime.identification.likelihoods.embedding import Embedding
from deadtime.identification.log.recording import Part
from deadtime.identification.start import matrix_logarithm

_ENOUGH = 2.0  # rows for each unknown
_GROWTH = 10.0  # of a state from z_k to z_{k+q}: nobody logs a plant that grows faster


def chains_by_past(
    parts: tuple[Part, ...],
    shape: Embedding,
    deviation: Float[np.ndarray, " p"],
    step: float,
    lag: int,
    modes: int,
    apart: int,
) -> Float[np.ndarray, "mode n n"] | None:
    """A of evenly sampled outputs; None if rows within a mode are too few, or tell no plant.

    deviation : about, of the sensors; step : between rows, seconds
    lag : so many periods late inputs may act; apart : q, periods

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> y, u = np.zeros((99, 1)), rng.standard_normal((99, 1))
    >>> for k in range(2, 98):
    ...     y[k + 1] = 0.5 * y[k] + u[k - 2]
    >>> part = Part(0.1 * np.arange(99), y, u, np.zeros(99, np.int64))
    >>> shape = Embedding((1,), False, np.ones(1))
    >>> chains_by_past((part,), shape, np.ones(1), 0.1, 4, 1, 2).round(4)  # log 0.5 / 0.1
    array([[[-6.9315]]])
    """
    rows = [_rows(part, shape, lag, apart) for part in parts]
    mode, y, z, u = (np.concatenate(column) for column in zip(*rows, strict=True))
    scale, found = np.repeat(deviation, shape.order), []
    for i in range(modes):
        own = mode == i
        if np.count_nonzero(own) < _ENOUGH * (u.shape[1] + z.shape[1]):
            return None
        basis = np.linalg.qr(u[own])[0]
        now, past = (a - basis @ (basis.T @ a) for a in (y[own] / deviation, z[own] / scale))
        M = _transition(now, past, shape)
        if not np.isfinite(M).all() or np.abs(np.linalg.eigvals(M)).max() > _GROWTH:
            return None
        F = matrix_logarithm(M * scale[:, None] / scale) / (apart * step)
        found.append(_in_chains(F, shape))
    return np.array(found)


def _rows(
    part: Part, shape: Embedding, lag: int, apart: int
) -> tuple[Int[np.ndarray, " row"], np.ndarray, np.ndarray, np.ndarray]:
    """The mode, outputs, z_k, inputs and 1, of rows that stay in a mode, all of them known."""
    before = (max(shape.order) - 1) * apart
    k = np.arange(before + lag, len(part.output) - apart)
    z = [part.output[k - a * apart, j] for j, n in enumerate(shape.order) for a in range(n)]
    y, z = part.output[k + apart], np.column_stack(z)
    lags = np.arange(before + apart + lag)
    u = part.input[k[:, None] + apart - 1 - lags].reshape(k.size, lags.size * part.input.shape[1])
    u = np.hstack((u, np.ones((k.size, 1))))
    changes = np.concatenate(([0], np.cumsum(part.mode[1:] != part.mode[:-1])))
    own = np.isfinite(np.hstack((y, z, u))).all(axis=1)
    own &= changes[k + apart] == changes[k - before]
    return part.mode[k][own], y[own], z[own], u[own]


def _transition(
    now: Float[np.ndarray, "row p"], past: Float[np.ndarray, "row n"], shape: Embedding
) -> Float[np.ndarray, "n n"]:
    """M, by which z_k becomes z_{k+q}."""
    M = np.eye(past.shape[1], k=-1)
    for j, row in enumerate(shape.C.argmax(axis=1)):
        both = np.column_stack((past, now[:, j]))
        least = np.linalg.svd(both, full_matrices=False)[2][-1]
        with np.errstate(divide="ignore", invalid="ignore"):
            M[row] = -least[:-1] / least[-1]
    return M


def _in_chains(F: Float[np.ndarray, "n n"], shape: Embedding) -> Float[np.ndarray, "n n"]:
    """F, of states that begin with outputs, in the states of the embedding."""
    powers = [np.linalg.matrix_power(F, a) for a in range(max(shape.order))]
    T = np.array([shape.C[j] @ powers[a] for j, n in enumerate(shape.order) for a in range(n)])
    A = shape.shift()
    A[shape.last] = np.linalg.lstsq(T.T, (T @ F)[shape.last].T, rcond=1e-12)[0].T
    return A
