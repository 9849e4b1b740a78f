"""The estimate from states measured without noise, by maximum likelihood from a scan of the delays.

Noise of a period has the covariance of the residuals, divided by N − p instead of N. See Ljung,
"System Identification", 2nd ed., Prentice Hall 1999, chapters 7 and 9.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.errors import ArgumentError
from deadtime.identification.estimate import Estimate
from deadtime.identification.identifiability import reasons, require_enough
from deadtime.identification.intervals import Peak, spread_of
from deadtime.identification.levels import without_level
from deadtime.identification.likelihoods.likelihood import (
    ExactLog,
    concentrated,
    maximise,
)
from deadtime.identification.log.recording import Recording
from deadtime.identification.parameters import Layout, Squares, Window
from deadtime.identification.residuals import FittedModel
from deadtime.identification.sampling import nodes_for
from deadtime.identification.start import start_of
from deadtime.identification.transition import continuous, intensity_errors


def estimate_exactly(
    recording: Recording, layout: Layout, bounds: Window, within: bool
) -> Estimate:
    """The estimate if states are measured without noise."""
    start = start_of(recording.gridded(), layout, bounds, within)
    nodes = nodes_for(recording.parts, layout.split(start.theta)[0])
    log = ExactLog(recording, layout, within, bounds, nodes)
    best, window = maximise(log, start.theta)
    log, kept = without_level(log, best.theta, best.information, np.eye(layout.n))
    if kept.size < layout.size:
        layout, recording = log.layout, log.recording
        best, window = maximise(log, best.theta[kept])
    terms = log.terms_in(*window)(log.cells(best.theta))(best.theta)
    counts = np.array([term.periods for term in terms])
    require_enough(recording, layout, counts, bounds[1])
    F, covariances = concentrated(terms, layout.size)
    spare = np.maximum(counts - layout.n - layout.acting - 1, 1)
    parts = [concentrated([term], layout.size)[0].information for term in terms]
    known = np.einsum("i,iab->ab", spare / counts, parts)
    try:
        spread = spread_of(F.information, layout.names(), known, layout.of_each(spare))
    except ArgumentError as error:
        why = [reasons(recording, j, bounds[1] - bounds[0]) for j in range(layout.m)]
        sentences = dict.fromkeys(itertools.chain(*why))
        raise ArgumentError(" ".join((str(error), *sentences))) from None
    peak = Peak(log=log, best=best, window=window, spread=spread, start=start)
    S = covariances * (counts / spare)[:, None, None]
    return estimate_of_plant(peak, S, spare, recording, ends=peak.ends_over_peaks())


def estimate_of_plant(
    peak: Peak,
    S: Squares,
    spare: Int[np.ndarray, " mode"],
    recording: Recording,
    *,
    usable: Sequence[np.ndarray] | None = None,
    ends: Float[np.ndarray, "unknown 2"] | None = None,
) -> Estimate:
    """Estimate and intervals at a peak with exact states and covariances S of a period's noise.

    spare : degrees of freedom of S in every mode; usable : periods of every part whose residuals
    count, by default all
    """
    log, theta = peak.log, peak.best.theta
    plant, constant = log.layout.plant(theta), log.layout.constant_of(theta)
    model = FittedModel(plant, constant, log.sampling)
    white = model.residuals(recording, log.within, np.linalg.cholesky(S))
    for one, k in zip(white, usable or (), strict=usable is not None):
        one[np.setdiff1d(np.arange(len(one)), k + 1)] = np.nan
    W = continuous(plant.A, S, recording.step)
    return Estimate.at(
        peak,
        plant,
        recording,
        white,
        disturbance=W,
        noise=np.zeros(log.layout.n),
        noise_errors=intensity_errors(plant.A, W, recording.step, spare),
        spare=spare,
        ends=ends,
    )
