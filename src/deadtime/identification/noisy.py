"""Maximum likelihood where measurements are noisy: the innovations of Kalman's filter.

    dx = (A x + Σ b_j u_j(t − D_j)) dt + dβ,    E dβ dβᵀ = W dt,
    y_k = C x_k + v_k,    v ~ N(0, V)

W is one for all modes, V diagonal. With the error e of every measurement about what those before it
foretell, and the variance s of that,

    log L = −½ Σ (log 2π s + e²/s),
    score = Σ (∂s (e²/s − 1)/2 − e ∂e)/s,    F = Σ (∂s²/2s² + ∂e²/s).

Of unevenly sampled logs ∂e and ∂s are central differences, a filter each way for every unknown; of
others the filter carries them (`noisy_even`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from deadtime.base.checks import read_only
from deadtime.base.frozen import Frozen
from deadtime.identification.filter_kernel import innovations
from deadtime.identification.noisy_even import (
    acting_evenly,
    evaluate_evenly,
    moved_evenly,
    of_free,
    tables_of,
)
from deadtime.identification.outputs.embedding import Embedding
from deadtime.identification.parameters import Layout
from deadtime.identification.recording import Part, Recording
from deadtime.identification.scoring import Evaluate, Evaluation
from deadtime.identification.transition import interpolation, plain_transitions
from deadtime.identification.uneven import Acting, acting_in, fed
from deadtime.numerics.covariance import noise_covariances

_VAGUE = 1e4  # variances of the log that the state is not known by where it starts anew
_STRIDE = 1.5  # of a noise's logarithm
_SMALL = 1e-3  # of a standard error, a step of differences


class Noise(NamedTuple):
    """W (n, n), x² per second, and the standard deviations of the sensors (p,)."""

    W: Float[np.ndarray, "n n"]
    deviation: Float[np.ndarray, " p"]


@dataclass(frozen=True, eq=False)
class NoisyLog(Frozen):
    """The likelihood of a recording with measurement noise.

    Its vector is that of the `Layout`, the lower triangle of L, W = L Lᵀ, the logarithms of its
    diagonal, and those of the sensors' standard deviations. With an `embedding` the states are
    those that outputs alone have, and some of the vector is known.
    """

    recording: Recording
    layout: Layout
    C: Float[np.ndarray, "p n"]
    within: bool
    bounds: tuple[float, float]
    unit: Float[np.ndarray, " size"]
    nodes: Float[np.ndarray, " node"]
    embedding: Embedding | None = None
    _acting: dict[tuple[int, bytes], Acting] = field(default_factory=dict, repr=False)

    @property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """What bounds unknowns, delays aside: noise is within 1e-12 … 1e6 of what is measured."""
        low, high = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        at = self.logarithms
        size = 0.5 * np.log(np.diagonal(self.P0) / _VAGUE)
        size = np.append(size, 0.5 * np.log(np.diagonal(self.C @ self.P0 @ self.C.T) / _VAGUE))
        low[at], high[at] = size - np.log(1e6), size + np.log(1e6)
        if self.embedding is not None:
            places, values = self.embedding.known(self.layout)
            low[places], high[places] = values, values
        return low, high

    @property
    def stride(self) -> Float[np.ndarray, " size"]:
        """The longest step of each unknown: a noise that is next to nothing has no curvature."""
        stride = np.full(self.size, np.inf)
        stride[self.logarithms] = _STRIDE
        return stride

    @property
    def logarithms(self) -> Int[np.ndarray, " log"]:
        """Where logarithms lie: of the diagonal of L, and of the sensors' deviations."""
        i, j = self.places
        at = np.append(np.flatnonzero(i == j), i.size + np.arange(len(self.C)))
        return self.layout.size + at

    @cached_property
    def free(self) -> Int[np.ndarray, " free"]:
        """The places of the vector that are unknown."""
        free = np.arange(self.size)
        if self.embedding is not None:
            free = np.setdiff1d(free, self.embedding.known(self.layout)[0])
        return read_only(free)

    def initial(self, starts: list[np.ndarray]) -> list[Bool[np.ndarray, "sample p"]]:
        """The measurements of every part that are left out: see `Embedding.initial`."""
        parts = self.recording.parts
        if self.embedding is None:
            return [np.zeros(part.output.shape, bool) for part in parts]
        given = zip(parts, starts, strict=True)
        return [self.embedding.initial(part.output, start) for part, start in given]

    def starts(self, low: float, high: float) -> list[Bool[np.ndarray, " sample"]]:
        """The samples before which nothing is known, for delays between two; of every part."""
        starts = []
        for part in self.recording.parts:
            start = np.ones(part.time.size, bool)
            start[1:] = ~fed(part, high, low)
            if self.within:
                start[1:] |= part.mode[1:] != part.mode[:-1]
            starts.append(start)
        return starts

    @cached_property
    def P0(self) -> Float[np.ndarray, "n n"]:
        """Of a state of which nothing is known."""
        if self.embedding is not None:
            return read_only(_VAGUE * np.diag(self.embedding.size**2))
        known = np.vstack([part.output for part in self.recording.parts])
        size = float(np.nanmean(known**2) / np.mean((self.C**2).sum(axis=1)))
        return read_only(_VAGUE * size * np.eye(self.layout.n))

    @property
    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the triangle of L."""
        return np.tril_indices(self.layout.n)

    @property
    def size(self) -> int:
        """How many unknowns there are."""
        return self.layout.size + self.places[0].size + len(self.C)

    def join(self, theta: np.ndarray, noise: Noise) -> Float[np.ndarray, " size"]:
        """The vector of a plant's unknowns and its noise."""
        L = np.linalg.cholesky(noise.W)
        i, j = self.places
        lower = np.where(i == j, np.log(np.abs(np.where(i == j, L[i, j], 1.0))), L[i, j])
        return np.concatenate((theta, lower, np.log(noise.deviation)))

    def noise(self, vector: Float[np.ndarray, " size"]) -> Noise:
        """W and the deviations of a vector."""
        L = self.root(vector)
        return Noise(L @ L.T, np.exp(vector[self.layout.size + self.places[0].size :]))

    def root(self, vector: Float[np.ndarray, " size"]) -> Float[np.ndarray, "n n"]:
        """L of a vector, W = L Lᵀ."""
        i, j = self.places
        lower = vector[self.layout.size : self.layout.size + i.size]
        L = np.zeros((self.layout.n, self.layout.n))
        L[i, j] = np.where(i == j, np.exp(np.where(i == j, lower, 0.0)), lower)
        return L

    def innovations(
        self, vector: Float[np.ndarray, " size"], starts: list[np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Errors and variances of all measurements, (samples, p) each."""
        errors = []
        given = zip(self.filters(vector, starts), self.initial(starts), strict=True)
        for one, initial in given:
            e, s = np.empty(one[0].shape), np.empty(one[0].shape)
            innovations(*map(np.ascontiguousarray, one), e, s)
            errors.append((np.where(initial, 0.0, e), np.where(initial, 1.0, s)))
        return np.vstack([e for e, _ in errors]), np.vstack([s for _, s in errors])

    def filters(
        self, vector: Float[np.ndarray, " size"], starts: list[np.ndarray]
    ) -> Iterator[tuple[np.ndarray, ...]]:
        """What `filter_kernel.innovations` takes of every part, from y to P0."""
        A, B, delays = self.layout.split(vector[: self.layout.size])
        noise = self.noise(vector)
        Phi_at, W_at = plain_transitions(A, self.nodes)
        forced, zero, P0 = W_at @ B[:, None], np.zeros(self.layout.n), self.P0
        for number, start in enumerate(starts):
            part = self.recording.parts[number]
            k = np.flatnonzero(~start) - 1
            if self.recording.even:
                moved = moved_evenly(part, A, B, delays, self.recording.step)
            else:
                moved = np.zeros((part.time.size, self.layout.n))
                held = self._held(number, start, delays)
                for i in range(self.layout.modes):
                    own = np.flatnonzero(part.mode[k] == i)
                    moved[k[own] + 1] = np.tensordot(held[own], forced[i], axes=([1, 2], [0, 2]))
            kind, Phi, Q = self._kinds(part, k, A, Phi_at, noise.W)
            yield part.output, start, kind, Phi, moved, Q, self.C, noise.deviation**2, zero, P0

    def _held(self, number: int, start: np.ndarray, delays: np.ndarray) -> np.ndarray:
        """`Acting.held` of a part; those of the last few delays are kept."""
        key = number, delays.tobytes() + start.tobytes()
        if key not in self._acting:
            if len(self._acting) > 3 * len(self.recording.parts):
                self._acting.clear()
            part = self.recording.parts[number]
            acts = acting_in(part, np.flatnonzero(~start) - 1, delays, self.nodes)
            self._acting[key] = Acting(*map(read_only, acts))
        return self._acting[key].held

    def _kinds(
        self, part: Part, k: np.ndarray, A: np.ndarray, Phi_at: np.ndarray, W: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The filter's rows: of every sample its kind, and the kinds' Φ and Q."""
        kind = np.zeros(part.time.size, np.int64)
        if self.recording.even:
            kind[1:] = part.mode[:-1]
            step = np.full(len(A), self.recording.step)
            weight = interpolation(self.nodes, step[:1])[0]
            return kind, np.tensordot(weight, Phi_at, (0, 1)), noise_covariances(A, W, step)
        Q_at = np.array(
            [noise_covariances(np.repeat(a[None], self.nodes.size, 0), W, self.nodes) for a in A]
        )
        kind[k + 1] = np.arange(k.size)
        weight = interpolation(self.nodes, part.time[k + 1] - part.time[k])
        mode = part.mode[k]
        Phi = np.einsum("kq,kqab->kab", weight, Phi_at[mode])
        return kind, Phi, np.einsum("kq,kqab->kab", weight, Q_at[mode])

    def value(self, vector: Float[np.ndarray, " size"], starts: list[np.ndarray]) -> float:
        """The log likelihood."""
        return self._value(*self.innovations(vector, starts), self.measured(starts))

    def measured(self, starts: list[np.ndarray]) -> int:
        """How many measurements the likelihood is of."""
        every = sum(int(np.isfinite(part.output).sum()) for part in self.recording.parts)
        return every - sum(int(one.sum()) for one in self.initial(starts))

    def _value(self, e: np.ndarray, s: np.ndarray, measured: int) -> float:
        return float(-0.5 * ((np.log(s) + e * e / s).sum() + measured * np.log(2.0 * np.pi)))

    def evaluate(self, vector: Float[np.ndarray, " size"], starts: list[np.ndarray]) -> Evaluation:
        """The log likelihood, its score and information."""
        with np.errstate(all="ignore"):
            e, s = self.innovations(vector, starts)
            value = self._value(e, s, self.measured(starts))
            if not np.isfinite(value) or s.min() <= 0.0:
                return Evaluation(-np.inf, np.zeros(vector.size), np.eye(vector.size))
            by_e, by_s = np.zeros((2, vector.size, e.size))
            for a in self.free.tolist():
                step = np.zeros(vector.size)
                step[a] = _SMALL * self.unit[a]
                up = self.innovations(vector + step, starts)
                down = self.innovations(vector - step, starts)
                by_e[a] = (up[0] - down[0]).ravel() / (2.0 * step[a])
                by_s[a] = (up[1] - down[1]).ravel() / (2.0 * step[a])
        root, s, e = np.sqrt(s).ravel(), s.ravel(), e.ravel()
        by_e, by_s = by_e / root, by_s / s
        score = by_s @ (0.5 * (e * e / s - 1.0)) - by_e @ (e / root)
        return Evaluation(value, score, by_e @ by_e.T + 0.5 * by_s @ by_s.T)

    def evaluate_in(self, low: float, high: float) -> Callable[[np.ndarray], Evaluate]:
        """The likelihood for delays between two, seconds; of an even log in cells of theirs."""
        starts = self.starts(low, high)
        if not self.recording.even:
            return lambda _: lambda vector: self.evaluate(vector, starts)
        parts, left_out = self.recording.parts, self.initial(starts)

        def within(cells: np.ndarray) -> Evaluate:
            own = self.layout.spread(cells)
            acting = [acting_evenly(part, own) for part in parts]
            return lambda vector: self._evaluate_evenly(vector, starts, left_out, own, acting)

        return within

    def _evaluate_evenly(
        self,
        vector: Float[np.ndarray, " size"],
        starts: list[np.ndarray],
        left_out: list[np.ndarray],
        cells: np.ndarray,
        acting: list[np.ndarray],
    ) -> Evaluation:
        """`evaluate` of an even log, with delays in given cells."""
        parts, theta = self.recording.parts, vector[: self.layout.size]
        deviation, given = self.noise(vector).deviation, (self.recording.step, len(self.C))
        with np.errstate(all="ignore"):
            tables = tables_of(self.layout, theta, self.root(vector), cells, *given)
            tables = of_free(tables, self.free)
            if not all(np.isfinite(table).all() for table in tables):
                return Evaluation(-np.inf, np.zeros(vector.size), np.eye(vector.size))
            R = deviation**2
            own = evaluate_evenly(parts, starts, left_out, acting, tables, self.C, R, self.P0)
        score, F = np.zeros(vector.size), np.zeros((vector.size, vector.size))
        score[self.free], F[np.ix_(self.free, self.free)] = own.score, own.information
        return Evaluation(own.value, score, F)
