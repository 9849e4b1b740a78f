"""Likelihoods of logs whose modes are hidden, states being exact or sensors noisy.

With exact states, in the unknowns of the plant,

    log L(θ, S, P) = log Σ_σ p(σ) Π_k N(x_{k+1} − P_σ(θ) r_k; 0, S_σ),
    ∂ log L = Σ_k Σ_i γ_k(i) ∂ log N_i,k,    γ: how likely the mode is, given all of the log

The second is Fisher's identity. Steps are scaled by the information with known modes of these
weights; `hidden_estimate` has the information with unknown ones.

With noisy sensors the exact likelihood is a sum over all paths, each with its own Kalman filter.
Here the filters that lead to a mode are mixed after every sample (`kalman_kernel`). They give the
density b_k of the measurements after every period, and log L = log Σ_σ p(σ) Π b_k(σ_k, σ_{k+1}) as
with exact states. A period in which the mode changes from i to j spends a uniformly distributed
share in i. To first order in the period its mean is (x_i + x_j)/2, x_i and x_j the means in one
mode, and its covariance the mean of both covariances plus (x_i − x_j)(x_i − x_j)ᵀ/12.

Derivatives are forward differences; the information is that of every sample's own score,

    F = Σ_k ∂ℓ_k ∂ℓ_kᵀ,    ℓ_k = log p(y_k | y_0 … y_{k−1}).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.identification.likelihoods.hidden_chain import (
    Jumps,
    Periods,
    Posterior,
    path_of,
    posterior_of,
)
from deadtime.identification.likelihoods.kalman_kernel import filter_modes
from deadtime.identification.likelihoods.likelihood import (
    ExactLog,
    PlantLikelihood,
    add_score,
    log_density,
    rooted,
)
from deadtime.identification.likelihoods.noisy_log import NoisyLog, SensorLikelihood, Starts
from deadtime.identification.log.recording import Recording
from deadtime.identification.parameters import Cells, Square, Squares, Vector, Window
from deadtime.identification.sampling import Term
from deadtime.identification.scoring import EvaluateIn, Evaluation


@dataclass(frozen=True, eq=False)
class HiddenLog(PlantLikelihood):
    """The likelihood of a recording with hidden modes, S of every mode and the chain fixed.

    periods : those that are usable in a window of the delays
    """

    periods: Periods = field(repr=False)
    S: Squares
    jumps: Jumps

    def ordered(self, order: Int[np.ndarray, " mode"]) -> HiddenLog:
        return replace(self, S=self.S[order], jumps=self.jumps.ordered(order))

    def along(self, recording: Recording) -> ExactLog:
        return ExactLog(recording, self.layout, self.within, self.bounds, self.nodes)

    def over(self, low: float, high: float) -> HiddenLog:
        """The likelihood of the periods that are usable for delays between two, seconds."""
        return replace(self, periods=self.periods.over(low, high))

    @property
    def window(self) -> Window:
        """The range of delays that the periods are usable for."""
        low, high = self.periods.window
        return max(self.bounds[0], low), min(self.bounds[1], high)

    def known(self, weight: Float[np.ndarray, "period mode"]) -> ExactLog:
        """The likelihood with known probabilities of modes in each period, noise eliminated."""
        given = self.recording, self.layout, self.within, self.bounds, self.nodes
        return ExactLog(*given, self.periods.usable, weight)

    def densities(self, theta: Vector, cells: Cells) -> Float[np.ndarray, "period mode"]:
        """The log density of every usable period in each mode."""
        maps = self.sampling.maps(self.layout, theta, cells, slopes=False)
        each = zip(self._rows(theta, cells), maps, self.S, strict=True)
        return np.column_stack([log_density(z, own.P, S) for z, own, S in each])

    def posterior(self, theta: Vector, cells: Cells) -> Posterior:
        """The posterior of modes."""
        return self.periods.posterior(self.densities(theta, cells), self.jumps)

    def path(self, theta: Vector, _: Window) -> list[Int[np.ndarray, " sample"]]:
        """The likeliest modes of the samples of every part."""
        return self.periods.path(self.densities(theta, self.cells(theta)), self.jumps)

    def _rows(self, theta: Vector, cells: Cells) -> list[np.ndarray]:
        """The rows of every mode's regression: all usable periods."""
        return self.periods.rows_of_modes(self.sampling.reads(self.layout, theta, cells))

    def weighted(self, theta: Vector, cells: Cells) -> tuple[list[Term], Posterior]:
        """The regressions of all modes, weighted by the posterior of the mode; and that."""
        posterior, maps = (
            self.posterior(theta, cells),
            self.sampling.maps(self.layout, theta, cells),
        )
        each = zip(self._rows(theta, cells), posterior.weight.T, maps, strict=True)
        return [Term(rooted(z, own), float(own.sum()), *one) for z, own, one in each], posterior

    def evaluate(self, theta: Vector, cells: Cells) -> Evaluation:
        """The log likelihood, its score, and the information with known modes."""
        size = self.layout.size
        score, information = np.zeros(size), np.zeros((size, size))
        with np.errstate(all="ignore"):
            maps = self.sampling.maps(self.layout, theta, cells)
            if not all(np.isfinite(one.P).all() for one in maps):
                return Evaluation(-np.inf, score, np.eye(size))
            terms, posterior = self.weighted(theta, cells)
            for term, S in zip(terms, self.S, strict=True):
                e = term.root[:, : len(S)] - term.root[:, len(S) :] @ term.P.T
                add_score(term, e, np.linalg.cholesky(S), score, information)
        return Evaluation(posterior.value, score, information)

    def evaluate_in(self, low: float, high: float) -> EvaluateIn:
        log = self.over(low, high)
        return lambda cells: lambda theta: log.evaluate(theta, cells)


