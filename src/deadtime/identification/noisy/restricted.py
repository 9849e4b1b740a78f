"""Noise of a log whose matrices were fitted, too: restricted maximum likelihood.

The likeliest noise is too small, as a variance is that is divided by N where N − p are left: the p
unknowns θ of the plant have followed the noise. With θ integrated out (Laplace), what is left is
the likelihood of the noise η alone, over which Harville maximises:

    log L(θ, η) − ½ log det F_θθ(η).

The gradient g of the second term hardly moves with η, the logarithms of deviations: of one
regression it is p whatever η, so log L + gᵀη is maximised instead, which gives N − p exactly.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.identification.intervals import inverse
from deadtime.identification.likelihoods.noisy_log import NoisyLog
from deadtime.identification.scoring import Evaluate, Evaluation, Maximum, climb

_STEP = 1e-3  # of a logarithm, for differences
_GAIN = 1e-4  # of log likelihood that is still worth a step
_TOLD = 1.0  # information on a logarithm: one that is told to less than a factor of e stays
_FEWEST = 3.0  # degrees of freedom: of fewer Student's has no variance


class Restricted(NamedTuple):
    """The unknowns with restricted noise, their information, and the freedom each rests on."""

    theta: Float[np.ndarray, " size"]
    information: Float[np.ndarray, "size size"]
    spare: Float[np.ndarray, " size"]


def restricted(
    log: NoisyLog, some: NoisyLog, best: Maximum, window: tuple[float, float], most: float
) -> Restricted:
    """From the maximum of the likelihood; how information moves is seen on `some` of the log.

    Delays stay. most : degrees of freedom that there are at most
    """
    cells, size = log.cells(best.theta), log.layout.size
    evaluate, own = log.evaluate_in(*window)(cells), some.evaluate_in(*window)(cells)
    noise, unit = np.arange(size, log.size), log.unit(best.theta)[size:]
    told = np.diagonal(best.found.information)[size:] * unit**2 > _TOLD
    moves = _moves(own, best.theta, noise[told], unit[told])[:, :size, :size]
    moves *= log.recording.samples / some.recording.samples
    free, C = log.free[log.free < size], np.zeros((size, size))
    C[np.ix_(free, free)] = inverse(best.found.information[np.ix_(free, free)])
    gradient = np.zeros(log.size)
    gradient[noise[told]] = -0.5 * np.einsum("ab,cba->c", C, moves)

    def tilted(theta: np.ndarray) -> Evaluation:
        found = evaluate(theta)
        more = float(gradient @ (theta - best.theta))
        return Evaluation(found.value + more, found.score + gradient, found.information)

    low, high = log.limits
    still = np.concatenate((np.arange(size)[log.layout.at_delays], noise[~told]))
    low[still], high[still] = best.theta[still], best.theta[still]
    after = climb(tilted, best.theta, low, high, gain=_GAIN, stride=log.stride)
    value = after.found.value - float(gradient @ (after.theta - best.theta))
    if not value > best.found.value - free.size:  # so much less likely it is no correction any more
        return Restricted(best.theta, best.found.information, np.full(log.size, most))
    fewer = np.sqrt(np.append(np.ones(size), _shares(log, best.theta, after.theta)))
    F = after.found.information * fewer[:, None] * fewer
    slopes = np.zeros((size, moves.shape[0]))
    slopes[free] = -np.einsum("ab,cbd,da->ac", C, moves, C)[free] / np.diagonal(C)[free, None]
    error = np.linalg.pinv(F[np.ix_(noise[told], noise[told])])
    variance = np.einsum("ac,cd,ad->a", slopes, error, slopes)  # of the logarithms of variances
    spare = np.full(log.size, most)
    spare[:size] = np.maximum(2.0 / np.maximum(variance, 2.0 / most), min(_FEWEST, most))
    return Restricted(after.theta, F, spare)


def _moves(
    evaluate: Evaluate, theta: np.ndarray, places: np.ndarray, units: np.ndarray
) -> Float[np.ndarray, "place size size"]:
    """The derivatives of the information by unknowns of the noise."""
    now = evaluate(theta).information
    moves = np.empty((places.size, *now.shape))
    for row, (place, unit) in enumerate(zip(places, units, strict=True)):
        ahead = theta.copy()
        ahead[place] += _STEP * unit
        moves[row] = (evaluate(ahead).information - now) / (_STEP * unit)
    return moves


def _shares(log: NoisyLog, likeliest: np.ndarray, theta: np.ndarray) -> Float[np.ndarray, " noise"]:
    """(N − p)/N of every unknown of the noise: its variance before, over that after."""
    before, after = log.noise(likeliest), log.noise(theta)
    of_W = np.diagonal(before.W) / np.diagonal(after.W)
    return np.minimum(
        np.concatenate((of_W[log.places[0]], (before.deviation / after.deviation) ** 2)), 1.0
    )
