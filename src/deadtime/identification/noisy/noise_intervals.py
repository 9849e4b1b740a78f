"""Intervals of noise: of W's diagonal, and of the sensors' deviations.

Of a variance w with an error E the logarithm is nearly normal where E is well below w. Else w is:
where the log does not tell it from none its interval begins at 0, w + 1.96 E is the other end, and
all there is to say is that it is less. Near 0 the log likelihood is a parabola in w: F, that on
log √w, is next to nothing there, but E = 2 w/√F is not.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from deadtime.identification.estimate import Estimate
from deadtime.identification.likelihoods.noisy_log import SensorLikelihood

_REACH = 1.959963984540054  # of a normal distribution's 95 %
_OWN = 0.5  # of a variance: an error beyond which it may be none


def noise_interval(found: Estimate, place: int) -> tuple[float, float]:
    """Of W's diagonal, mode by mode, then of the sensors' deviations."""
    W = np.diagonal(found.disturbance, axis1=1, axis2=2).ravel()
    variance = float(np.append(W, found.noise**2)[place])
    low, high = ends(variance, float(found.noise_errors[place]))
    return (low, high) if place < W.size else (float(np.sqrt(low)), float(np.sqrt(high)))


def sensor_intervals(found: Estimate) -> list[tuple[float, float]]:
    """Of every sensor's deviation, where measurements are noisy."""
    first = found.disturbance.shape[0] * found.disturbance.shape[1]
    return [noise_interval(found, first + j) for j in range(found.noise.size)]


def ends(value: float, error: float) -> tuple[float, float]:
    """The interval of a variance.

    Examples
    --------
    >>> [round(end, 3) for end in ends(1.0, 0.1)], [round(end, 3) for end in ends(0.001, 1.0)]
    ([0.822, 1.217], [0.0, 1.961])
    """
    if error > _OWN * value:
        return max(0.0, value - _REACH * error), value + _REACH * error
    wide = float(np.exp(_REACH * error / value)) if value else 1.0
    return value / wide, value * wide


def variance_errors(
    log: SensorLikelihood,
    vector: Float[np.ndarray, " size"],
    covariance: Float[np.ndarray, "size size"],
) -> Float[np.ndarray, " variance"]:
    """Standard errors of W_aa = Σ_b L_ab², mode by mode, and of sensors' variances.

    To second order in L_ab.
    """
    size, (i, j), n = log.layout.size, log.places, log.layout.n
    C, L = covariance[size:, size:], log.root(vector)
    off = i != j
    slope = np.zeros((n + len(log.C), len(C)))
    slope[i, np.arange(i.size)] = 2.0 * np.where(off, L[i, j], L[i, j] ** 2)
    sensors = np.arange(len(log.C))
    slope[n + sensors, i.size + sensors] = 2.0 * log.noise(vector).deviation ** 2
    variance = np.einsum("va,ab,vb->v", slope, C, slope)
    for a in range(n):
        own = np.flatnonzero(off & (i == a))
        with np.errstate(over="ignore"):  # what the log does not tell at all may be any
            variance[a] += 2.0 * float((C[np.ix_(own, own)] ** 2).sum())
    W, R = np.split(np.sqrt(variance), [n])
    return np.concatenate((np.tile(W, log.layout.modes), R))


def exact_holds(exact: Estimate, noisy: Estimate) -> bool:
    """Whether measurements may be taken as exact: sensors' noise is not told, and little changes.

    Else the exact estimate is biased, and its intervals are too narrow by far.
    """
    if not exact.tests.white or noisy.several.any():
        return False
    low = np.maximum(exact.intervals, noisy.intervals)[:, 0]
    high = np.minimum(exact.intervals, noisy.intervals)[:, 1]
    return bool((low <= high).all()) and all(least == 0.0 for least, _ in sensor_intervals(noisy))
