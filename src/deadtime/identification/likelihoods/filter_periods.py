"""What leads from each sample to the next, with its derivatives: of a block of samples at a time.

    x_{k+1} = Φ x_k + a_k + w_k,    w_k ~ N(0, Q)

Even periods repeat: Φ, Q and their derivatives are one table for each mode. Of uneven ones each
period has its own, interpolated between nodes to round-off, as in `uneven`.

    ∂Q/∂A_ab = ∫₀^τ (∂Φ W Φᵀ + Φ W ∂Φᵀ) ds

is a corner of the covariance that noise of intensity diag(0, W) adds to [[A, E_ab], [0, A]].
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from deadtime.identification.log.recording import Part
from deadtime.identification.parameters import Layout
from deadtime.identification.regression import period_weights
from deadtime.identification.transition import interpolation, transitions_of
from deadtime.identification.uneven import acting_in
from deadtime.numerics.covariance import noise_covariances


class FilterPeriods(NamedTuple):
    """The periods that lead to samples.

    mode : (T,), and kind : (T,), the row of the next four
    Phi, Q : (kinds, n, n); by_Phi : (kinds, n², n, n) by its mode's A; by_Q : by A and then by L,
    W = L Lᵀ, (kinds, n² + n (n + 1)/2, n, n)
    added : (T, n), what inputs add; by_added : (T, own, n), by A, B and the delays of its mode
    """

    mode: Int[np.ndarray, " T"]
    kind: Int[np.ndarray, " T"]
    Phi: Float[np.ndarray, "kind n n"]
    by_Phi: Float[np.ndarray, "kind a n n"]
    Q: Float[np.ndarray, "kind n n"]
    by_Q: Float[np.ndarray, "kind q n n"]
    added: Float[np.ndarray, "T n"]
    by_added: Float[np.ndarray, "T own n"]


# Of a part's samples, and which of them nothing leads to
PeriodsOf = Callable[[Part, Int[np.ndarray, " T"], Bool[np.ndarray, " T"]], FilterPeriods]


def even_periods(
    layout: Layout,
    theta: Float[np.ndarray, " size"],
    L: Float[np.ndarray, "n n"],
    cells: Int[np.ndarray, "mode m"],
    step: float,
) -> PeriodsOf:
    """Those of evenly sampled logs, with delays in given cells."""
    A, B, delays = layout.split(theta)
    n, modes = layout.n, range(layout.modes)
    weights = [period_weights(A[i], B[i], cells[i] * step - delays[i], step) for i in modes]
    P, by_P = (np.array(one) for one in zip(*weights, strict=True))
    noise = [noise_tables(A[i], L, np.array([step])) for i in modes]
    Q, by_Q = (np.concatenate(one) for one in zip(*noise, strict=True))
    tables = P[:, :, :n].copy(), by_P[:, : n * n, :, :n].copy(), Q, by_Q

    def periods(part: Part, rows: np.ndarray, _: np.ndarray) -> FilterPeriods:
        before = np.maximum(rows - 1, 0)
        mode, z = part.mode[before], acting_evenly(part, before, cells, layout.constant)
        added, by_added = np.zeros((rows.size, n)), np.zeros((rows.size, by_P.shape[1], n))
        for i in np.unique(mode):
            own = np.flatnonzero(mode == i)
            added[own] = z[own] @ P[i, :, n:].T
            by_added[own] = np.tensordot(z[own], by_P[i, :, :, n:], (1, 2))
        return FilterPeriods(mode, mode, *tables, added, by_added)

    return periods


def acting_evenly(
    part: Part, k: Int[np.ndarray, " T"], cells: Int[np.ndarray, "mode m"], constant: bool
) -> Float[np.ndarray, "T r"]:
    """u_{k−N} of every input, then u_{k−N+1}, of periods k, and 1 for a constant term.

    Inputs before the log are its first ones: such periods are used where it rests there.
    """
    oldest = k[:, None] - cells[part.mode[k]]
    rows = np.concatenate((oldest, oldest + 1), axis=1)
    u = np.nan_to_num(part.input[np.maximum(rows, 0), np.tile(np.arange(cells.shape[1]), 2)])
    return np.hstack((u, np.ones((k.size, int(constant)))))


def uneven_periods(
    layout: Layout,
    theta: Float[np.ndarray, " size"],
    L: Float[np.ndarray, "n n"],
    nodes: Float[np.ndarray, " node"],
) -> PeriodsOf:
    """Those of logs whose samples may be anywhere."""
    A, B, delays = layout.split(theta)
    n, m, acting, modes = layout.n, layout.m, layout.acting, range(layout.modes)
    over = [transitions_of(A[i], nodes) for i in modes]
    noise = [noise_tables(A[i], L, nodes) for i in modes]
    tables = [(one.Phi, one.Phi_by_A, *own) for one, own in zip(over, noise, strict=True)]
    forced = [(over[i].W @ B[i], over[i].W_by_A @ B[i], over[i].Phi @ B[i]) for i in modes]

    def periods(part: Part, rows: np.ndarray, fresh: np.ndarray) -> FilterPeriods:
        mode = part.mode[np.maximum(rows - 1, 0)]
        found = [np.zeros((rows.size, *one.shape[1:])) for one in tables[0]]
        added, by_added = np.zeros((rows.size, n)), np.zeros((rows.size, n * (n + acting) + m, n))
        for i in np.unique(mode):
            own = np.flatnonzero(~fresh & (mode == i))
            k = rows[own] - 1
            weight = interpolation(nodes, part.time[k + 1] - part.time[k])
            for result, table in zip(found, tables[i], strict=True):
                result[own] = np.tensordot(weight, table, (1, 0))
            held, moved = acting_in(part, k, delays, nodes)
            if layout.constant:
                held = np.concatenate((held, weight[:, :, None]), axis=2)
            steady, by_A, pushed = forced[i]
            added[own] = np.tensordot(held, steady, ((1, 2), (0, 2)))
            by_added[own, : n * n] = np.tensordot(held, by_A, ((1, 2), (0, 3)))
            for j in range(acting):
                by_B = np.tensordot(held[:, :, j], over[i].W.swapaxes(1, 2), (1, 0))
                by_added[own[:, None], n * n + np.arange(n) * acting + j] = by_B
            for j in range(m):
                by_D = -np.tensordot(moved[:, :, j], pushed[:, :, j], (1, 0))
                by_added[own, n * (n + acting) + j] = by_D
        Phi, by_Phi, Q, by_Q = found
        return FilterPeriods(mode, np.arange(rows.size), Phi, by_Phi, Q, by_Q, added, by_added)

    return periods


def noise_tables(
    A: Float[np.ndarray, "n n"], L: Float[np.ndarray, "n n"], times: Float[np.ndarray, " time"]
) -> tuple[Float[np.ndarray, "time n n"], Float[np.ndarray, "time q n n"]]:
    """Q after times, W = L Lᵀ, and its derivatives by A and by the lower triangle of L.

    The diagonal of L is known by its logarithm.

    Examples
    --------
    >>> Q, by_Q = noise_tables(np.zeros((1, 1)), np.array([[2.0]]), np.array([0.5]))
    >>> Q.ravel(), by_Q.ravel()    # W τ, its derivatives W τ² and 2 W τ
    (array([2.]), array([1., 4.]))
    """
    n, count = len(A), times.size
    joint, noise = np.zeros((n * n, 2 * n, 2 * n)), np.zeros((2 * n, 2 * n))
    a, b = np.divmod(np.arange(n * n), n)
    joint[:, :n, :n] = joint[:, n:, n:] = A
    joint[np.arange(n * n), a, n + b] = 1.0
    noise[n:, n:] = L @ L.T
    found = noise_covariances(np.repeat(joint, count, 0), noise, np.tile(times, n * n))
    found = found.reshape(n * n, count, 2 * n, 2 * n).swapaxes(0, 1)
    of_A = found[..., :n, n:] + found[..., n:, :n]
    of_L = []
    for row, column in zip(*(place.tolist() for place in np.tril_indices(n)), strict=True):
        change = np.zeros((n, n))
        change[row] = L[:, column] * (L[row, row] if row == column else 1.0)
        of_L.append(noise_covariances(np.repeat(A[None], count, 0), change + change.T, times))
    return found[:, 0, n:, n:].copy(), np.concatenate((of_A, np.stack(of_L, axis=1)), axis=1)
