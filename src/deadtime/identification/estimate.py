"""An estimate as it is worked on, before it is handed over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from deadtime.base.frozen import Frozen
from deadtime.identification.intervals import Spread
from deadtime.identification.likelihoods.likelihood import Likelihood
from deadtime.identification.likelihoods.noisy_log import NoisyLog
from deadtime.identification.residuals import ResidualTests
from deadtime.identification.scoring import Maximum
from deadtime.identification.start import Start
from deadtime.plant import SwitchedSystem


@dataclass(frozen=True, eq=False, kw_only=True)
class Estimate(Frozen):
    """The likeliest plant under one description of the noise.

    log, best, window : the likelihood, where it is largest, and the delays that it was sought in;
    with noisy sensors the unknowns are those of the restricted likelihood, its value the largest
    spread : of all unknowns; intervals : (delays, 2), seconds
    several : (delays,), whether an interval holds other peaks; start : the first guess
    disturbance : (modes, n, n), W of each mode, x² per second
    noise : (p,), standard deviations of the sensors
    noise_errors : standard errors of W's diagonal, mode by mode, then of the sensors' variances
    spare : (modes,), how many periods each W rests on beyond those that the matrices cost
    ends : (unknowns, 2), of intervals of A and B where delays are open; None elsewhere
    white : of every log, the whitened residuals, NaN where there are none
    of_outputs : the likelihood, where states were found from outputs alone
    """

    log: Likelihood
    best: Maximum
    window: tuple[float, float]
    plant: SwitchedSystem
    spread: Spread
    intervals: Float[np.ndarray, "delay 2"]
    several: Bool[np.ndarray, " delay"]
    start: Start
    disturbance: Float[np.ndarray, "mode n n"]
    noise: Float[np.ndarray, " p"]
    noise_errors: Float[np.ndarray, " variance"]
    spare: Int[np.ndarray, " mode"]
    tests: ResidualTests
    white: tuple[Float[np.ndarray, "sample p"], ...]
    ends: Float[np.ndarray, "unknown 2"] | None = None
    of_outputs: NoisyLog | None = None
