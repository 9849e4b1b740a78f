"""Intervals of delays: from the information, at a kink from the profile, and over other peaks."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from deadtime.identification.intervals import Spread
from deadtime.identification.likelihoods.likelihood import Likelihood
from deadtime.identification.maximum import maximise
from deadtime.identification.peaks import over_other_peaks
from deadtime.identification.scoring import Maximum
from deadtime.identification.start import Start

_WORTH = 1e-5  # of log likelihood, which falls by 1.9 or more to the end of an interval
_NEAR = 4.0  # standard errors: a kink so close bends the likelihood within the interval


def delay_intervals(
    log: Likelihood,
    best: Maximum,
    window: tuple[float, float],
    spread: Spread,
    start: Start,
) -> tuple[Float[np.ndarray, "delay 2"], Bool[np.ndarray, " delay"]]:
    """The interval of each delay, seconds, within the range that is searched.

    And whether it goes on beyond delays that are less likely than its end: to another peak.
    """
    place = np.arange(log.layout.size)[log.layout.at_delays]
    error = np.sqrt(np.diagonal(spread.covariance))[place]
    result, several = np.empty((place.size, 2)), np.zeros(place.size, bool)
    for row, (a, own) in enumerate(zip(place.tolist(), error.tolist(), strict=True)):
        D, reach = float(best.theta[a]), float(spread.reach[a])
        near = log.recording.even and _to_kink(D, log.recording.step) < _NEAR * own
        if near and log.profiled:
            result[row] = [_profile_end(log, best, window, spread, a, own * s) for s in (-1, 1)]
        else:
            result[row] = D - reach * own, D + reach * own
        result[row] = np.clip(result[row], *log.bounds)
        wider = over_other_peaks(log, result[row], start, row, float(spread.inflation[a]))
        several[row], result[row] = (wider != result[row]).any(), wider
    return result, several


def _to_kink(delay: float, step: float) -> float:
    """How far a delay is from a whole number of periods."""
    return abs(delay - step * round(delay / step))


def profile(
    log: Likelihood,
    best: Maximum,
    window: tuple[float, float],
    place: int,
    delay: float,
) -> float:
    """The log likelihood with one delay held, less the largest one."""
    theta, fixed = best.theta.copy(), np.zeros(best.theta.size, bool)
    theta[place], fixed[place] = delay, True
    return maximise(log, theta, fixed, window, _WORTH)[0].found.value - best.found.value


def _profile_end(
    log: Likelihood,
    best: Maximum,
    window: tuple[float, float],
    spread: Spread,
    place: int,
    step: float,
) -> float:
    """Where the profile has fallen as far as at an interval's end; the range's end at most.

    Where it has not at the window's end, all is maximised anew in a window twice as wide.
    """
    from scipy.optimize import brentq

    reach = float(spread.reach[place])
    D, fall = float(best.theta[place]), 0.5 * reach**2 * float(spread.inflation[place])
    top = best

    def left(shift: float) -> float:
        return profile(log, top, window, place, D + shift) + fall

    inner, outer = 0.0, reach * step
    while True:
        end = min(max(D + outer, window[0]), window[1])
        if left(end - D) < 0.0:
            if left(inner) < 0.0:  # in a wider window the top may lie elsewhere
                return D + inner
            found = brentq(left, inner, end - D, xtol=1e-3 * abs(step))
            return D + float(found)  # pyright: ignore[reportArgumentType]
        inner = end - D
        if end == D + outer:
            outer = 1.5 * outer
        elif end in log.bounds:
            return end
        else:
            window = widened(window, log.bounds)
            top = maximise(log, best.theta, window=window)[0]


def widened(window: tuple[float, float], bounds: tuple[float, float]) -> tuple[float, float]:
    """A window twice as wide, within bounds."""
    half = 0.5 * (window[1] - window[0])
    return max(bounds[0], window[0] - half), min(bounds[1], window[1] + half)
