"""Expectation–maximisation over the plant: matrices, delays at any fraction of a period, noise.

Each step maximises, over A, B and D and with S that of the weighted residuals, the likelihood that
periods would have if their modes were known, weighted by how likely they are. That never lowers the
likelihood of the log (Dempster, Laird and Rubin, J. Royal Statistical Society B 39(1), 1977).
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.identification.cells import cells_of
from deadtime.identification.hidden.likelihood import HiddenLog
from deadtime.identification.hidden.periods import Posterior, next_chain
from deadtime.identification.hidden.regressions import rooted
from deadtime.identification.regression import Lags, concentrated, even_terms, stacked
from deadtime.identification.scoring import Evaluate, climb_cells

_GAIN = 1e-6  # of log likelihood that is still worth a step
_STEPS = 400
_REACH = 3  # periods on either side of the delays in which they are looked for next


class Ascent(NamedTuple):
    """Where the steps lead: the likelihood with its S and P, the unknowns, and the way up.

    values : log likelihood after every step; found : what the log says of the modes at the end
    """

    log: HiddenLog
    theta: Float[np.ndarray, " size"]
    values: Float[np.ndarray, " step"]
    found: Posterior


def ascended(
    log: HiddenLog,
    theta: Float[np.ndarray, " size"],
    least: float,
    found: Posterior | None = None,
) -> Ascent | None:
    """The maximum that a start leads to; None where a mode is left with less periods than `least`.

    The first step takes the modes as `found`, by default as the log's own S and P have them. S of
    regressions without a plant must not judge a plant that is near them alone: of little noise no
    period would seem to be of a mode.
    """
    place, h, values = log.layout.at_delays, log.recording.step, []
    if found is None:
        found = log.posterior(theta, cells_of(theta[place], h))
        values.append(found.value)
    for _ in range(_STEPS):
        if found.weight.sum(axis=0).min() < least:
            return None
        log, theta = _stepped(log, theta, found)
        found = log.posterior(theta, cells_of(theta[place], h))
        values.append(found.value)
        if len(values) > 1 and values[-1] - values[-2] < _GAIN:
            break
    return Ascent(log, theta, np.array(values), found)


def _stepped(
    log: HiddenLog, theta: np.ndarray, found: Posterior
) -> tuple[HiddenLog, Float[np.ndarray, " size"]]:
    """The next unknowns, S and P, given how likely each mode was."""
    layout, h, place = log.layout, log.recording.step, log.layout.at_delays
    cells = cells_of(theta[place], h)
    low = max(int(cells.min()) - 1 - _REACH, log.periods.first - 1)
    high = min(int(cells.max()) + _REACH, log.periods.last)
    each = zip(log.periods.parts, log.periods.usable, strict=True)
    z = np.vstack([stacked(part, k, low, high) for part, k in each])
    count = found.weight.sum(axis=0)
    lags = Lags([rooted(z, weight) for weight in found.weight.T], count, low, high)

    def in_cells(cells: np.ndarray) -> Evaluate:
        own = layout.spread(cells)
        return lambda vector: concentrated(even_terms(lags, layout, h, own, vector), layout.size)[0]

    window = max(log.bounds[0], low * h), min(log.bounds[1], high * h)
    best, cells = climb_cells(in_cells, theta, place, cells, h, window, log.limits)
    terms = even_terms(lags, layout, h, layout.spread(cells), best.theta)
    S = concentrated(terms, layout.size)[1]
    return replace(log, S=S, chain=next_chain(found.pairs)), best.theta
