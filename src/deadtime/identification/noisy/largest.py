"""The largest maximum of the likelihood with noisy sensors: climbs from scans of all delays.

Where measurements are noisy the likelihood has several maxima over the delays, and over how the
noise is shared between plant and sensors. So all delays are scanned about where each climb begins,
and again about the likeliest plant so far, until a scan leads no higher.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from deadtime.identification.likelihoods.noisy_log import NoisyLog
from deadtime.identification.maximum import maximise, window_of
from deadtime.identification.noisy.delay_scan import Scanned, scanned
from deadtime.identification.scoring import Maximum
from deadtime.identification.uneven import gridded

_ROUNDS = 3  # of scans, each about the likeliest plant so far
_BETTER = 0.1  # of log likelihood: cells that are worth going to
_GAIN = 1e-4  # of log likelihood that a beginning may be short of: a pole too many runs for ever
_NEARLY = 3.0  # of log likelihood: delays that may be the likeliest after all
_LESS = 1e-4  # of the plant's noise, where all errors may be the sensors'
_LOST = 0.5  # of the samples: a range of delays for which more are of no use is searched in part


def largest_maximum(
    log: NoisyLog,
    begins: Iterable[np.ndarray],
    climbed: Iterable[np.ndarray] = (),
    others: Callable[[np.ndarray], list[np.ndarray]] = lambda _: [],
) -> tuple[Maximum, Scanned]:
    """The likeliest vector that is found, and the last scan.

    begins : vectors whose A and noise a scan begins with; climbed : those that are climbed from as
    they are; others : what else to try beside a vector
    """
    begins, climbed = list(begins), list(climbed)
    log = replace(log, bounds=_searched(log, (*begins, *climbed)[0]))
    scan, grid = None, replace(log, recording=gridded(log.recording))
    found = [_climbed(log, begin) for begin in climbed]
    for begin in begins:
        scan = scanned(grid, begin)
        found.append(_climbed(log, scan.moved(begin)))
    best = max(found, key=lambda one: one.found.value)
    for _ in range(_ROUNDS):
        scan = scanned(grid, best.theta)
        beside = [of_sensors(log, best.theta), *others(best.theta), *_elsewhere(log, best, scan)]
        tried = [_climbed(log, one) for one in beside]
        top = max(tried, key=lambda one: one.found.value, default=best)
        if top.found.value < best.found.value + _BETTER:
            break
        best = top
    assert scan is not None
    return best, scan


def _searched(log: NoisyLog, theta: np.ndarray) -> tuple[float, float]:
    """The range of delays, or a part of it about a vector's where all of it would cost too much.

    What is usable of a log depends on how far back inputs must be known.
    """
    low, high = window_of(log, theta[log.layout.at_delays])
    most, least = (np.concatenate(log.starts(*ends)).sum() for ends in ((low, high), log.bounds))
    return (low, high) if least - most > _LOST * log.recording.samples else log.bounds


def _elsewhere(log: NoisyLog, best: Maximum, scan: Scanned) -> list[np.ndarray]:
    """Where else a maximum may be: where the scan is, and of each delay where it is nearly so."""
    place, h, found = log.layout.at_delays, log.recording.step, []
    if np.abs(scan.theta[place] - best.theta[place]).max() >= h:
        found.append(scan.moved(best.theta))
    for row, curve in enumerate(scan.curves):
        D = (scan.first + np.arange(curve.size) - 0.5) * h
        near = (curve > curve.max() - _NEARLY) & (np.abs(D - best.theta[place][row]) > 1.5 * h)
        if near.any():
            theta = best.theta.copy()
            theta[place.start + row] = D[near][curve[near].argmax()]
            found.append(theta)
    return found


def of_sensors(log: NoisyLog, vector: np.ndarray) -> np.ndarray:
    """The same plant, as if all that it cannot foretell were noise of the sensors.

    A climb does not come back by itself from a sensor without noise.
    """
    e, _ = log.innovations(vector, log.starts(*log.bounds))
    changed, (i, j) = vector.copy(), log.places
    L = slice(log.layout.size, log.layout.size + i.size)
    less = np.sqrt(_LESS)
    changed[L] = np.where(i == j, vector[L] + np.log(less), less * vector[L])
    error = np.sqrt(np.mean(e**2, axis=0))
    changed[L.stop :] = np.log(np.maximum(error, np.finfo(float).tiny))
    return changed


def _climbed(log: NoisyLog, vector: np.ndarray) -> Maximum:
    """The maximum that a vector leads to, over the whole range of delays."""
    return maximise(log, vector, window=log.bounds, gain=_GAIN)[0]
