"""Kalman's filter of a plant that switches between modes, its derivatives, and back again.

    x_{k+1} = Φ x_k + a_k + w_k,    w_k ~ N(0, Q),    y_k = C x_k + v_k,    v_k ~ N(0, R)

Even periods repeat: Φ, Q and their derivatives are one table for each mode. Of uneven ones each
period has its own, interpolated between nodes to round-off, as in `uneven`.

    ∂Q/∂A_ab = ∫₀^τ (∂Φ W Φᵀ + Φ W ∂Φᵀ) ds

is a corner of the covariance that noise of intensity diag(0, W) adds to [[A, E_ab], [0, A]].

The filter carries its own derivatives by what is unknown, which are exact. Blocks of samples are
summed up as they come, so that memory is bounded. States given all of the log are

    x̂_k = x⁻_k + P⁻_k r_k,    r⁻ = c e/s + (I − c gᵀ/s) r,    r_{k−1} = Φ_kᵀ r⁻_k

with e, s and g = P⁻ c of every sensor c in turn (de Jong, Biometrika 76(3), 1989): no covariance is
inverted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from deadtime.identification.likelihoods.tangent_kernel import tangents
from deadtime.identification.log.recording import Part, Recording
from deadtime.identification.parameters import Layout, Vector
from deadtime.identification.regression import period_weights
from deadtime.identification.scoring import Evaluation
from deadtime.identification.transition import interpolation, transitions_of
from deadtime.identification.uneven import acting_in
from deadtime.numerics.covariance import noise_covariances

_BLOCK = 4096  # samples whose derivatives are kept at a time, at most
_NUMBERS = 2_000_000  # of them


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


def periods_of(
    recording: Recording,
    layout: Layout,
    theta: Vector,
    L: Float[np.ndarray, "n n"],
    cells: Int[np.ndarray, " delay"],
    nodes: Float[np.ndarray, " node"],
) -> PeriodsOf:
    """Those of a recording, W = L Lᵀ; of an even one with delays in given cells."""
    if not recording.even:
        return _uneven_periods(layout, theta, L, nodes)
    return _even_periods(layout, theta, L, layout.spread(cells), recording.step)


def _even_periods(
    layout: Layout,
    theta: Vector,
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
        mode, z = part.mode[before], _acting_evenly(part, before, cells, layout.constant)
        added, by_added = np.zeros((rows.size, n)), np.zeros((rows.size, by_P.shape[1], n))
        for i in np.unique(mode):
            own = np.flatnonzero(mode == i)
            added[own] = z[own] @ P[i, :, n:].T
            by_added[own] = np.tensordot(z[own], by_P[i, :, :, n:], (1, 2))
        return FilterPeriods(mode, mode, *tables, added, by_added)

    return periods


def _acting_evenly(
    part: Part, k: Int[np.ndarray, " T"], cells: Int[np.ndarray, "mode m"], constant: bool
) -> Float[np.ndarray, "T r"]:
    """u_{k−N} of every input, then u_{k−N+1}, of periods k, and 1 for a constant term.

    Inputs before the log are its first ones: such periods are used where it rests there.
    """
    oldest = k[:, None] - cells[part.mode[k]]
    rows = np.concatenate((oldest, oldest + 1), axis=1)
    u = np.nan_to_num(part.input[np.maximum(rows, 0), np.tile(np.arange(cells.shape[1]), 2)])
    return np.hstack((u, np.ones((k.size, int(constant)))))


def _uneven_periods(
    layout: Layout, theta: Vector, L: Float[np.ndarray, "n n"], nodes: Float[np.ndarray, " node"]
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
    found = noise_covariances(joint, noise, np.tile(times, n * n))
    found = found.reshape(n * n, count, 2 * n, 2 * n).swapaxes(0, 1)
    of_A = found[..., :n, n:] + found[..., n:, :n]
    row, column = np.tril_indices(n)
    change = np.zeros((row.size, n, n))
    change[np.arange(row.size), row] = (
        np.where(row == column, np.diagonal(L)[row], 1.0)[:, None] * L[:, column].T
    )
    change += change.swapaxes(1, 2)
    of_L = noise_covariances(np.tile(A, (row.size, 1, 1)), change, np.tile(times, row.size))
    of_L = of_L.reshape(row.size, count, n, n).swapaxes(0, 1)
    return found[:, 0, n:, n:].copy(), np.concatenate((of_A, of_L), axis=1)


class Places(NamedTuple):
    """Where the unknowns of a filter lie: some of a plant's, of the triangle of L, and the sensors.

    size : of them all
    own : those of A, B and the delays of each mode, −1 for what is known
    wide : those that variances depend on, A and all of the noise
    noisy : where in `wide` A and L of each mode are, −1 for what is known
    """

    size: int
    own: Int[np.ndarray, "mode own"]
    wide: Int[np.ndarray, " q"]
    noisy: Int[np.ndarray, "mode noisy"]

    @classmethod
    def of(cls, layout: Layout, sensors: int, free: Int[np.ndarray, " free"]) -> Places:
        """Those of a layout with so many sensors, of which some are free, the sensors among them.

        Examples
        --------
        >>> places = Places.of(Layout(1, 1, 1, False), 1, np.array([1, 2, 3, 4]))  # A is known
        >>> places.own, places.wide, places.noisy
        (array([[-1,  0,  1]]), array([2, 3]), array([[-1,  0]]))
        """
        modes, n = layout.modes, layout.n
        of_L = np.arange(n * (n + 1) // 2)
        each = (layout.of_A.reshape(modes, -1), layout.of_B.reshape(modes, -1), layout.of_delay)
        size = layout.size + of_L.size + sensors
        wide = np.concatenate((layout.of_A.ravel(), np.arange(layout.size, size)))
        of_L = np.tile(layout.of_A.size + of_L, (modes, 1))
        at = np.full(size, -1)
        at[free] = np.arange(free.size)
        kept = at[wide] >= 0
        among = np.where(kept, np.cumsum(kept) - 1, -1)
        noisy = among[np.hstack((each[0], of_L))]
        return cls(free.size, at[np.hstack(each)], at[wide[kept]], noisy)

    @classmethod
    def none(cls, modes: int) -> Places:
        """No unknowns: the filter alone."""
        nothing = np.zeros((modes, 0), np.int64)
        return cls(0, nothing, nothing[0], nothing)


class Sensors(NamedTuple):
    """C (p, n), the variances R (p,) of the errors, and P0 (n, n) of a state that is not known."""

    C: Float[np.ndarray, "p n"]
    R: Float[np.ndarray, " p"]
    P0: Float[np.ndarray, "n n"]


class Filtered(NamedTuple):
    """Of a block's measurements the errors and variances, with their derivatives."""

    y: Float[np.ndarray, "T p"]
    e: Float[np.ndarray, "T p"]
    s: Float[np.ndarray, "T p"]
    by_e: Float[np.ndarray, "T p size"]
    by_s: Float[np.ndarray, "T p q"]


