"""Kalman's filter of a plant that switches between modes, its derivatives, and its smoother.

    x_{k+1} = Φ x_k + a_k + w_k,    w_k ~ N(0, Q),    y_k = C x_k + v_k,    v_k ~ N(0, R)

Even periods repeat: Φ, Q and their derivatives are one table for each mode. Uneven periods have
their own, interpolated between nodes to round-off (`sampling`).

Derivatives by the unknowns are propagated with the filter and exact. Samples are processed in
blocks, so that memory is bounded. States given all of the log are

    x̂_k = x⁻_k + P⁻_k r_k,    r⁻ = c e/s + (I − c gᵀ/s) r,    r_{k−1} = Φ_kᵀ r⁻_k

with e, s and g = P⁻ c of every sensor c in turn (de Jong, Biometrika 76(3), 1989): no covariance is
inverted.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.identification.likelihoods.kalman_kernel import tangents
from deadtime.identification.log.recording import Part
from deadtime.identification.parameters import Layout, SensorMatrix, Square
from deadtime.identification.sampling import FilterPeriods, PeriodsOf
from deadtime.identification.scoring import Evaluation

_BLOCK = 4096  # samples whose derivatives are kept at a time, at most
_NUMBERS = 2_000_000  # numbers kept at a time, at most


class Places(NamedTuple):
    """Places of a filter's unknowns: some of the plant's, of the triangle of L, and the sensors.

    size : of all unknowns
    own : those of A, B and the delays of each mode, −1 for known entries
    wide : those on which variances depend: A and all of the noise
    noisy : the places in `wide` of A and L of each mode, −1 for known entries
    """

    size: int
    own: Int[np.ndarray, "mode own"]
    wide: Int[np.ndarray, " q"]
    noisy: Int[np.ndarray, "mode noisy"]

    @classmethod
    def of(cls, layout: Layout, sensors: int, free: Int[np.ndarray, " free"]) -> Places:
        """The places for a layout and a number of sensors; `free` includes all sensors.

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
    """C (p, n), the variances R (p,) of the errors, and the prior covariance P0 of a state."""

    C: SensorMatrix
    R: Float[np.ndarray, " p"]
    P0: Square


class Filtered(NamedTuple):
    """The errors and variances of a block's measurements, with their derivatives."""

    y: Float[np.ndarray, "T p"]
    e: Float[np.ndarray, "T p"]
    s: Float[np.ndarray, "T p"]
    by_e: Float[np.ndarray, "T p size"]
    by_s: Float[np.ndarray, "T p q"]


class SwitchedKalmanFilter(NamedTuple):
    """The filter over logs, which starts anew from the prior at `starts`.

    left_out : measurements that determine the initial state, and are not in the likelihood
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
        """The states of a part: Kalman's filter forwards, then de Jong's recursion backwards."""
        part, start, (C, R, P0) = self.parts[number], self.starts[number], self.sensors
        periods = self.periods_of(part, np.arange(start.size), start)
        (count, p), n, unit = part.output.shape, C.shape[1], np.eye(C.shape[1])
        ahead, covariance = np.empty((count, n)), np.empty((count, n, n))
        # e = 0, s = 1 and g = 0 where nothing was measured.
        error, variance, gain = np.zeros((count, p)), np.ones((count, p)), np.zeros((count, p, n))
        x, P = np.zeros(n), P0
        for k in range(count):
            if start[k]:
                x, P = np.zeros(n), P0
            else:
                Phi = periods.Phi[periods.kind[k]]
                x, P = Phi @ x + periods.added[k], Phi @ P @ Phi.T + periods.Q[periods.kind[k]]
            ahead[k], covariance[k] = x, P
            for j in np.flatnonzero(np.isfinite(part.output[k])):
                c = C[j]
                g = P @ c
                s = c @ g + R[j]
                e, own = part.output[k, j] - c @ x, g / s
                rest = unit - np.outer(own, c)  # Joseph's form: a vague P stays positive
                x, P = x + own * e, rest @ P @ rest.T + R[j] * np.outer(own, own)
                error[k, j], variance[k, j], gain[k, j] = e, s, own
        smoothed, r = np.empty((count, n)), np.zeros(n)
        for k in range(count - 1, -1, -1):
            for j in range(p - 1, -1, -1):
                r = r + C[j] * (error[k, j] / variance[k, j] - gain[k, j] @ r)
            smoothed[k] = ahead[k] + covariance[k] @ r
            r = np.zeros(n) if start[k] else periods.Phi[periods.kind[k]].T @ r
        return StatesOfPart(ahead, smoothed, periods)


class StatesOfPart(NamedTuple):
    """States of every sample, given all before it, and given all of the log; and its periods."""

    ahead: Float[np.ndarray, "sample n"]
    smoothed: Float[np.ndarray, "sample n"]
    periods: FilterPeriods
