"""Whether a law stands delays that each err by themselves, in every mode held."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from deadtime.margins import delay_margin
from deadtime.plant import SwitchedSystem
from deadtime.spectrum import growth_rate

if TYPE_CHECKING:
    from deadtime.feedback import Law

MOST_INPUTS = 4  # of a box whose corners are all looked at


def failure_of(
    plant: SwitchedSystem, interval: Float[np.ndarray, "mode m 2"], law: Law, step: float
) -> str:
    """What a law does not stand, in words; "" if nothing: of each input alone, and of corners.

    In a mode that is held its own delays alone act, so that corners are taken in all modes at once.
    """
    for j in range(plant.inputs):
        margin = delay_margin(plant, law, step, input=j)
        if margin.lower is None or margin.upper is None:
            return "a mode grows at the likeliest delays"
        off = interval[:, j] - plant.delays[:, j, None]
        short, long = margin.lower - margin.nominal, margin.upper - margin.nominal
        if off[:, 0].min() < short or off[:, 1].max() > long:
            return f"that of input {j} alone is borne from {short:+.2g} to {long:+.2g} s"
    for corner in itertools.product((0, 1), repeat=plant.inputs):
        delays = interval[:, np.arange(plant.inputs), corner]
        truth = SwitchedSystem(plant.A, plant.B, delays)
        for mode in range(plant.modes):
            if growth_rate(truth, law, mode, step) >= 0.0:
                at = ", ".join(f"{D:.4g}" for D in delays[mode])
                return f"with true delays of {at} s mode {mode} does not decay"
    return ""
