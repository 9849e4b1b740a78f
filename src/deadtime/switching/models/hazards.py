"""Hazards of a sojourn on a grid of samples: what a controller that counts samples works with.

Age a means that the mode has been active for a samples, a h seconds.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import positive
from deadtime.base.errors import ArgumentError
from deadtime.switching.models.sojourns import Distribution, describe, log_survival, survival

MOST_AGES = 100_000
SURVIVAL = 1e-6
_STEEP = 1e-6


def hazards(
    dist: Distribution, step: float, ages: Int[np.ndarray, " age"]
) -> Float[np.ndarray, " age"]:
    """haz(a) = P(S ≤ (a+1) h | S > a h) = 1 − exp(logsf((a+1) h) − logsf(a h)); 1 if S ≤ a h.

    An atom or support end within 1e-9 h after sample k counts as at it: where survival falls
    steeply between k h and (k + 1e-9) h, it is read at the second.
    """
    from deadtime.plant.steps import TOLERANCE

    samples = np.union1d(ages, ages + 1)
    at, past = (log_survival(dist, (samples + late) * step) for late in (0.0, TOLERANCE))
    with np.errstate(invalid="ignore"):
        log = np.where(at - past < _STEEP, at, past)
        log = np.where(samples > 0, log, 0.0)
        before, after = (log[np.searchsorted(samples, sample)] for sample in (ages, ages + 1))
        result = -np.expm1(np.minimum(after - before, 0.0))
    return np.where(np.isnan(result), 1.0, result + 0.0)  # 0, not −0


def count_ages(name: str, dist: Distribution, step: float, most: int | None = None) -> int:
    """How many ages have a hazard of their own: later ones repeat the last, or hardly occur.

    The count stops at `most`; without one, more than 100,000 are refused.
    """
    last = _survival_limit(dist, step)
    final = hazards(dist, step, np.array([last - 1]))

    def latest(ages: Int[np.ndarray, " age"]) -> int:
        """The latest of these ages whose hazard is not the final one; −1 if none is."""
        differing = np.flatnonzero(np.abs(hazards(dist, step, ages) - final) > 1e-12)
        return int(ages[differing[-1]]) if differing.size else -1

    limit = max(MOST_AGES, most or 0)
    number = 0
    if last > limit:  # is the hazard constant long before, as an exponential's is?
        number = latest(np.geomspace(limit, last - 1, 1000).astype(np.int64)) + 2
    for end in range(min(last, limit), 0, -MOST_AGES):
        number = number if number > 1 else latest(np.arange(max(0, end - MOST_AGES), end)) + 2
    if number > limit and most is None:
        raise ArgumentError(
            f"step = {step:g} s is too short for {name} = {describe(dist)}: its hazard still "
            f"changes after {MOST_AGES:,} steps, which it outlives with probability "
            f"{survival(dist, MOST_AGES * step):.2g}; lengthen the step, or say with `most` how "
            "many ages to tell apart."
        )
    return number if most is None else min(number, most)


def _survival_limit(dist: Distribution, step: float) -> int:
    """The least n with P(S > n h) < 1e-6; 2⁴⁰ if there is none below."""
    from deadtime.plant.steps import TOLERANCE

    low, high = 0, 1
    while high < 2**40 and survival(dist, (high + TOLERANCE) * step) >= SURVIVAL:
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        if survival(dist, (middle + TOLERANCE) * step) >= SURVIVAL:
            low = middle
        else:
            high = middle
    return high


def require_short(step: float, sojourn: tuple[Distribution, ...]) -> float:
    """The step, when every mode's median sojourn spans at least two of them."""
    step = positive("step", step)
    for mode, dist in enumerate(sojourn):
        if survival(dist, 2.0 * step * (1.0 - 1e-9)) < 0.5:
            median = _median_below(dist, 2.0 * step)
            longest = median / 2.0
            unit = 10.0 ** (np.floor(np.log10(longest)) - 3.0)
            raise ArgumentError(
                f"step = {step:g} s is too long for the sojourns: half of those in mode {mode} "
                f"last at most {median:.4g} s, less than two steps; take at most "
                f"{np.floor(longest / unit) * unit:.4g} s."
            )
    return step


def _median_below(dist: Distribution, high: float) -> float:
    """The median, known to be below `high`, by bisection."""
    low = high / 2.0
    while survival(dist, low) < 0.5:
        low, high = low / 2.0, low
    for _ in range(60):
        middle = (low + high) / 2.0
        low, high = (middle, high) if survival(dist, middle) >= 0.5 else (low, middle)
    return high
