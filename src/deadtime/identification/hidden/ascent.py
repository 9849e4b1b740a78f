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
from deadtime.identification.likelihoods.likelihood import maximise, window_of
from deadtime.identification.likelihoods.mode_periods import Posterior
from deadtime.identification.parameters import Vector
from deadtime.identification.regression import concentrated
from deadtime.identification.scoring import STEPS

_GAIN = 1e-6  # of log likelihood that is still worth a step
_STEPS = 400
_FEW = 4  # steps up the plant for one of the modes, where each takes a look at all of the log


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
    known, near = log.known(found.weight), window_of(log, theta[log.layout.at_delays])
    window = max(log.window[0], near[0]), min(log.window[1], near[1])
    steps = STEPS if log.sampling.summed_up else _FEW  # a rise is all that is asked for
    best, _ = maximise(known, theta, window=window, steps=steps)
    terms = known.terms_in(*window)(log.cells(best.theta))(best.theta)
    S = concentrated(terms, log.layout.size)[1]
    return replace(log, S=S, jumps=log.jumps.next(found.counts)), best.theta
