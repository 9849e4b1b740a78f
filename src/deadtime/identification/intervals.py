"""How well a log knows each unknown: from the information, and for delays at a kink the profile."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from deadtime.base.errors import ArgumentError
from deadtime.identification.hidden.noisy_likelihood import HiddenNoisyLog
from deadtime.identification.maximum import Likelihood, maximise
from deadtime.identification.scoring import Maximum
from deadtime.identification.start import Start

LEVEL = 0.95
_NEAR = 4.0  # standard errors: a kink so close bends the likelihood within the interval
_UNSEEN = 1e-11  # of an eigenvalue of the information, scaled to a diagonal of ones


class Spread(NamedTuple):
    """The covariance of all unknowns, and how many standard errors an interval of each reaches.

    inflation : of each unknown's variance, over that of the information as it is
    """

    covariance: Float[np.ndarray, "size size"]
    reach: Float[np.ndarray, " size"]
    inflation: Float[np.ndarray, " size"]


def spread_of(
    F: Float[np.ndarray, "size size"],
    names: list[str],
    known: Float[np.ndarray, "size size"],
    spare: Float[np.ndarray, " size"],
) -> Spread:
    """The inverse of what is `known`, the information F less what the noise's own estimate costs.

    spare : observations beyond those that unknowns cost, of each unknown

    Raises
    ------
    ArgumentError
        If the log does not tell a direction of the unknowns, which is named.
    """
    from scipy.stats import t

    require_seen(F, names)
    covariance = inverse(known)
    inflation = np.diagonal(covariance) / np.diagonal(inverse(F))
    return Spread(covariance, np.asarray(t.ppf(0.5 + 0.5 * LEVEL, spare)), inflation)


def inverse(F: Float[np.ndarray, "size size"]) -> Float[np.ndarray, "size size"]:
    """F⁻¹, scaled so that units of the unknowns do not matter."""
    unit = 1.0 / np.sqrt(np.diagonal(F))
    return np.linalg.inv(F * unit[:, None] * unit) * unit[:, None] * unit


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
        if near and not isinstance(log, HiddenNoisyLog):  # whose profile takes minutes
            result[row] = [_profile_end(log, best, window, spread, a, own * s) for s in (-1, 1)]
        else:
            result[row] = D - reach * own, D + reach * own
        result[row] = np.clip(result[row], *log.bounds)
        wider = _other_peaks(log, result[row], start, row, float(spread.inflation[a]))
        several[row], result[row] = (wider != result[row]).any(), wider
    return result, several


def _other_peaks(
    log: Likelihood, interval: np.ndarray, start: Start, row: int, inflation: float
) -> np.ndarray:
    """An interval and all beyond it up to the last cell that a fresh rise makes plausible."""
    h, curve = log.recording.step, start.scanned[row]
    fall = plausible_fall(log, curve.size, inflation)
    ends = interval.copy()
    first = max(int(np.ceil(interval[0] / h - 1e-9)) - start.first, 0)  # the cell of the end
    last = max(int(np.ceil(interval[1] / h - 1e-9)) - start.first, 0)
    top = int(curve.argmax())  # a neighbour is the same peak: cells of uneven rows are rough
    first, last = first - (top == first - 1), last + (top == last + 1)
    below, above = curve[: first + 1][::-1], curve[last:]
    if (found := _last_rise(below, curve.max() - fall)) is not None:
        ends[0] = min(ends[0], (start.first + first - found - 1) * h)
    if (found := _last_rise(above, curve.max() - fall)) is not None:
        ends[1] = max(ends[1], (start.first + last + found) * h)
    return np.clip(ends, *log.bounds)


def plausible_fall(log: Likelihood, cells: int, inflation: float) -> float:
    """How far below the likeliest cell's log likelihood a plausible one's is at most.

    A cell's two weights per state are free in each mode that has the delay. Of as many cells as
    there are each may be the likeliest by chance, so that the level is Bonferroni's.
    """
    from scipy.stats import chi2

    layout = log.layout
    free = 2 * layout.n * (1 if layout.per_mode else layout.modes)
    return 0.5 * inflation * float(chi2.isf((1.0 - LEVEL) / cells, free))


def _last_rise(outwards: np.ndarray, level: float) -> int | None:
    """The last cell above a level that is likelier than one before it."""
    least = np.minimum.accumulate(outwards)
    found = np.flatnonzero((outwards > least) & (outwards >= level))
    return int(found[-1]) if found.size else None


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