_SMALL = 1e-3  # of a standard error: step of differences, and the largest error of a maximum
_BLOCK = 4096  # samples whose weights of nodes are stored at a time


class PartPeriods(NamedTuple):
    """The periods before the samples of a part, all of one mode.

    kind : (T,), the row of Phi and Q, how a state moves, and the noise; added : (T, n), by inputs
    """

    kind: Int[np.ndarray, " T"]
    Phi: Float[np.ndarray, "kind n n"]
    added: Float[np.ndarray, "T n"]
    Q: Float[np.ndarray, "kind n n"]


@dataclass(frozen=True, eq=False, kw_only=True)
class HiddenNoisyLog(SensorLikelihood):
    """The likelihood of a recording with measurement noise and hidden modes, the chain fixed.

    errors : approximate standard errors of the vector
    """

    errors: Vector
    jumps: Jumps
    _kept: dict[tuple, PartPeriods] = field(default_factory=dict, repr=False)

    gain: ClassVar[float] = 1e-3  # each step takes a filter for every unknown
    profiled: ClassVar[bool] = False

    def along(self, recording: Recording) -> NoisyLog:
        """The likelihood with known modes, those of a recording, which change at samples."""
        return NoisyLog(recording, self.layout, False, self.bounds, self.nodes, self.C)

    def ordered(self, order: Int[np.ndarray, " mode"]) -> HiddenNoisyLog:
        errors, jumps = self.layout.ordered(self.errors, order), self.jumps.ordered(order)
        return replace(self, errors=errors, jumps=jumps, _kept={})

    @property
    def most(self) -> Vector:
        """The largest steps of noise at which differences are accurate; infinite for the plant."""
        most = self.errors.copy()
        most[: self.layout.size] = np.inf
        return most

    def stride(self, vector: Vector) -> Vector:
        return np.full(vector.size, np.inf)

    def filtered(
        self, vector: Vector, starts: Starts, cells: Cells | None = None
    ) -> tuple[list[tuple[np.ndarray, np.ndarray]], Float[np.ndarray, " sample"]]:
        """Log densities of every part's periods, without and with a change; and log L by sample."""
        layout, one = self.layout, replace(self.layout, modes=1, per_mode=False)
        A, B, delays = layout.split(vector[: layout.size])
        L, R, by_part, gained = self.root(vector), self.noise(vector).deviation ** 2, [], []
        own = layout.spread(cells if cells is not None and cells.size else self.cells(vector))
        modes = [np.s_[i : i + 1] for i in range(layout.modes)]
        thetas = [one.join(A[i], B[i], delays[i]) for i in modes]
        for number, start in enumerate(starts):
            each = [
                self._periods(number, start, theta, L, own[i]) for i, theta in enumerate(thetas)
            ]
            Phi, added, Q = (np.array(one) for one in list(zip(*each, strict=True))[1:])
            part = self.recording.parts[number]
            stay = np.empty((part.time.size - 1, layout.modes))
            move = np.empty((*stay.shape, layout.modes))
            adds = np.empty(part.time.size)
            given = (part.output, start, each[0].kind, Phi, added, Q, self.C)
            given = (*given, R, self.P0, *self.jumps.over(part.time))
            filter_modes(*map(np.ascontiguousarray, given), self.within, stay, move, adds)
            by_part.append((stay, move))
            gained.append(adds)
        return by_part, np.concatenate(gained)

    def _periods(
        self, number: int, start: np.ndarray, theta: Vector, L: Square, cells: Cells
    ) -> PartPeriods:
        """The periods of a part in one mode, cached: differences change those of few modes.

        theta : of a plant of that mode alone
        """
        key = number, *(one.tobytes() for one in (start, theta, L, cells))
        if key in self._kept:
            return self._kept[key]
        if len(self._kept) > 4 * self.layout.modes * len(self.recording.parts):
            self._kept.clear()
        part, layout = self.recording.parts[number], replace(self.layout, modes=1, per_mode=False)
        part = part._replace(mode=np.zeros(part.time.size, np.int64))
        periods_of = self.sampling.periods_of(layout, theta, L, cells, slopes=False)
        each, tables = [], 0
        for rows in np.split(np.arange(start.size), range(_BLOCK, start.size, _BLOCK)):
            block = periods_of(part, rows, start[rows])
            each.append((tables + block.kind, block.Phi, block.added, block.Q))
            tables += len(block.Phi)
        kind, *others = zip(*each, strict=True)
        self._kept[key] = PartPeriods(np.concatenate(kind), *map(np.vstack, others))
        return self._kept[key]

    def posterior(self, vector: Vector, starts: Starts, cells: Cells | None = None) -> Posterior:
        """The posterior of modes; weights are of all periods."""
        by_part, gained = self.filtered(vector, starts, cells)
        parts = self.recording.parts
        every = [np.arange(part.time.size - 1) for part in parts]
        posterior = posterior_of(parts, by_part, self.jumps, every, self.within)
        return posterior._replace(value=float(gained.sum()))

    def path(self, vector: Vector, window: Window) -> list[Int[np.ndarray, " sample"]]:
        """The likeliest modes of the samples of every part, for delays in a window."""
        densities, _ = self.filtered(vector, self.starts(*window))
        return path_of(self.recording.parts, densities, self.jumps)

    def value(self, vector: Vector, starts: Starts, cells: Cells | None = None) -> float:
        return float(self.filtered(vector, starts, cells)[1].sum())

    def evaluate(self, vector: Vector, starts: Starts, cells: Cells | None = None) -> Evaluation:
        size = vector.size
        with np.errstate(all="ignore"):
            now = self.filtered(vector, starts, cells)[1]
            if not np.isfinite(now).all():
                return Evaluation(-np.inf, np.zeros(size), np.eye(size))
            slope = np.empty((size, now.size))
            for a in range(size):
                step = np.zeros(size)
                step[a] = _SMALL * self.errors[a]
                slope[a] = (self.filtered(vector + step, starts, cells)[1] - now) / step[a]
        if not np.isfinite(slope).all():
            return Evaluation(-np.inf, np.zeros(size), np.eye(size))
        return Evaluation(float(now.sum()), slope.sum(axis=1), slope @ slope.T)
