"""Signals on the grid of samples: in which step, and how far into it, each switch falls."""

from __future__ import annotations

import numpy as np

from deadtime.plant.steps import TOLERANCE, Cuts, Window, snap_all
from deadtime.switching.signal import SwitchingSignal


def cuts_of(signal: SwitchingSignal, window: Window) -> Cuts:
    """Lay the switches of `signal` on the steps of `window`."""
    h, phase = window.step, window.phase
    times = signal.times[1:]
    ratio = snap_all(times / h)
    step = np.floor(ratio)
    offset = np.where(ratio == step, 0.0, times - step * h)
    if phase < h:
        late = snap_all((times - window.delay) / h)
        on_phase = (late == np.rint(late)) & (ratio != step)
        step = np.where(on_phase, late + (window.count - 1), step)
        offset = np.where(on_phase, phase, offset)
    return Cuts(step.astype(np.int64), offset, signal.modes)


def modes_at(signal: SwitchingSignal, times: np.ndarray, step: float) -> np.ndarray:
    """σ at the given times; a switch within 1e-9 h after one of them counts as at it.

    At the samples t_k these are the modes that a controller sees; at t_k + D, the modes that
    the inputs computed at t_k will meet.
    """
    return signal(times + TOLERANCE * step)
