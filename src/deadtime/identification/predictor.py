"""Predictions of a recording by an identified plant: a row ahead, several rows ahead, and free.

A free run uses inputs alone. With x_{k+1} = Φ_k x_k + a_k, Φ_k and a_k of the row's mode, its
outputs are affine in its first state,

    C x_k = C F_k x₀ + C g_k,    F_{k+1} = Φ_k F_k,    g_{k+1} = Φ_k g_k + a_k.

The first state is the logged one where states are measured exactly. Otherwise it is the
least-squares solution over the first rows, in standard deviations of the sensors. A run begins
again where acting inputs are not known.

The model's own noise adds an error to a free run, of covariance P_{k+1} = Φ_k P_k Φ_kᵀ + Q_k, to
which its true error is compared.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from deadtime.base.frozen import Frozen
from deadtime.identification.estimate import Estimate
from deadtime.identification.levels import with_constant
from deadtime.identification.likelihoods.noisy_log import NoisyLog
from deadtime.identification.log.recording import Level, Part, Recording
from deadtime.identification.noisy_estimate import noisy_residuals
from deadtime.identification.parameters import (
    SHORTEST,
    SensorMatrix,
    Squares,
    Vector,
    Window,
)
from deadtime.identification.residuals import FittedModel
from deadtime.identification.sampling import known_ends, nodes_for
from deadtime.identification.transition import interpolation, noise_tables, plain_transitions

_KNOWN = 1e-9  # eigenvalue of the unknowns' correlation: combinations that are known
_SMALL = 0.1  # of an error: step of differences
_FIRST = 10  # rows per state, at least, that determine the first state of a free run
_SHARE = 0.1  # of the rows of a run, likewise
_SETTLED = 200  # periods after which the filter's covariance is constant


class FreeRun(NamedTuple):
    """States of a free run, NaN where there is none.

    variance : of its outputs' errors by the model's noise, if that was asked for
    starts : first rows of the runs; used : rows from which their first states are, in all
    longest : of the runs, seconds
    """

    states: Float[np.ndarray, "sample n"]
    variance: Float[np.ndarray, "sample p"] | None
    starts: tuple[int, ...]
    used: int
    longest: float


@dataclass(frozen=True, eq=False)
class Predictor(Frozen):
    """An identified plant and a recording, about the level of the plant's constant terms.

    log : the recording with the structure of the plant; vector : its unknowns
    covariance : of the unknowns of the plant
    W, deviation : intensities of the noise, and standard deviations of the sensors, 0 if exact
    """

    log: NoisyLog
    vector: Vector
    covariance: Float[np.ndarray, "unknown unknown"]
    W: Squares
    deviation: Float[np.ndarray, " p"]

    @classmethod
    def of(cls, estimate: Estimate, C: SensorMatrix, recording: Recording) -> Predictor:
        """The predictor of a recording by the plant of an estimate, perhaps from another log."""
        own, shape = estimate.log, estimate.of_outputs and estimate.of_outputs.embedding
        level, about = own.recording.level, recording.absolute()
        about = about if level is None else about.about(level)
        nodes = nodes_for(about.parts, estimate.plant.A)
        log = NoisyLog(about, own.layout, own.within, own.bounds, nodes, C, shape)
        size = own.layout.size
        covariance = estimate.spread.covariance[:size, :size]
        return cls(log, estimate.best.theta, covariance, estimate.disturbance, estimate.noise)

    @property
    def parts(self) -> tuple[Part, ...]:
        return self.log.recording.parts

    @property
    def exact(self) -> bool:
        """Whether states are measured without noise."""
        return not self.deviation.any()

    @cached_property
    def model(self) -> FittedModel:
        layout, theta = self.log.layout, self.vector[: self.log.layout.size]
        return FittedModel(layout.plant(theta), layout.constant_of(theta), self.log.sampling)

    def with_constant(self) -> Predictor:
        """This predictor with places for constant terms."""
        log, C = self.log, self.log.C
        size, zero = log.layout.size, Level(np.zeros(len(C)), np.zeros(log.layout.m))
        theta, layout = with_constant(self.vector[:size], log.layout, zero, np.linalg.pinv(C))
        vector = np.concatenate((theta, self.vector[size:]))
        return replace(self, log=replace(log, layout=layout), vector=vector)

    def errors(self, vector: Vector, window: Window) -> Float[np.ndarray, "sample p"]:
        """Errors a row ahead with other unknowns, in one common unit each; NaN where there is none.

        Of the filter they are in standard deviations. Both are linear in B and constant terms.
        """
        if not self.exact:
            return np.vstack(noisy_residuals(self.log, vector, window))
        other = replace(self, vector=vector).model
        roots = np.tile(np.eye(other.plant.states), (other.plant.modes, 1, 1))
        return np.vstack(other.residuals(self.log.recording, self.log.within, roots))

    def error_of_plant(self, window: Window) -> Float[np.ndarray, "sample p unknown"]:
        """Errors a row ahead by those of the plant's unknowns: ∂e/∂θ L, Σ = L Lᵀ."""
        size = np.sqrt(np.diagonal(self.covariance))
        unit = np.where(size > 0.0, size, 1.0)
        values, vectors = np.linalg.eigh(self.covariance / unit / unit[:, None])
        ways = size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
        e, by = self.errors(self.vector, window), []
        at, shortest = self.log.layout.at_delays, SHORTEST * self.log.recording.step
        for way in ways.T[values > _KNOWN]:
            moved = self.vector.copy()
            moved[: way.size] += _SMALL * way
            moved[at] = np.clip(moved[at], shortest, window[1])
            by.append((self.errors(moved, window) - e) / _SMALL)
        return np.stack(by, axis=-1)

    def ahead(self, number: int) -> Float[np.ndarray, "sample n"]:
        """The states of a part, each from all rows before; NaN where these do not determine it."""
        part, log, model = self.parts[number], self.log, self.model
        if self.exact:
            states = np.full(part.output.shape, np.nan)
            k = np.flatnonzero(known_ends(part, log.within) & model.fed(part))
            states[k + 1] = model.one_step(part, k, part.output[k])
            return states
        delays = model.plant.delays
        alone = replace(log, recording=log.recording._replace(parts=(part,)))
        (start,) = starts = alone.starts(float(delays.min()), float(delays.max()))
        states = alone.filter(self.vector, starts).states(0).ahead
        return np.where(log.determined(part, start)[:, None], states, np.nan)

    def several(
        self, number: int, ahead: Float[np.ndarray, "sample n"], rows: int
    ) -> Float[np.ndarray, "sample n"]:
        """States predicted some rows ahead, from those a row ahead."""
        Phi, forced = self.model.transitions(self.parts[number])
        fed = np.append(np.isfinite(forced).all(axis=1), False)
        result = np.full(ahead.shape, np.nan)
        k = np.flatnonzero(np.isfinite(ahead).all(axis=1))
        x = ahead[k]
        for _ in range(1, rows):
            x, k = x[fed[k]], k[fed[k]]
            x, k = np.einsum("kab,kb->ka", Phi[k], x) + forced[k], k + 1
        result[k] = x
        return result

    def several_variance(self, rows: int) -> Float[np.ndarray, " p"]:
        """The largest variance over the modes of an error some rows ahead, by the model's noise."""
        C, R = self.log.C, np.diag(self.deviation**2)
        worst = np.zeros(len(C))
        for A, W in zip(self.model.plant.A, self.W, strict=True):
            once = np.array([self.log.recording.step])
            Phi = plain_transitions(A[None], once)[0][0, 0]
            P = Q = noise_tables(A, _root(W), once, slopes=False)[0][0]
            for _ in range(0 if self.exact else _SETTLED):
                gain = np.linalg.lstsq(C @ P @ C.T + R, C @ P, rcond=None)[0].T
                P = Phi @ (P - gain @ C @ P) @ Phi.T + Q
                if not np.isfinite(P).all():  # of a mode far from any that fits its log
                    return np.full(len(C), np.inf)
            for _ in range(1, rows):
                P = Phi @ P @ Phi.T + Q
            worst = np.maximum(worst, np.diagonal(C @ P @ C.T + R))
        return worst

    def free_run(self, number: int, noise: bool = False) -> FreeRun:
        """The states of a part by its inputs alone, from first states as in the module's text."""
        part, C = self.parts[number], self.log.C
        starts, used, longest, R = [], 0, 0.0, self.deviation**2
        states = np.full((part.time.size, self.log.layout.n), np.nan)
        variance = np.full(part.output.shape, np.nan) if noise else None
        Phi, forced = self.model.transitions(part)
        Q = self._noise(part) if noise else None
        for first, last in runs_of(np.asarray(np.isfinite(forced).all(axis=1))):
            known = np.isfinite(part.output[first:last])
            rows = np.flatnonzero(known.all(axis=1) if self.exact else known.any(axis=1))
            if not rows.size:
                continue
            first += int(rows[0])
            x, P, count = self._initial(part, first, last, Phi, forced)
            starts, used = [*starts, first], used + count
            longest = max(longest, float(part.time[last] - part.time[first]))
            with np.errstate(all="ignore"):
                for k in range(first, last + 1):
                    states[k] = x
                    if k < last:
                        x = Phi[k] @ x + forced[k]
                    if variance is not None and Q is not None:
                        variance[k] = np.diagonal(C @ P @ C.T) + R
                        P = Phi[k] @ P @ Phi[k].T + Q[k] if k < last else P
        return FreeRun(states, variance, tuple(starts), used, longest)

    def _noise(self, part: Part) -> Float[np.ndarray, "period n n"]:
        """The covariance that each period of a part adds."""
        over = interpolation(self.log.nodes, np.diff(part.time))
        tables = [
            noise_tables(A, _root(W), self.log.nodes, slopes=False)[0]
            for A, W in zip(self.model.plant.A, self.W, strict=True)
        ]
        Q, mode = np.empty((len(over), *self.W.shape[1:])), part.mode[:-1]
        for i in np.unique(mode):
            Q[mode == i] = np.tensordot(over[mode == i], tables[i], 1)
        return Q

    def _initial(
        self, part: Part, first: int, last: int, Phi: np.ndarray, forced: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, int]:
        """The first state of a run, its covariance, and the number of rows it is from."""
        C, n = self.log.C, self.log.layout.n
        if self.exact:
            return part.output[first], np.zeros((n, n)), 1
        count = min(max(_FIRST * n, round(_SHARE * (last - first))), last - first + 1)
        F, g, rows, left = np.eye(n), np.zeros(n), [], []
        for k in range(first, first + count):
            rows.append(C @ F / self.deviation[:, None])
            left.append((part.output[k] - C @ g) / self.deviation)
            if k < last:
                F, g = Phi[k] @ F, Phi[k] @ g + forced[k]
        own = np.isfinite(np.concatenate(left))
        X, z = np.vstack(rows)[own], np.concatenate(left)[own]
        P = np.linalg.pinv(X.T @ X, hermitian=True)
        return np.linalg.lstsq(X, z, rcond=None)[0], P, count


def runs_of(good: Bool[np.ndarray, " period"]) -> Iterator[tuple[int, int]]:
    """The first and the last row of every run of good periods.

    Examples
    --------
    >>> list(runs_of(np.array([True, True, False, True])))
    [(0, 2), (3, 4)]
    """
    edges = np.flatnonzero(np.diff(np.concatenate(([0], good, [0]))))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def _root(W: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    """L of W = L Lᵀ, also where W is singular."""
    values, vectors = np.linalg.eigh(W)
    return vectors * np.sqrt(np.maximum(values, 0.0))
