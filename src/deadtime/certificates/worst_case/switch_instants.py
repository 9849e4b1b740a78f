"""Local search over the instants of the switches, off the grid, on the loop itself.

A cycle of n switches over K periods is changed at a reach: one sojourn longer or shorter and the
cycle with it, all of them, one switch earlier or later, or all switches against the samples. What
is not admissible is moved to the nearest sojourns that are. A change that helps is kept; where
none does the reach is halved, from several periods down to 1/64 of one. Below one period the
length K stays.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from deadtime.certificates.worst_case.admissible import Admissible
from deadtime.certificates.worst_case.cycle_growth import Growing, Growth, SampledLoop
from deadtime.certificates.worst_case.cycles import Cycle

REACH = 1.0 / 40.0  # of the longest sojourn: where the search begins
FINEST = 1.0 / 64.0  # of a period
LONG = 60  # periods; a longer cycle is fine enough as it is
MOST_TIMES = 5
WORTH = 1e-3  # growth over a cycle for which a longer one is worth it
COARSE = 1e-6  # relative error of eigenvalues while searching
GAIN = 1e-9  # per period; a smaller gain is none


def polish(
    loop: Growing,
    signals: Admissible,
    cycle: Cycle,
    growth: Growth,
    most: int,
    longest: float = math.inf,
) -> tuple[Cycle, Growth, int]:
    """The cycle improved, its growth, and how many cycles were evaluated, at most `most`.

    No cycle of more than `longest` periods is looked at.
    """
    evaluated, scale = 0, 2.0 ** max(0, round(math.log2(max(cycle.gaps) * REACH)))
    gain = GAIN / loop.step
    seen = {_key(cycle)}
    while scale >= (1.0 if signals.at_samples else FINEST):
        better = False
        for trial in _neighbours(cycle, signals, scale):
            if evaluated >= most:
                return cycle, growth, evaluated
            key = _key(trial)
            if key in seen or trial.periods > longest:
                continue
            seen.add(key)
            evaluated += 1
            trial_growth = loop.growth(trial, COARSE)
            if trial_growth is not None and trial_growth.rate > growth.rate + gain:
                cycle, growth, better = trial, trial_growth, True
                break
        if not better:
            scale /= 2.0
    return cycle, growth, evaluated


def refine(
    loop: SampledLoop, signals: Admissible, cycle: Cycle, growth: Growth, most: int
) -> tuple[Cycle, Growth, int]:
    """The cycle repeated a few times over a length that it does not divide, where that is better.

    So its own length need be no whole number of periods, only a fraction with a small denominator.
    """
    best, evaluated = (cycle, growth), 0
    if cycle.periods > LONG or signals.at_samples:
        return cycle, growth, 0
    for times in range(2, MOST_TIMES + 1):
        for extra in range(1 - times, times):
            if math.gcd(times, extra) != 1:
                continue
            total = times * cycle.periods + extra
            scale = total / (times * cycle.periods)
            gaps = tuple(scale * gap for gap in cycle.gaps) * times
            trial = admissible(Cycle(cycle.modes * times, gaps, cycle.offset), signals, total)
            if trial is None:
                continue
            evaluated += 1
            trial_growth = loop.growth(trial, COARSE)
            if trial_growth is not None and trial_growth.rate > best[1].rate:
                best = trial, trial_growth
    if best[0] is cycle:
        return cycle, growth, evaluated
    better, faster, looked = polish(loop, signals, *best, most)
    evaluated += looked
    if (faster.rate - growth.rate) * cycle.periods * loop.step < WORTH:
        return cycle, growth, evaluated
    return better, faster, evaluated


def admissible(cycle: Cycle, signals: Admissible, total: int) -> Cycle | None:
    """The nearest admissible cycle of a whole length; None if there is none."""
    allowed = signals.totals(cycle.modes)
    if allowed is None or not allowed[0] <= total <= allowed[1]:
        return None
    gaps = signals.near(np.array(cycle.gaps), total, cycle.modes)
    return Cycle(cycle.modes, tuple(gaps.tolist()), cycle.offset)


def _neighbours(cycle: Cycle, signals: Admissible, scale: float) -> Iterator[Cycle]:
    """The admissible cycles at this reach."""
    count, total = len(cycle.modes), cycle.periods
    gaps = np.array(cycle.gaps)
    for sign in (scale, -scale):
        for i in range(count):
            moved, offset = gaps.copy(), cycle.offset
            moved[i - 1] += sign
            moved[i] -= sign
            if i == 0:
                offset += sign
            yield from _valid(cycle, signals, moved, offset, total)
        if scale < 1.0:
            yield from _valid(cycle, signals, gaps, cycle.offset + sign, total)
            continue
        for i in range(count):
            moved = gaps.copy()
            moved[i] += sign
            yield from _valid(cycle, signals, moved, cycle.offset, total + round(sign))
        yield from _valid(cycle, signals, gaps + sign, cycle.offset, total + count * round(sign))


def _valid(
    cycle: Cycle, signals: Admissible, gaps: np.ndarray, offset: float, total: int
) -> Iterator[Cycle]:
    moved = Cycle(cycle.modes, tuple(gaps.tolist()), offset - math.floor(offset))
    cycle_in_range = admissible(moved, signals, total)
    if cycle_in_range is not None:
        yield cycle_in_range


def _key(cycle: Cycle) -> tuple:
    return (*np.round(cycle.gaps, 9).tolist(), round(cycle.offset, 9))
