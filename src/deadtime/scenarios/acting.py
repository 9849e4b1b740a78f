"""What acts on a plant over a period: its state at the sample, inputs of several lags, and forces.

A disturbance is a constant force over each stretch (`simulation.forcing`), beside the inputs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import read_only
from deadtime.plant import SampledPlant
from deadtime.plant.pieces import Stretches


class Acting(NamedTuple):
    """The stretches of all modes on one vector, z = (x_k, u_{k−l} for the l of `lags`, forces).

    states : the entries of x; plain : those of x and the inputs; wide : those of z
    lags : (lags,), oldest first
    stretches : those of every mode; column : (stretches, inputs), the entry of z that is input j of
        B (modes, n, inputs), to which forces add n unit vectors
    edges : (parts + 1,), seconds: between two of these no stretch of any mode begins or ends
    arrival, arriving : (arrivals,), seconds into the period at which an input u_{k−l} begins to
        act, and its l
    """

    states: int
    plain: int
    wide: int
    lags: Int[np.ndarray, " lag"]
    stretches: Stretches
    column: Int[np.ndarray, "stretch input"]
    B: Float[np.ndarray, "mode n input"]
    edges: Float[np.ndarray, " part+1"]
    arrival: Float[np.ndarray, " arrival"]
    arriving: Int[np.ndarray, " arrival"]


def acting_of(sampled: SampledPlant, forced: bool = False) -> Acting:
    """What acts on a sampled plant; if `forced`, a force over each stretch, too.

    Stretches of the same place in their modes' periods have the same force.

    Examples
    --------
    >>> from deadtime.plant import SwitchedSystem
    >>> acting = acting_of(SampledPlant(SwitchedSystem([[[0.0]]], [[[1.0]]], delay=0.27), 0.1))
    >>> acting.lags, acting.column.ravel(), acting.edges.round(12), acting.arriving
    (array([3, 2]), array([1, 2]), array([0.  , 0.07, 0.1 ]), array([2]))
    """
    stretches, n, m = sampled.every_stretch, sampled.plant.states, sampled.plant.inputs
    lags = np.unique(stretches.lag)[::-1]
    block = np.searchsorted(-lags, -stretches.lag)
    column, B, wide = n + block * m + np.arange(m), sampled.plant.B, n + lags.size * m
    plain = wide
    if forced:
        place = np.concatenate([np.arange(count) for count in np.diff(stretches.first)])
        column = np.concatenate((column, plain + place[:, None] * n + np.arange(n)), axis=1)
        B = np.concatenate((B, np.broadcast_to(np.eye(n), sampled.plant.A.shape)), axis=2)
        wide += (int(place.max()) + 1) * n
    edges = np.unique(np.concatenate((stretches.start, stretches.stop)))
    begins = np.flatnonzero(stretches.start > 0.0)
    arrivals = {
        (float(stretches.start[s]), int(lag))
        for s in begins
        for lag in stretches.lag[s][stretches.lag[s] != stretches.lag[s - 1]]
    }
    pairs = np.reshape(sorted(arrivals), (-1, 2))
    arrays = lags.copy(), column, B.copy(), edges, pairs[:, 0].copy(), pairs[:, 1].astype(np.int64)
    lags, *rest = map(read_only, arrays)
    return Acting(n, plain, wide, lags, stretches, *rest)
