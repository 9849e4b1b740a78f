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

from deadtime.identification.likelihoods.hidden_log import HiddenLog
from deadtime.identification.likelihoods.mode_periods import EvenPeriods, Posterior, UnevenPeriods
from deadtime.identification.parameters import Vector
from deadtime.identification.regression import (
    LagRoots,
    Term,
    concentrated,
    even_terms,
    rooted,
    stacked,
)
from deadtime.identification.scoring import Evaluate, Evaluation, climb, climb_cells

_GAIN = 1e-6  # of log likelihood that is still worth a step
_STEPS = 400
_FEW = 4  # steps up the plant of uneven rows for one of the modes
_REACH = 3  # periods on either side of the delays in which they are looked for next


class Ascent(NamedTuple):
    """Where the steps lead: the likelihood with its S and P, the unknowns, and the way up.

    values : log likelihood after every step; found : what the log says of the modes at the end
    """

    log: HiddenLog
    theta: Vector
    values: Float[np.ndarray, " step"]
    found: Posterior


def ascended(
    log: HiddenLog, theta: Vector, least: float, found: Posterior | None = None
) -> Ascent | None:
    """The maximum that a start leads to; None where a mode is left with less periods than `least`.

    The first step takes the modes as `found`, by default as the log's own S and P have them. S of
    regressions without a plant must not judge a plant that is near them alone: of little noise no
    period would seem to be of a mode.
    """
    values = []
    if found is None:
        found = log.posterior(theta, log.cells(theta))
        values.append(found.value)
    for _ in range(_STEPS):
        if found.weight.sum(axis=0).min() < least:
            return None
        log, theta = _stepped(log, theta, found)
        found = log.posterior(theta, log.cells(theta))
        values.append(found.value)
        if len(values) > 1 and values[-1] - values[-2] < _GAIN:
            break
    return Ascent(log, theta, np.array(values), found)


def _stepped(log: HiddenLog, theta: np.ndarray, found: Posterior) -> tuple[HiddenLog, Vector]:
    """The next unknowns, S and the chain, given how likely each mode was."""
    periods = log.periods
    if isinstance(periods, UnevenPeriods):
        theta, terms = _climbed(log, periods, theta, found)
    else:
        theta, terms = _climbed_evenly(log, periods, theta, found)
    S = concentrated(terms, log.layout.size)[1]
    return replace(log, S=S, jumps=log.jumps.next(found.counts)), theta


def _climbed(
    log: HiddenLog, periods: UnevenPeriods, theta: np.ndarray, found: Posterior
) -> tuple[Vector, list[Term]]:
    """A few steps up of uneven rows: a rise is all that is asked for."""
    low, high = log.limits
    low[log.layout.at_delays], high[log.layout.at_delays] = periods.low, periods.high
    none = np.zeros(0, np.int64)

    def evaluate(vector: np.ndarray) -> Evaluation:
        return concentrated(log.terms(vector, none, found.weight), log.layout.size)[0]

    best = climb(evaluate, theta, low, high, steps=_FEW)
    return best.theta, log.terms(best.theta, none, found.weight)


def _climbed_evenly(
    log: HiddenLog, periods: EvenPeriods, theta: np.ndarray, found: Posterior
) -> tuple[Vector, list[Term]]:
    """The maximum of even rows, from cell to cell."""
    layout, h, place = log.layout, log.recording.step, log.layout.at_delays
    cells = log.cells(theta)
    low = max(int(cells.min()) - 1 - _REACH, periods.first - 1)
    high = min(int(cells.max()) + _REACH, periods.last)
    each = zip(periods.parts, periods.usable, strict=True)
    z = np.vstack([stacked(part, k, low, high, layout.constant) for part, k in each])
    count = found.weight.sum(axis=0)
    lags = LagRoots([rooted(z, weight) for weight in found.weight.T], count, low, high)

    def in_cells(cells: np.ndarray) -> Evaluate:
        own = layout.spread(cells)
        return lambda vector: concentrated(even_terms(lags, layout, h, own, vector), layout.size)[0]

    window = max(log.bounds[0], low * h), min(log.bounds[1], high * h)
    best, cells = climb_cells(in_cells, theta, place, cells, h, window, log.limits)
    return best.theta, even_terms(lags, layout, h, layout.spread(cells), best.theta)
