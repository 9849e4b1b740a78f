"""Which samples to lose along a cycle: patterns with at most so many lost in a row.

Of the worst cycles, and of the modes that may last, the samples lost are chosen so that the loop
grows fastest: first every pattern of some lost and some measured in turn, wherever it begins, then
the best of these is improved by losing or measuring one sample at a time. A cycle is gone through
as often as a pattern needs to come round. Deterministic; that there is no worse pattern is not
proved.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from deadtime.certificates.worst_case.cycle_growth import SampledLoop
from deadtime.certificates.worst_case.cycles import Cycle
from deadtime.certificates.worst_case.switch_instants import COARSE
from deadtime.certificates.worst_case.worst_cycle import Rated

BASES = 4  # cycles in which samples are lost
ROUND = 3  # samples measured in a row, at most, in the patterns tried first
LONGEST = 240  # periods of a cycle with its pattern, unless the cycle itself is longer
FLIPS = 120  # samples lost or measured one at a time, per cycle
GAIN = 1e-9  # 1/s, relative, that a change has to bring


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
        if growth is not None and growth.rate > best[1].rate + GAIN * abs(best[1].rate):
            best = tried, growth
    return best, evaluated


def _in_turn(cycle: Cycle, most: int) -> Iterator[Cycle]:
    """The cycle, as often as need be, with l samples lost and r measured in turn from each on."""
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
                at = (k for k in range(long.periods) if (k - first) % turn < lost)
                kept = tuple(at)
                if _allowed(kept, long.periods, most):
                    yield replace(long, lost=kept)


def _allowed(lost: tuple[int, ...], periods: int, most: int) -> bool:
    """Whether no more than so many samples in a row are lost, round and round.

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
