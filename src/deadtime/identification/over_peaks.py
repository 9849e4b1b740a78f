"""Intervals of A and B where a log leaves several delays open: over all of them.

An interval about the likeliest delay takes that one for granted. Of many delays that noise makes
about as likely, the likeliest is where the input seems to do most, so that B alone would be told
too large, and too surely. So every plausible cell c of the delay has its own maximum θ_c, with
log L_c and information F_c, and what is known of an unknown is the mixture

    Σ_c w_c t_ν((θ − θ_c)/σ_c),    w_c ∝ L_c |F_c|^{−½},    σ_c² = (F_c⁻¹)_aa,

Laplace's approximation of what the log says where before it all delays were as likely. F_c is with
12/h² for the delay, what is known of one that is anywhere in a cell of length h. With noisy sensors
|F_c|^{−½} is that of A, B and the delay, whatever the noise is.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from deadtime.identification.intervals import LEVEL, Spread, inverse
from deadtime.identification.likelihoods.likelihood import Likelihood
from deadtime.identification.peaks import fresh_rise, plausible_fall
from deadtime.identification.scoring import Maximum, climb
from deadtime.identification.start import Start

_GAIN = 1e-3  # of log likelihood, that a cell's maximum may be short of


def ends_over_peaks(
    log: Likelihood, best: Maximum, spread: Spread, start: Start
) -> Float[np.ndarray, "unknown 2"] | None:
    """Of entries of A and B, the ends of intervals over all cells of a delay that are plausible.

    None where no delay has several peaks. Of several delays that have, the others stay in their
    cells, and intervals are joined.
    """
    place = np.arange(log.layout.size)[log.layout.at_delays]
    found = []
    for row, curve in enumerate(start.scanned):
        given = log.layout, start.weights, curve.size, float(spread.inflation[place[row]])
        level = curve.max() - plausible_fall(*given)
        top = int(curve.argmax())
        if any(fresh_rise(side, level) is not None for side in (curve[top::-1], curve[top:])):
            near = np.flatnonzero(curve >= level)
            begins = None if start.vectors is None else start.vectors[row][near]
            found.append(_mixed(log, best, spread, row, start.first + near, begins))
    if not found:
        return None
    return np.column_stack((np.min(found, axis=0)[:, 0], np.max(found, axis=0)[:, 1]))


def _mixed(
    log: Likelihood,
    best: Maximum,
    spread: Spread,
    row: int,
    cells: np.ndarray,
    begins: np.ndarray | None,
) -> Float[np.ndarray, "size 2"]:
    """The ends of all intervals over cells of one delay."""
    evaluate_in, h = log.evaluate_in(*log.bounds), log.recording.step
    size, place = log.layout.size, np.arange(log.layout.size)[log.layout.at_delays]
    inflation, centre, width, weight = spread.inflation[:size], [], [], []
    for k, cell in enumerate(cells):
        low, high = log.limits
        own, theta = log.cells(best.theta), best.theta.copy()
        own[row], theta[place[row]] = cell, (cell - 0.5) * h
        theta = theta if begins is None else begins[k]
        low[place] = np.maximum((own - 1) * h, log.bounds[0])
        high[place] = np.minimum(own * h, log.bounds[1])
        found = climb(evaluate_in(own), theta, low, high, gain=_GAIN, stride=log.stride)
        if not np.isfinite(found.found.value):
            continue
        F = found.found.information.copy()
        F[place[row], place[row]] += 12.0 / h**2
        told = log.told(found.theta, F)
        try:
            covariance = inverse(F[np.ix_(told, told)])[:size, :size]
        except np.linalg.LinAlgError:
            continue
        variance = np.diagonal(covariance) * inflation
        if not (np.isfinite(variance).all() and (variance > 0.0).all()):
            continue
        centre.append(found.theta[:size])
        width.append(np.sqrt(variance))
        value = found.found.value / float(inflation[place[row]])
        weight.append(value + 0.5 * np.linalg.slogdet(covariance)[1])
    weight = np.exp(np.array(weight) - np.max(weight))
    spare = spread.spare[:size]
    return mixture_ends(np.array(centre), np.array(width), weight / weight.sum(), spare)


def mixture_ends(
    centre: Float[np.ndarray, "cell size"],
    width: Float[np.ndarray, "cell size"],
    weight: Float[np.ndarray, " cell"],
    spare: Float[np.ndarray, " size"],
) -> Float[np.ndarray, "size 2"]:
    """Between which 95 % of mixtures of Student's distributions lie, as much below as above.

    Examples
    --------
    >>> one = mixture_ends(np.array([[3.0]]), np.array([[2.0]]), np.ones(1), np.array([1e9]))
    >>> one.round(3)
    array([[-0.92,  6.92]])
    """
    from scipy.special import stdtr, stdtrit

    ends = []
    for share in (0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL):
        each = centre + stdtrit(spare, share) * width
        low, high = each.min(axis=0), each.max(axis=0)
        for _ in range(60):
            middle = 0.5 * (low + high)
            above = weight @ stdtr(spare, (middle - centre) / width) > share
            low, high = np.where(above, low, middle), np.where(above, middle, high)
        ends.append(0.5 * (low + high))
    return np.column_stack(ends)
