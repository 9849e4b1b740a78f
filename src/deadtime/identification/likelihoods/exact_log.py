"""The likelihood of a log whose states are measured without noise: regressions, mode by mode."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from deadtime.identification.likelihoods.likelihood import PlantLikelihood
from deadtime.identification.parameters import cell_of
from deadtime.identification.regression import Term, concentrated, even_terms, lags_of
from deadtime.identification.scoring import Evaluate
from deadtime.identification.uneven import uneven_terms, usable

TermsOf = Callable[[np.ndarray], list[Term]]


@dataclass(frozen=True, eq=False)
class ExactLog(PlantLikelihood):
    """The likelihood of a recording whose states are measured without noise."""

    def terms_in(self, low: float, high: float) -> Callable[[np.ndarray], TermsOf]:
        """The regressions for delays between two, seconds, in cells of theirs."""
        record, layout = self.recording, self.layout
        if record.even:
            first, last = cell_of(low, record.step, up=True), cell_of(high, record.step)
            lags = lags_of(record.parts, layout, first - 1, last, self.within)
            return lambda cells: (
                lambda theta: even_terms(lags, layout, record.step, layout.spread(cells), theta)
            )
        good = [np.flatnonzero(usable(part, self.within, high, low)) for part in record.parts]
        return lambda _: (
            lambda theta: uneven_terms(record.parts, good, layout, record.step, self.nodes, theta)
        )

    def evaluate_in(self, low: float, high: float) -> Callable[[np.ndarray], Evaluate]:
        terms_in = self.terms_in(low, high)

        def within(cells: np.ndarray) -> Evaluate:
            terms = terms_in(cells)
            return lambda theta: concentrated(terms(theta), self.layout.size)[0]

        return within
