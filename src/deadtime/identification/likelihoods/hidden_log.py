"""The likelihood of a log whose modes are hidden, in the unknowns of the plant.

    log L(θ, S, P) = log Σ_σ p(σ) Π_k N(x_{k+1} − P_σ(θ) r_k; 0, S_σ),
    ∂ log L = Σ_k Σ_i γ_k(i) ∂ log N_i,k,    γ: how likely the mode is, given all of the log

The second is Fisher's identity. Steps are scaled by the information that the log would hold if the
modes were known with these weights; what not knowing them takes from it is in `information`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Int

from deadtime.identification.likelihoods.jumps import Jumps
from deadtime.identification.likelihoods.likelihood import PlantLikelihood
from deadtime.identification.likelihoods.mode_periods import (
    EvenPeriods,
    PooledRegression,
    Posterior,
    UnevenPeriods,
)
from deadtime.identification.parameters import Window, cell_of
from deadtime.identification.regression import (
    LagRoots,
    Term,
    add_score,
    even_terms,
    log_density,
    rooted,
)
from deadtime.identification.scoring import Evaluate, Evaluation
from deadtime.identification.uneven import node_columns, node_term


@dataclass(frozen=True, eq=False)
class HiddenLog(PlantLikelihood):
    """The likelihood of a recording whose modes are hidden, S of every mode and the chain held.

    periods : those that are usable in a window of the delays
    """

    periods: EvenPeriods | UnevenPeriods = field(repr=False)
    S: Float[np.ndarray, "mode n n"]
    jumps: Jumps

    def ordered(self, order: Int[np.ndarray, " mode"]) -> HiddenLog:
        """With modes in another order."""
        return replace(self, S=self.S[order], jumps=self.jumps.ordered(order))

    def over(self, low: float, high: float) -> HiddenLog:
        """The likelihood of the periods that are usable for delays between two, seconds."""
        h, old = self.recording.step, self.periods
        if isinstance(old, UnevenPeriods):
            new = UnevenPeriods.between(old.parts, low, high, old.pooled, h, old.constant)
            return self if (low, high) == (old.low, old.high) else replace(self, periods=new)
        first, last = cell_of(low, h, up=True), cell_of(high, h)
        if (first, last) == (old.first, old.last):
            return self
        pooled = old.pooled if isinstance(old.pooled, PooledRegression) else None
        return replace(self, periods=EvenPeriods.of(old.parts, first, last, pooled, old.constant))

    @property
    def window(self) -> Window:
        """The range of delays that the periods are usable for."""
        h, periods = self.recording.step, self.periods
        if isinstance(periods, UnevenPeriods):
            return periods.low, periods.high
        ends = (periods.first - 1) * h, periods.last * h
        return max(self.bounds[0], ends[0]), min(self.bounds[1], ends[1])

    def _cut(self, theta: np.ndarray, cells: Int[np.ndarray, " delay"]) -> list[Term]:
        """The regressions' matrices, of no rows yet."""
        layout, step = self.layout, self.recording.step
        if isinstance(self.periods, UnevenPeriods):
            A, B, _ = layout.split(theta)
            none = np.zeros((0, node_columns(layout, self.nodes)))
            each = range(layout.modes)
            return [node_term(none, 0, layout, i, A[i], B[i], self.nodes) for i in each]
        low, high = int(cells.min()) - 1, int(cells.max())
        none = np.zeros((0, 2 * layout.n + (high - low + 1) * layout.m + layout.constant))
        lags = LagRoots([none] * layout.modes, np.zeros(layout.modes, np.int64), low, high)
        return even_terms(lags, layout, step, layout.spread(cells), theta)

    def densities(
        self, theta: np.ndarray, cells: Int[np.ndarray, " delay"]
    ) -> Float[np.ndarray, "period mode"]:
        """The log density of every usable period in each mode."""
        return self._given(self._cut(theta, cells), self.rows(theta, cells))

    def posterior(self, theta: np.ndarray, cells: Int[np.ndarray, " delay"]) -> Posterior:
        """What the log says of the modes."""
        return self.periods.posterior(self.densities(theta, cells), self.jumps)

    def path(
        self, theta: np.ndarray, cells: Int[np.ndarray, " delay"]
    ) -> list[Int[np.ndarray, " sample"]]:
        """The likeliest modes of the samples of every part."""
        return self.periods.path(self.densities(theta, cells), self.jumps)

    def rows(self, theta: np.ndarray, cells: Int[np.ndarray, " delay"]) -> list[np.ndarray]:
        """The rows of every mode's regression: all usable periods, as if they were of it."""
        if not isinstance(self.periods, UnevenPeriods):
            return self.periods.rows_of_modes(self.layout.spread(cells))
        _, _, delays = self.layout.split(theta)
        if not self.layout.per_mode:
            return [self.periods.rows(delays[0], self.nodes)] * self.layout.modes
        return [self.periods.rows(own, self.nodes) for own in delays]

    def _given(self, terms: list[Term], rows: list[np.ndarray]) -> np.ndarray:
        each = zip(rows, terms, self.S, strict=True)
        return np.column_stack([log_density(z, term.P, S) for z, term, S in each])

    def terms(
        self,
        theta: np.ndarray,
        cells: Int[np.ndarray, " delay"],
        weight: Float[np.ndarray, "period mode"],
    ) -> list[Term]:
        """The regressions over the periods of each mode, as likely as that is."""
        each = zip(self._cut(theta, cells), self.rows(theta, cells), weight.T, strict=True)
        return [
            term._replace(root=rooted(z, own), periods=float(own.sum())) for term, z, own in each
        ]

    def weighted(
        self, theta: np.ndarray, cells: Int[np.ndarray, " delay"]
    ) -> tuple[list[Term], Posterior]:
        """The same as likely as the log says, and what it says."""
        found = self.posterior(theta, cells)
        return self.terms(theta, cells, found.weight), found

    def evaluate(self, theta: np.ndarray, cells: Int[np.ndarray, " delay"]) -> Evaluation:
        """The log likelihood, its score, and the information if the modes were known."""
        size = self.layout.size
        score, information = np.zeros(size), np.zeros((size, size))
        with np.errstate(all="ignore"):
            if not all(np.isfinite(term.P).all() for term in self._cut(theta, cells)):
                return Evaluation(-np.inf, score, np.eye(size))
            terms, found = self.weighted(theta, cells)
            for term, S in zip(terms, self.S, strict=True):
                e = term.root[:, : len(S)] - term.root[:, len(S) :] @ term.P.T
                add_score(term, e, np.linalg.cholesky(S), score, information)
        return Evaluation(found.value, score, information)

    def evaluate_in(self, low: float, high: float) -> Callable[[np.ndarray], Evaluate]:
        log = self.over(low, high)
        return lambda cells: lambda theta: log.evaluate(theta, cells)
