"""How a plant from outputs alone follows a log: its states, and what it foretells."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.identification.likelihoods.noisy_log import NoisyLog
from deadtime.identification.log.recording import Part
from deadtime.identification.parameters import Vector, Window

_MOST = 10_000  # samples of a long log whose states are looked at


class Following(NamedTuple):
    """States of every sample of a part: given all of it, all before, and the first one alone.

    NaN where they are not known yet.
    """

    states: Float[np.ndarray, "sample n"]
    ahead: Float[np.ndarray, "sample n"]
    free: Float[np.ndarray, "sample n"]


def following(log: NoisyLog, vector: Vector, part: Part, window: Window) -> Following:
    """States of a part by the likeliest plant."""
    own = replace(log, recording=log.recording._replace(parts=(part,)))
    (start,) = starts = own.starts(*window)
    one_ahead, states, periods = own.filter(vector, starts).states(0)
    known = ~start & (np.cumsum(own.initial(starts)[0].sum(axis=1)) >= log.layout.n)
    ahead = np.where(known[:, None], one_ahead, np.nan)
    free = np.full(states.shape, np.nan)
    for k in np.flatnonzero(~start).tolist():
        before = free[k - 1] if np.isfinite(free[k - 1]).all() else states[k - 1]
        free[k] = periods.Phi[periods.kind[k]] @ before + periods.added[k]
    return Following(np.where(known[:, None], states, np.nan), ahead, free)


def largest_of(log: NoisyLog, vector: Vector, window: Window) -> Float[np.ndarray, " n"]:
    """The largest |x| of every state; of a long log in stretches from all over it."""
    parts = log.recording.stretches(_MOST, log.recording.lag(window[1])).parts
    states = np.vstack([following(log, vector, part, window).states for part in parts])
    return np.nanmax(np.abs(states), axis=0)
