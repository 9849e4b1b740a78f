"""Switching signals on the sampling grid: the period of each switch, and its offset in there."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from deadtime.plant.discretisation import TOLERANCE, Cuts, snap_all
from deadtime.plant.sampled_plant import SampledPlant
from deadtime.switching.signal import SwitchingSignal


@lru_cache(maxsize=4)
def cuts_of(signal: SwitchingSignal, sampled: SampledPlant) -> Cuts:
    """The switches of a signal by sampling period; within 1e-9 h of an arrival they are at it.

    The last are cached, so that runs along one signal share them, and with them the tables that a
    `SampledPlant` caches by its cuts.
    """
    h, times = sampled.step, signal.times[1:]
    ratio = snap_all(times / h)
    step = np.floor(ratio)
    offset = np.where(ratio == step, 0.0, times - step * h)
    for window in sampled.windows:
        if window.phase < h:
            # φ + k h is an arrival: a switch within 1e-9 h of one is at it, as at a sample.
            late = snap_all((times - window.delay) / h)
            on_phase = (late == np.rint(late)) & (ratio != np.floor(ratio))
            step = np.where(on_phase, late + (window.count - 1), step)
            offset = np.where(on_phase, window.phase, offset)
    return Cuts(step.astype(np.int64), offset, signal.modes)


def first_reads(
    signal: SwitchingSignal, delays: np.ndarray, times: np.ndarray, slack: float
) -> np.ndarray:
    """The times (times, m), seconds, at which inputs computed at some times are first read.

    That is the first instant t + θ ≥ t with θ ≥ D_i,j in the mode i of that instant. `delays` is
    (modes, m); a switch within `slack` seconds after an instant counts as at it.

    Examples
    --------
    >>> signal = SwitchingSignal([0.0, 1.0], [0, 1])
    >>> first_reads(signal, np.array([[0.5], [0.2]]), np.array([0.1, 0.6, 0.9]), 0.0).ravel()
    array([0.6, 1. , 1.1])
    """
    starts, ends = signal.times, np.append(signal.times[1:], np.inf) - slack
    place = np.searchsorted(ends, times, "right")
    result = np.full((times.size, delays.shape[1]), np.nan)
    missing = np.isnan(result)
    while missing.any():
        begin = np.maximum(starts[place], times)[:, None]
        instant = np.maximum(begin, times[:, None] + delays[signal.modes[place]])
        found = missing & (instant < ends[place][:, None])
        result[found] = instant[found]
        missing &= ~found
        place = np.minimum(place + 1, ends.size - 1)
    return result


def modes_at(signal: SwitchingSignal, times: np.ndarray, step: float) -> np.ndarray:
    """σ at the given times; a switch within 1e-9 h after one of them counts as at it."""
    return signal(times + TOLERANCE * step)
