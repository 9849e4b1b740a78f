"""The maximum of a log's likelihood over all unknowns, or with some of them held."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from deadtime.identification.likelihoods.likelihood import Likelihood
from deadtime.identification.scoring import Maximum, climb, climb_cells

REACH = 3.0  # periods on either side of a delay that the log's start leaves room for


def window_of(
    log: Likelihood, delays: Float[np.ndarray, " delay"], reach: float = REACH
) -> tuple[float, float]:
    """Where delays are looked for next: some periods about where they are, within the bounds."""
    h = log.recording.step
    low = max(log.bounds[0], float(delays.min()) - reach * h)
    return low, min(log.bounds[1], float(delays.max()) + reach * h)


def maximise(
    log: Likelihood,
    theta: Float[np.ndarray, " size"],
    fixed: Bool[np.ndarray, " size"] | None = None,
    window: tuple[float, float] | None = None,
    gain: float | None = None,
) -> tuple[Maximum, tuple[float, float]]:
    """The maximum that a start leads to, and the window of delays that it was sought in.

    What is usable of a log depends on the window, so likelihoods compare in the same one only.
    `gain` is the rise of log likelihood that is worth a step; by default the likelihood's own.
    """
    place = log.layout.at_delays
    gain = log.gain if gain is None else gain
    h, asked = log.recording.step, window
    while True:
        low, high = asked or window_of(log, theta[place])
        evaluate_in, ends = log.evaluate_in(low, high), log.limits
        if log.recording.even:
            cells = log.cells(theta)
            reach = (low, high), ends, fixed, log.stride, gain
            best, _ = climb_cells(evaluate_in, theta, place, cells, h, *reach)
        else:
            ends[0][place], ends[1][place] = low, high
            if fixed is not None:
                ends[0][fixed], ends[1][fixed] = theta[fixed], theta[fixed]
            evaluate = evaluate_in(np.zeros(0, np.int64))
            best = climb(evaluate, theta, *ends, stride=log.stride, gain=gain)
        D, free = best.theta[place], np.ones(log.layout.delays, bool)
        if fixed is not None:
            free = ~fixed[place]
        edge = ((low >= D) & (low > log.bounds[0])) | ((high <= D) & (high < log.bounds[1]))
        if asked or not (edge & free).any() or np.array_equal(best.theta, theta):
            return best, (low, high)
        theta = best.theta
