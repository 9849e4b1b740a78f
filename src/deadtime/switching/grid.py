"""Signals on the grid of samples: in which step, and how far into it, each switch falls."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from deadtime.plant.discretisation import TOLERANCE, Cuts, snap_all
from deadtime.plant.sampled_plant import SampledPlant
from deadtime.switching.signal import SwitchingSignal


@lru_cache(maxsize=4)
def cuts_of(signal: SwitchingSignal, sampled: SampledPlant) -> Cuts:
    """Lay the switches of `signal` on a plant's periods; those at an arrival are exactly there.

    Runs along one signal share its cuts, and by them what a `SampledPlant` makes of these.
    """
    h, times = sampled.step, signal.times[1:]
    ratio = snap_all(times / h)
    step = np.floor(ratio)
    offset = np.where(ratio == step, 0.0, times - step * h)
    for window in sampled.windows:
        if window.phase < h:
            late = snap_all((times - window.delay) / h)
            on_phase = (late == np.rint(late)) & (ratio != np.floor(ratio))
            step = np.where(on_phase, late + (window.count - 1), step)
            offset = np.where(on_phase, window.phase, offset)
    return Cuts(step.astype(np.int64), offset, signal.modes)


def first_reads(
    signal: SwitchingSignal, delays: np.ndarray, times: np.ndarray, slack: float
) -> np.ndarray:
    """When a plant first reads what is sent at some times, by input, (times, m), seconds.

    That is the first instant t + θ ≥ t with θ ≥ D_i,j in the mode i of that instant. `delays`
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
    """σ at the given times; a switch within 1e-9 h after one of them counts as at it.

    At the samples t_k these are the modes that a controller sees; at t_k + D, the modes that
    the inputs computed at t_k will meet.
    """
    return signal(times + TOLERANCE * step)
