"""How well a log knows each unknown: from the information, and for delays at a kink the profile."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.identification.maximum import Likelihood, maximise
from deadtime.identification.scoring import Maximum

LEVEL = 0.95
_NEAR = 4.0  # standard errors: a kink so close bends the likelihood within the interval
_UNSEEN = 1e-11  # of an eigenvalue of the information, scaled to a diagonal of ones


class Spread(NamedTuple):
    """The covariance of all unknowns, and how many standard errors an interval reaches."""

    covariance: Float[np.ndarray, "size size"]
    reach: float
    inflation: float


def spread_of(best: Maximum, names: list[str], observations: int) -> Spread:
    """The inverse of the information, for as many observations as there are; unknowns cost some.

    Raises
    ------
    ArgumentError
        If the log does not tell a direction of the unknowns, which is named.
    """
    from scipy.stats import t

    F, size = best.found.information, best.theta.size
    require_seen(F, names)
    unit = 1.0 / np.sqrt(np.diagonal(F))
    inverse = np.linalg.inv(F * unit[:, None] * unit) * unit[:, None] * unit
    spare = max(observations - size, 1)
    inflation = observations / spare
    return Spread(inverse * inflation, float(t.ppf(0.5 + 0.5 * LEVEL, spare)), inflation)


def require_seen(F: Float[np.ndarray, "size size"], names: list[str]) -> None:
    """Refuse an information that is singular, by the direction that it does not hold."""
    diagonal = np.diagonal(F)
    blind = [names[a] for a in np.flatnonzero(~(diagonal > 0.0)) if a < len(names)]
    if blind or not np.isfinite(F).all():
        raise ArgumentError(
            f"log tells nothing of {', '.join(blind) or 'its unknowns'}: what they multiply never "
            "moves. Excite it, or leave it out."
        )
    scaled = F / np.sqrt(diagonal)[:, None] / np.sqrt(diagonal)
    values, vectors = np.linalg.eigh(scaled)
    if values[0] > _UNSEEN:
        return
    direction = vectors[:, 0]
    part = np.abs(direction) > 0.2 * np.abs(direction).max()
    together = [names[a] if a < len(names) else "noise" for a in np.flatnonzero(part)]
    raise ArgumentError(
        f"log does not tell {', '.join(dict.fromkeys(together))} apart: they can all change "
        "together and nothing in it would. Log a run in which states and inputs move apart, such "
        "as with an input that is not a function of the state alone."
    )


def delay_intervals(
    log: Likelihood, best: Maximum, window: tuple[float, float], spread: Spread
) -> Float[np.ndarray, "delay 2"]:
    """The interval of each delay, seconds, within the range that is searched."""
    place = np.arange(log.layout.size - log.layout.delays, log.layout.size)
    error = np.sqrt(np.diagonal(spread.covariance))[place]
    result = np.empty((place.size, 2))
    for row, (a, own) in enumerate(zip(place.tolist(), error.tolist(), strict=True)):
        D = float(best.theta[a])
        near = log.recording.even and _to_kink(D, log.recording.step) < _NEAR * own
        if near:
            result[row] = [_profile_end(log, best, window, spread, a, own * s) for s in (-1, 1)]
        else:
            result[row] = D - spread.reach * own, D + spread.reach * own
    return np.clip(result, *log.bounds)


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
    return maximise(log, theta, fixed, window)[0].found.value - best.found.value


def _profile_end(
    log: Likelihood,
    best: Maximum,
    window: tuple[float, float],
    spread: Spread,
    place: int,
    step: float,
) -> float:
    """Where the profile has fallen as far as at an interval's end; the window's end at most."""
    from scipy.optimize import brentq

    D, fall = float(best.theta[place]), 0.5 * spread.reach**2 * spread.inflation

    def left(shift: float) -> float:
        return profile(log, best, window, place, D + shift) + fall

    inner, outer = 0.0, spread.reach * step
    while True:
        end = min(max(D + outer, window[0]), window[1])
        if left(end - D) < 0.0:
            found = brentq(left, inner, end - D, xtol=1e-3 * abs(step))
            return D + float(found)  # pyright: ignore[reportArgumentType]
        if end != D + outer:
            return end
        inner, outer = outer, 1.5 * outer
