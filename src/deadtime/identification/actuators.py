"""Actuators between a logged input and the plant: a lag, a limited rate, backlash.

A lag 1/(τs + 1) after a delay D is a mean over delays D + τ x with density e^{−x}. Between whole
periods the response of a plant is nearly linear in the delay, so the mean is a sum over the nodes
of a grid, with the integrals of its hat functions as weights.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

_DENSE = 5  # half periods near a delay that are all nodes


def delay_grid(low: float, high: float, D: float, step: float) -> Float[np.ndarray, " node"]:
    """Delays between which responses are nearly linear: half periods, sparser far from D."""
    unit = 0.5 * step
    first, last, near = (int(np.floor(one / unit)) for one in (low, high, D))
    away = np.unique(np.round(np.concatenate((np.arange(_DENSE), _DENSE * 1.6 ** np.arange(40)))))
    places = np.unique(near + np.concatenate((-away, away + 1)))
    places = places[(places >= first) & (places <= last + 1)]
    return unit * np.union1d(places, (first, last + 1))


def lag_weights(
    grid: Float[np.ndarray, " node"], first: float, lag: float
) -> Float[np.ndarray, " node"]:
    """∫ h_i(s) e^{−(s − first)/lag} ds/lag from `first` on, h_i the hat function of node i.

    Second differences of the second integral of the density; beyond the last node its value holds.

    Examples
    --------
    >>> weights = lag_weights(np.arange(0.0, 9.0, 0.5), 0.25, 1.0)
    >>> weights.sum().round(9), (weights @ np.arange(0.0, 9.0, 0.5)).round(3)
    (np.float64(1.0), np.float64(1.25))
    """
    s = np.maximum(grid - first, 0.0)
    slopes = np.diff(s + lag * np.expm1(-s / lag)) / np.diff(grid)
    return np.diff(slopes, prepend=0.0, append=1.0)


def rate_limited(
    u: Float[np.ndarray, " row"], t: Float[np.ndarray, " row"], rate: float, linear: bool = False
) -> Float[np.ndarray, " row"]:
    """The mean over each row of an output that moves to the input no faster than a rate.

    linear : whether the input changes linearly between rows; then the output at each row

    Examples
    --------
    >>> rate_limited(np.array([0.0, 3.0, 3.0, 3.0]), np.arange(4.0), 2.0)
    array([0.  , 1.  , 2.75, 3.  ])
    >>> rate_limited(np.array([0.0, 3.0, 3.0, 3.0]), np.arange(4.0), 2.0, linear=True)
    array([0., 2., 3., 3.])
    """
    if linear:
        return _at_rows(u, t, rate)
    result, now = np.empty(u.size), float(u[0])
    lengths = np.diff(t, append=np.inf)  # the last row's output is held
    for k, (target, length) in enumerate(zip(u, lengths, strict=True)):
        if not np.isfinite(target):
            result[k] = target
            continue
        now = now if np.isfinite(now) else float(target)
        gap, reach = float(target) - now, rate * float(length)
        if abs(gap) <= reach:
            result[k] = target - 0.5 * gap * abs(gap) / reach
            now = float(target)
        else:
            result[k] = now + 0.5 * np.sign(gap) * reach
            now += np.sign(gap) * reach
    return result


def _at_rows(
    u: Float[np.ndarray, " row"], t: Float[np.ndarray, " row"], rate: float
) -> Float[np.ndarray, " row"]:
    result, now = np.empty(u.size), float(u[0])
    for k, (target, length) in enumerate(zip(u, np.diff(t, prepend=t[0]), strict=True)):
        result[k] = target
        if np.isfinite(target):
            reach = rate * float(length)
            now = float(np.clip(target, now - reach, now + reach) if np.isfinite(now) else target)
            result[k] = now
    return result


def with_backlash(u: Float[np.ndarray, " row"], width: float) -> Float[np.ndarray, " row"]:
    """The output of play of a width, centred at first.

    Examples
    --------
    >>> with_backlash(np.array([0.0, 2.0, 1.5, 0.0]), 1.0)
    array([0. , 1.5, 1.5, 0.5])
    """
    result, now = np.empty(u.size), float(u[0])
    for k, value in enumerate(u):
        if np.isfinite(value):
            now = float(value) if not np.isfinite(now) else now
            now = min(max(now, value - 0.5 * width), value + 0.5 * width)
        result[k] = now
    return result
