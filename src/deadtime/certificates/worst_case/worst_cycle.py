"""The worst cycle: candidates evaluated on the loop itself and improved, the simplest kept.

A cycle of n switches over K periods is changed by a step: one sojourn longer or shorter and the
cycle with it, all of them, one switch earlier or later, or all switches relative to the samples.
The result is moved to the nearest admissible sojourns. A change that helps is kept; if none does
the step is halved, from several periods down to 1/64 of one. Below one period the length K stays.

For the worst cycles, and for the modes that may last, the lost samples are chosen so that the loop
grows fastest: first every pattern of l samples lost and r measured in turn, at every start, then
the best pattern is improved one sample at a time. A cycle is repeated until the pattern fits a
whole number of times. Deterministic; a worse pattern may exist.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from deadtime.base.errors import ArgumentError
from deadtime.certificates.worst_case.cycle_growth import Growing, Growth, SampledLoop
from deadtime.certificates.worst_case.cycles import Admissible, Cycle

REACH = 1.0 / 40.0  # of the longest sojourn: the first step
FINEST = 1.0 / 64.0  # of a period: the last step
LONG = 60  # periods; a longer cycle is not repeated by `refine`
MOST_TIMES = 5
WORTH = 1e-3  # least gain of growth over a cycle for which a longer cycle is accepted
COARSE = 1e-6  # relative error of eigenvalues while searching
GAIN = 1e-9  # per period; a smaller gain is ignored
TRIED = 12  # cycles evaluated on the loop itself
POLISHED = 3  # of them, cycles whose switches leave the grid
RINGS = 3  # short rings improved as well
SHORT = 20  # periods: for a shorter cycle several offsets are tried
OFFSETS = (0.25, 0.5, 0.75)
MOVES = 80  # cycles evaluated to improve one, per sojourn
LONGER = 1.25  # factor by which a cycle slower than a constant signal may become longer
BETTER = 1e-6  # per period: the least gain of a cycle over a constant signal
SIMPLER = 2e-4  # loss of growth over a cycle accepted for fewer sojourns
BASES = 4  # cycles in which samples are lost
ROUND = 3  # samples measured in a row, at most, in the patterns tried first
LONGEST = 240  # periods of a cycle with its pattern, unless the cycle itself is longer
FLIPS = 120  # samples lost or measured one at a time, per cycle
RELATIVE_GAIN = 1e-9  # 1/s, relative, that a change has to bring


def polish(
    loop: Growing,
    signals: Admissible,
    cycle: Cycle,
    growth: Growth,
    most: int,
    longest: float = math.inf,
) -> tuple[Cycle, Growth, int]:
    """The improved cycle, its growth, and the number of cycles evaluated, at most `most`.

    No cycle of more than `longest` periods is evaluated.
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
    """The cycle repeated a few times at a length that is not a multiple of its own, if better.

    The length of one repetition is then a fraction of a period with a small denominator.
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


Rated = tuple[Cycle, Growth]


def improve(
    loop: SampledLoop, signals: Admissible, cycles: list[Cycle], rings: list[Rated], floor: float
) -> tuple[list[Rated], int]:
    """The cycles with their growth, the best of them and of the rings improved off the grid.

    `floor` is a growth rate, 1/s, that is known; little is spent on cycles below it.
    """
    rated: list[Rated] = []
    evaluated = 0
    for cycle in cycles[:TRIED]:
        growth = loop.growth(cycle, COARSE)
        evaluated += 1
        if growth is not None:
            rated.append((cycle, growth))
    starts, more = _starts(rated, loop, signals)
    evaluated += more
    best: dict[tuple, Rated] = {}
    for ring in rings:
        best.setdefault(ring[0].modes, ring)
    rated += rings[:RINGS]
    for cycle, growth in [*starts, *list(best.values())[:RINGS]]:
        most, longest = MOVES * len(cycle.modes), math.inf
        if growth.rate < floor:  # such a cycle tends to the constant signal by getting longer
            most, longest = most // 4, LONGER * cycle.periods
        better, faster, looked = polish(loop, signals, cycle, growth, most, longest)
        rated.append((better, faster))
        evaluated += looked
    rated.sort(key=lambda pair: -pair[1].rate)
    if rated:
        most = MOVES * len(rated[0][0].modes)
        better, faster, looked = refine(loop, signals, rated[0][0], rated[0][1], most)
        rated.insert(0, (better, faster))
        evaluated += looked
    return rated, evaluated


def _starts(rated: list[Rated], loop: SampledLoop, signals: Admissible) -> tuple[list[Rated], int]:
    """The best few cycles, and for short ones the best other offset."""
    starts: dict[tuple, Rated] = {}
    for cycle, growth in sorted(rated, key=lambda pair: -pair[1].rate):
        starts.setdefault((cycle.modes, cycle.gaps), (cycle, growth))
    best = list(starts.values())[:POLISHED]
    evaluated, others = 0, []
    for cycle, _ in best:
        if cycle.periods <= SHORT and not signals.at_samples:
            turned = [replace(cycle, offset=offset) for offset in OFFSETS]
            growths = [(turn, loop.growth(turn, COARSE)) for turn in turned]
            evaluated += len(growths)
            known = [(turn, growth) for turn, growth in growths if growth is not None]
            others += sorted(known, key=lambda pair: -pair[1].rate)[:1]
    return [*best, *others], evaluated


def worst_of(found: list[Rated], loop: Growing) -> Rated:
    """The fastest growth: a constant signal, or the simplest cycle of nearly that growth."""
    step = loop.step
    constants = [pair for pair in found if pair[0].constant and not pair[0].lost]
    others = (pair for pair in found if not pair[0].constant or pair[0].lost)
    cycles = sorted(others, key=lambda p: -p[1].rate)
    best = max(constants, key=lambda pair: pair[1].rate, default=None)
    floor = -math.inf if best is None else best[1].rate + BETTER / step
    fastest = next((pair for pair in cycles if _exact(pair, loop, floor) is not None), None)
    if fastest is None:
        if best is None:
            raise ArgumentError("law gives a loop whose growth over cycles cannot be computed.")
        return best
    rate = fastest[1].rate
    if rate > 0.0:
        floor = max(floor, 0.0)
    simpler = [pair for pair in cycles if (rate - pair[1].rate) * pair[0].periods * step < SIMPLER]
    for pair in sorted(simpler, key=lambda pair: (len(pair[0].modes), -pair[1].rate)):
        exact = _exact(pair, loop, floor)
        if exact is not None:
            return exact
    return fastest


def _exact(pair: Rated, loop: Growing, floor: float) -> Rated | None:
    """A cycle with its growth to the last digit; None if it is not above the floor."""
    cycle, growth = pair
    if growth.rate <= floor:
        return None
    exact = loop.growth(cycle)
    return None if exact is None or exact.rate <= floor else (cycle, exact)


def with_losses(loop: SampledLoop, known: list[Rated], most: int) -> tuple[list[Rated], int]:
    """The worst of these cycles, with the samples lost along them that were found worst."""
    bases: dict[tuple, Rated] = {}
    for cycle, growth in sorted(known, key=lambda pair: -pair[1].rate):
        bases.setdefault((cycle.modes, cycle.gaps, cycle.offset), (cycle, growth))
    chosen = list(bases.values())[:BASES]
    chosen += [one for one in bases.values() if one[0].constant and one not in chosen]
    found, evaluated = [], 0
    for cycle, _ in chosen:
        best, looked = _worst_pattern(loop, cycle, most)
        evaluated += looked
        found += [] if best is None else [best]
    return found, evaluated


def _worst_pattern(loop: SampledLoop, cycle: Cycle, most: int) -> tuple[Rated | None, int]:
    """A cycle with the losses found worst."""
    best: Rated | None = None
    evaluated = 0
    for tried in _in_turn(cycle, most):
        growth, evaluated = loop.growth(tried, COARSE), evaluated + 1
        if growth is not None and (best is None or growth.rate > best[1].rate):
            best = tried, growth
    if best is None:
        return None, evaluated
    flips = range(min(best[0].periods, FLIPS))
    for sample in flips:
        changed = tuple(sorted({*best[0].lost} ^ {sample}))
        if not changed or not _allowed(changed, best[0].periods, most):
            continue
        tried = replace(best[0], lost=changed)
        growth, evaluated = loop.growth(tried, COARSE), evaluated + 1
        if growth is not None and growth.rate > best[1].rate + RELATIVE_GAIN * abs(best[1].rate):
            best = tried, growth
    return best, evaluated


def _in_turn(cycle: Cycle, most: int) -> Iterator[Cycle]:
    """The cycle, repeated as needed, with l samples lost and r measured in turn, at every start."""
    for lost in range(1, most + 1):
        for measured in range(1, ROUND + 1):
            turn = lost + measured
            if cycle.constant:
                yield replace(cycle, gaps=(float(turn),), lost=tuple(range(1, lost + 1)))
                continue
            times = int(np.lcm(cycle.periods, turn)) // cycle.periods
            if times * cycle.periods > max(LONGEST, cycle.periods):
                times = 1
            long = replace(cycle, modes=cycle.modes * times, gaps=cycle.gaps * times)
            for first in range(turn):
                kept = tuple(k for k in range(long.periods) if (k - first) % turn < lost)
                if _allowed(kept, long.periods, most):
                    yield replace(long, lost=kept)


def _allowed(lost: tuple[int, ...], periods: int, most: int) -> bool:
    """Whether at most `most` samples in a row are lost in the cyclic pattern.

    Examples
    --------
    >>> _allowed((0, 4), 5, 1), _allowed((1, 3), 5, 1)
    (False, True)
    """
    mask = np.isin(np.arange(periods), lost)
    if mask.all():
        return False
    turned = np.roll(mask, -int(np.flatnonzero(~mask)[0]))
    ends = np.flatnonzero(~np.append(turned, False))
    return bool(np.diff(ends).max(initial=1) - 1 <= most)