class SwitchedKalmanFilter(NamedTuple):
    """The filter over logs; what it knows begins anew at `starts`.

    left_out : measurements that tell where the state begins, and count for nothing else
    """

    parts: tuple[Part, ...]
    starts: list[np.ndarray]
    left_out: list[np.ndarray]
    periods_of: PeriodsOf
    sensors: Sensors

    def innovations(self, places: Places) -> Iterator[Filtered]:
        """Errors and variances of measurements and their derivatives, block by block."""
        sensors = self.sensors
        (p, n), q = sensors.C.shape, places.wide.size
        of_R = np.zeros((q, p))
        of_R[max(q - p, 0) :] = np.diag(2.0 * sensors.R)[: min(p, q)]
        noise = tuple(
            map(np.ascontiguousarray, (sensors.C, sensors.R, of_R, places.wide, sensors.P0))
        )
        numbers = n * n * (2 + 2 * n * n + places.noisy.shape[1]) + p * (places.size + q)
        block = min(_BLOCK, max(1, _NUMBERS // numbers))
        for part, start, initial in zip(*self[:3], strict=True):
            now = np.zeros(n), np.zeros((n, n)), np.zeros((places.size, n)), np.zeros((q, n, n))
            for first in range(0, start.size, block):
                rows = np.arange(first, min(first + block, start.size))
                y, fresh = np.ascontiguousarray(part.output[rows]), start[rows]
                periods = self.periods_of(part, rows, fresh)
                shapes = (), (), (places.size,), (q,)
                out = tuple(np.empty((rows.size, p, *shape)) for shape in shapes)
                tangents(y, fresh, *periods, places.own, places.noisy, *noise, now, out)
                for one, nothing in zip((y, *out), (np.nan, 0.0, 1.0, 0.0, 0.0), strict=True):
                    one[initial[rows]] = nothing
                yield Filtered(y, *out)

    def evaluate(self, places: Places) -> Evaluation:
        """The log likelihood, its score and information, over all unknowns."""
        size, wide = places.size, places.wide
        value, score, F = 0.0, np.zeros(size), np.zeros((size, size))
        for block in self.innovations(places):
            e, s = block.e.ravel(), block.s.ravel()
            if not (s.min() > 0.0 and np.isfinite(s).all() and np.isfinite(e).all()):
                return Evaluation(-np.inf, score, np.eye(size))
            by_e = block.by_e.reshape(s.size, -1) / np.sqrt(s)[:, None]
            by_s = block.by_s.reshape(s.size, -1) / s[:, None]
            known = np.count_nonzero(np.isfinite(block.y))
            value -= 0.5 * (float((np.log(s) + e * e / s).sum()) + known * np.log(2.0 * np.pi))
            score -= by_e.T @ (e / np.sqrt(s))
            score[wide] += by_s.T @ (0.5 * (e * e / s - 1.0))
            F += by_e.T @ by_e
            F[np.ix_(wide, wide)] += 0.5 * by_s.T @ by_s
        return Evaluation(value, score, F)

    def states(self, number: int) -> StatesOfPart:
        """The states of a part."""
        part, start = self.parts[number], self.starts[number]
        periods = self.periods_of(part, np.arange(start.size), start)
        found = _predicted(part.output, start, periods, self.sensors)
        return StatesOfPart(found.state, _smoothed(found, start, periods, self.sensors), periods)


class StatesOfPart(NamedTuple):
    """States of every sample, given all before it, and given all of the log; and its periods."""

    ahead: Float[np.ndarray, "sample n"]
    smoothed: Float[np.ndarray, "sample n"]
    periods: FilterPeriods


class _Predicted(NamedTuple):
    """States and covariances before each sample, then of each sensor e, s and g/s."""

    state: Float[np.ndarray, "sample n"]
    covariance: Float[np.ndarray, "sample n n"]
    error: Float[np.ndarray, "sample p"]
    variance: Float[np.ndarray, "sample p"]
    gain: Float[np.ndarray, "sample p n"]


def _predicted(
    output: Float[np.ndarray, "sample p"],
    start: Bool[np.ndarray, " sample"],
    periods: FilterPeriods,
    sensors: Sensors,
) -> _Predicted:
    """The filter over a log.

    e = 0, s = 1 and g = 0 where nothing was measured.
    """
    (count, p), n = output.shape, sensors.C.shape[1]
    state, covariance = np.empty((count, n)), np.empty((count, n, n))
    error, variance, gain = np.zeros((count, p)), np.ones((count, p)), np.zeros((count, p, n))
    x, P, unit = np.zeros(n), sensors.P0, np.eye(n)
    for k in range(count):
        if start[k]:
            x, P = np.zeros(n), sensors.P0
        else:
            Phi = periods.Phi[periods.kind[k]]
            x, P = Phi @ x + periods.added[k], Phi @ P @ Phi.T + periods.Q[periods.kind[k]]
        state[k], covariance[k] = x, P
        for j in range(p):
            if np.isfinite(output[k, j]):
                c = sensors.C[j]
                g = P @ c
                s = c @ g + sensors.R[j]
                e, own = output[k, j] - c @ x, g / s
                rest = unit - np.outer(own, c)  # Joseph's form: a vague P stays positive
                x, P = x + own * e, rest @ P @ rest.T + sensors.R[j] * np.outer(own, own)
                error[k, j], variance[k, j], gain[k, j] = e, s, g / s
    return _Predicted(state, covariance, error, variance, gain)


def _smoothed(
    found: _Predicted, start: Bool[np.ndarray, " sample"], periods: FilterPeriods, sensors: Sensors
) -> Float[np.ndarray, "sample n"]:
    """The states given all of the log."""
    count, n = found.state.shape
    states, r = np.empty((count, n)), np.zeros(n)
    for k in range(count - 1, -1, -1):
        for j in range(len(sensors.C) - 1, -1, -1):
            c = sensors.C[j]
            r = r + c * (found.error[k, j] / found.variance[k, j] - found.gain[k, j] @ r)
        states[k] = found.state[k] + found.covariance[k] @ r
        r = np.zeros(n) if start[k] else periods.Phi[periods.kind[k]].T @ r
    return states
