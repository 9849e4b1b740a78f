"""Intervals of A and B where a log leaves several delays open: those about each of them, joined.

An interval about the likeliest delay takes that one for granted. Of many delays that noise makes
about as likely, the likeliest is where the input seems to do most, so that B alone would be told
too large, and too surely.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from deadtime.identification.intervals import Spread, inverse, plausible_fall
from deadtime.identification.maximum import ExactLog, Likelihood
from deadtime.identification.scoring import Maximum, climb
from deadtime.identification.start import Start


def ends_over_peaks(
    log: Likelihood,
    best: Maximum,
    spread: Spread,
    start: Start,
    several: Bool[np.ndarray, " delay"],
) -> Float[np.ndarray, "size 2"] | None:
    """Of every unknown, the ends of its interval over all cells of a delay that are plausible.

    None where no delay is open, or the log is not an even one of exact states.
    """
    if not several.any() or not isinstance(log, ExactLog) or not log.recording.even:
        return None
    half = spread.reach * np.sqrt(np.diagonal(spread.covariance))
    ends = np.column_stack((best.theta - half, best.theta + half))
    evaluate_in, own, h = log.evaluate_in(*log.bounds), log.cells(best.theta), log.recording.step
    place = np.arange(log.layout.size)[log.layout.at_delays]
    for row in np.flatnonzero(several):
        curve = start.scanned[row]
        fall = plausible_fall(log, curve.size, float(spread.inflation[place[row]]))
        for cell in start.first + np.flatnonzero(curve >= curve.max() - fall):
            low, high = (np.full(best.theta.size, end) for end in (-np.inf, np.inf))
            cells, theta = np.where(np.arange(own.size) == row, cell, own), best.theta.copy()
            low[place] = np.maximum((cells - 1) * h, log.bounds[0])
            high[place] = np.minimum(cells * h, log.bounds[1])
            theta[place[row]] = (cell - 0.5) * h
            found = climb(evaluate_in(cells), theta, low, high)
            try:
                variance = np.diagonal(inverse(found.found.information)) * spread.inflation
            except np.linalg.LinAlgError:  # a delay at which an input would do nothing
                continue
            half = spread.reach * np.sqrt(np.maximum(variance, 0.0))
            if np.isfinite(half).all():
                ends[:, 0] = np.minimum(ends[:, 0], found.theta - half)
                ends[:, 1] = np.maximum(ends[:, 1], found.theta + half)
    return ends
