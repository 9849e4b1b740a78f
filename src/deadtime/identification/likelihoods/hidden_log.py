"""The likelihood of a log whose modes are hidden, in the unknowns of the plant.

    log L(θ, S, P) = log Σ_σ p(σ) Π_k N(x_{k+1} − P_σ(θ) r_k; 0, S_σ),
    ∂ log L = Σ_k Σ_i γ_k(i) ∂ log N_i,k,    γ: how likely the mode is, given all of the log

The second is Fisher's identity. Steps are scaled by the information that the log would hold if the
modes were known with these weights; what not knowing them takes from it is in `information`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Int

from deadtime.identification.likelihoods.jumps import Jumps
from deadtime.identification.likelihoods.likelihood import ExactLog, PlantLikelihood
from deadtime.identification.likelihoods.mode_periods import Periods, Posterior
from deadtime.identification.parameters import Cells, Vector, Window
from deadtime.identification.regression import Term, add_score, log_density, rooted
from deadtime.identification.scoring import EvaluateIn, Evaluation


@dataclass(frozen=True, eq=False)
class HiddenLog(PlantLikelihood):
    """The likelihood of a recording whose modes are hidden, S of every mode and the chain held.

    periods : those that are usable in a window of the delays
    """

    periods: Periods = field(repr=False)
    S: Float[np.ndarray, "mode n n"]
    jumps: Jumps

    def ordered(self, order: Int[np.ndarray, " mode"]) -> HiddenLog:
        """With modes in another order."""
        return replace(self, S=self.S[order], jumps=self.jumps.ordered(order))

    def over(self, low: float, high: float) -> HiddenLog:
        """The likelihood of the periods that are usable for delays between two, seconds."""
        return replace(self, periods=self.periods.over(low, high))

    @property
    def window(self) -> Window:
        """The range of delays that the periods are usable for."""
        low, high = self.periods.window
        return max(self.bounds[0], low), min(self.bounds[1], high)

    def known(self, weight: Float[np.ndarray, "period mode"]) -> ExactLog:
        """The likelihood if each period were in a mode as likely as that, its noise eliminated."""
        given = self.recording, self.layout, self.within, self.bounds, self.nodes
        return ExactLog(*given, self.periods.usable, weight)

    def densities(self, theta: Vector, cells: Cells) -> Float[np.ndarray, "period mode"]:
        """The log density of every usable period in each mode."""
        maps = self.sampling.maps(self.layout, theta, cells)
        each = zip(self._rows(theta, cells), maps, self.S, strict=True)
        return np.column_stack([log_density(z, own.P, S) for z, own, S in each])

    def posterior(self, theta: Vector, cells: Cells) -> Posterior:
        """What the log says of the modes."""
        return self.periods.posterior(self.densities(theta, cells), self.jumps)

    def path(self, theta: Vector, cells: Cells) -> list[Int[np.ndarray, " sample"]]:
        """The likeliest modes of the samples of every part."""
        return self.periods.path(self.densities(theta, cells), self.jumps)

    def _rows(self, theta: Vector, cells: Cells) -> list[np.ndarray]:
        """The rows of every mode's regression: all usable periods, as if they were of it."""
        return self.periods.rows_of_modes(self.sampling.reads(self.layout, theta, cells))

    def weighted(self, theta: Vector, cells: Cells) -> tuple[list[Term], Posterior]:
        """The regressions over the periods of each mode, as likely as that is; and what is said."""
        found, maps = self.posterior(theta, cells), self.sampling.maps(self.layout, theta, cells)
        each = zip(self._rows(theta, cells), found.weight.T, maps, strict=True)
        return [Term(rooted(z, own), float(own.sum()), *one) for z, own, one in each], found

    def evaluate(self, theta: Vector, cells: Cells) -> Evaluation:
        """The log likelihood, its score, and the information if the modes were known."""
        size = self.layout.size
        score, information = np.zeros(size), np.zeros((size, size))
        with np.errstate(all="ignore"):
            maps = self.sampling.maps(self.layout, theta, cells)
            if not all(np.isfinite(one.P).all() for one in maps):
                return Evaluation(-np.inf, score, np.eye(size))
            terms, found = self.weighted(theta, cells)
            for term, S in zip(terms, self.S, strict=True):
                e = term.root[:, : len(S)] - term.root[:, len(S) :] @ term.P.T
                add_score(term, e, np.linalg.cholesky(S), score, information)
        return Evaluation(found.value, score, information)

    def evaluate_in(self, low: float, high: float) -> EvaluateIn:
        log = self.over(low, high)
        return lambda cells: lambda theta: log.evaluate(theta, cells)
