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

from collections.abc import Callable
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
    tables_of,
)
from deadtime.identification.parameters import Layout
from deadtime.identification.recording import Recording
from deadtime.identification.scoring import Evaluate, Evaluation
from deadtime.identification.transition import interpolation, plain_transitions
from deadtime.identification.uneven import Acting, acting_in, fed
from deadtime.numerics.covariance import noise_covariances

_VAGUE = 1e4  # variances of the log that the state is not known by where it starts anew
_SMALL = 1e-3  # of a standard error, a step of differences


class Noise(NamedTuple):
    """W (n, n), x² per second, and the standard deviations of the sensors (p,)."""

    W: Float[np.ndarray, "n n"]
    deviation: Float[np.ndarray, " p"]


class Stretch(NamedTuple):
    """What a part's periods do: of every sample which kind leads to it, and what inputs add in it.

    kind : (T,); moved : (T, n); Phi, Q : (kinds, n, n), how a state moves, and the noise
    """

    kind: Int[np.ndarray, " sample"]
    Phi: Float[np.ndarray, "kind n n"]
    moved: Float[np.ndarray, "sample n"]
    Q: Float[np.ndarray, "kind n n"]


@dataclass(frozen=True, eq=False)
class NoisyLog(Frozen):
    """The likelihood of a recording with measurement noise.

    Its vector is that of the `Layout`, the lower triangle of L, W = L Lᵀ, the logarithms of its
    diagonal, and those of the sensors' standard deviations.
    """

    recording: Recording
    layout: Layout
    C: Float[np.ndarray, "p n"]
    within: bool
    bounds: tuple[float, float]
    unit: Float[np.ndarray, " size"]
    nodes: Float[np.ndarray, " node"]
    _acting: dict[tuple[int, bytes], Acting] = field(default_factory=dict, repr=False)

    @property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """What bounds unknowns, delays aside: noise is within 1e-12 … 1e6 of what is measured."""
        low, high = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        i, j = self.places
        at = self.layout.size + np.append(np.flatnonzero(i == j), i.size + np.arange(len(self.C)))
        size = 0.5 * np.log(self.P0[0, 0] / _VAGUE)
        low[at], high[at] = size - np.log(1e6), size + np.log(1e6)
        return low, high

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
        A, B, delays = self.layout.split(vector[: self.layout.size])
        noise, errors = self.noise(vector), []
        zero, P0 = np.zeros(self.layout.n), self.P0
        for number, start in enumerate(starts):
            part = self.recording.parts[number]
            over = self.stretch(number, start, A, B, delays, noise.W)
            e, s = np.empty(part.output.shape), np.empty(part.output.shape)
            given = (
                part.output,
                start,
                over.kind,
                over.Phi,
                over.moved,
                over.Q,
                self.C,
                noise.deviation**2,
                zero,
                P0,
            )
            innovations(*map(np.ascontiguousarray, given), e, s)
            errors.append((e, s))
        return np.vstack([e for e, _ in errors]), np.vstack([s for _, s in errors])

    def stretch(
        self,
        number: int,
        start: Bool[np.ndarray, " sample"],
        A: Float[np.ndarray, "mode n n"],
        B: Float[np.ndarray, "mode n m"],
        delays: Float[np.ndarray, "mode m"],
        W: Float[np.ndarray, "n n"],
        cells: Int[np.ndarray, "mode m"] | None = None,
    ) -> Stretch:
        """What the periods of a part do under a plant; of even rows with delays in given cells."""
        part, step = self.recording.parts[number], self.recording.step
        kind, k = np.zeros(part.time.size, np.int64), np.flatnonzero(~start) - 1
        if self.recording.even:
            kind[1:], once = part.mode[:-1], np.full(len(A), step)
            moved = moved_evenly(part, A, B, delays, step, cells)
            Phi = plain_transitions(A, once[:1])[0][:, 0]
            return Stretch(kind, Phi, moved, noise_covariances(A, W, once))
        moved, held = np.zeros((part.time.size, len(A[0]))), self._held(number, start, delays)
        Phi_at, W_at = plain_transitions(A, self.nodes)
        mode, forced = part.mode[k], W_at @ B[:, None]
        for i in range(len(A)):
            own = np.flatnonzero(mode == i)
            moved[k[own] + 1] = np.tensordot(held[own], forced[i], axes=([1, 2], [0, 2]))
        Q_at = np.array(
            [noise_covariances(np.repeat(a[None], self.nodes.size, 0), W, self.nodes) for a in A]
        )
        kind[k + 1] = np.arange(k.size)
        weight = interpolation(self.nodes, part.time[k + 1] - part.time[k])
        Phi, Q = (np.einsum("kq,kqab->kab", weight, at[mode]) for at in (Phi_at, Q_at))
        return Stretch(kind, Phi, moved, Q)

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

    def value(self, vector: Float[np.ndarray, " size"], starts: list[np.ndarray]) -> float:
        """The log likelihood."""
        return self._value(*self.innovations(vector, starts))

    def _value(self, e: np.ndarray, s: np.ndarray) -> float:
        measured = sum(int(np.isfinite(part.output).sum()) for part in self.recording.parts)
        return float(-0.5 * ((np.log(s) + e * e / s).sum() + measured * np.log(2.0 * np.pi)))

    def evaluate(self, vector: Float[np.ndarray, " size"], starts: list[np.ndarray]) -> Evaluation:
        """The log likelihood, its score and information."""
        with np.errstate(all="ignore"):
            e, s = self.innovations(vector, starts)
            value = self._value(e, s)
            if not np.isfinite(value) or s.min() <= 0.0:
                return Evaluation(-np.inf, np.zeros(vector.size), np.eye(vector.size))
            by_e, by_s = np.empty((2, vector.size, e.size))
            for a in range(vector.size):
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
        parts = self.recording.parts

        def within(cells: np.ndarray) -> Evaluate:
            own = self.layout.spread(cells)
            acting = [acting_evenly(part, own) for part in parts]
            return lambda vector: self._evaluate_evenly(vector, starts, own, acting)

        return within

    def _evaluate_evenly(
        self,
        vector: Float[np.ndarray, " size"],
        starts: list[np.ndarray],
        cells: np.ndarray,
        acting: list[np.ndarray],
    ) -> Evaluation:
        """`evaluate` of an even log, with delays in given cells."""
        parts, theta = self.recording.parts, vector[: self.layout.size]
        deviation, given = self.noise(vector).deviation, (self.recording.step, len(self.C))
        with np.errstate(all="ignore"):
            tables = tables_of(self.layout, theta, self.root(vector), cells, *given)
            if not all(np.isfinite(table).all() for table in tables):
                return Evaluation(-np.inf, np.zeros(vector.size), np.eye(vector.size))
            R = deviation**2
            return evaluate_evenly(parts, starts, acting, tables, self.C, R, self.P0)
