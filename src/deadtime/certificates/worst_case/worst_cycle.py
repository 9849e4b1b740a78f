"""From candidates to the worst cycle: evaluated on the loop itself, improved, the simplest kept."""

from __future__ import annotations

import math
from dataclasses import replace

from deadtime.base.errors import ArgumentError
from deadtime.certificates.worst_case.admissible import Admissible
from deadtime.certificates.worst_case.cycle_growth import Growing, Growth, SampledLoop
from deadtime.certificates.worst_case.cycles import Cycle
from deadtime.certificates.worst_case.switch_instants import COARSE, polish, refine

TRIED = 12  # cycles evaluated on the loop itself
POLISHED = 3  # of them, cycles whose switches leave the grid
RINGS = 3  # short rings improved besides
SHORT = 20  # periods: in so short a cycle the offset matters much
OFFSETS = (0.25, 0.5, 0.75)
MOVES = 80  # cycles looked at to improve one, per sojourn
LONGER = 1.25  # how much longer a cycle slower than a constant signal may become
BETTER = 1e-6  # per period: by how much a cycle must beat a constant signal
SIMPLER = 2e-4  # growth over a cycle that may be lost for a cycle of fewer sojourns

Rated = tuple[Cycle, Growth]


def improve(
    loop: SampledLoop,
    signals: Admissible,
    cycles: list[Cycle],
    rings: list[Rated],
    floor: float,
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
        if growth.rate < floor:  # it would grow longer and longer, towards the constant signal
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
    """The best few cycles, and for short ones, where it matters, the best other offset."""
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
    """The fastest growth: a constant signal, or the simplest cycle, where little is lost."""
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
