"""Cycles worth evaluating: from branch and bound and from random cycles, all of them climbed.

Switches fall on samples; for a law that knows the mode also right after samples, where it sees
them a period late (`kinds`), which is often worse.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, islice

import numpy as np
from jaxtyping import Int

from deadtime.base.errors import ArgumentError
from deadtime.certificates.worst_case.cycles import Cycle, Dwell, mode_cycles
from deadtime.certificates.worst_case.kinds import Kinds
from deadtime.certificates.worst_case.loop import Growth, SampledLoop
from deadtime.certificates.worst_case.products import Sojourns, compress
from deadtime.certificates.worst_case.search import LETTERS, branch_and_bound
from deadtime.certificates.worst_case.words import Word, climb

LENGTHS = 200  # of sojourns that the compressed loop knows
DELAYS = 8  # the longest of them, at least
STARTS = 14  # random cycles per mode
MOST_SOJOURNS = 6  # in a random cycle
TOLERANCE = 1e-2  # of the branch and bound: growth over a delay
SLOWEST = 2000.0  # samples; slower motions do not make sojourns any longer
TIGHT = 6  # cycles that are tried over the shortest length, too
TURNS = 40  # cycles without a grid: how many sojourns at most
WORDS = 30  # of modes, there


@dataclass(frozen=True, eq=False)
class Candidates:
    """Cycles, the most promising first; see `WorstCase` for the rest."""

    cycles: list[Cycle]
    upper_estimate: float | None
    evaluated: int


def candidates(
    loop: SampledLoop, constants: list[tuple[Cycle, Growth]], dwell: Dwell, budget: int
) -> Candidates:
    """Cycles that are worth evaluating; `constants` are the constant modes and their growth."""
    lengths = _lengths(loop, constants, dwell)
    if lengths.size == 0:
        return Candidates(list(_without_grid(loop.plant.modes, dwell)), None, 0)
    step, modes = loop.step, loop.plant.modes
    floor = max(growth.rate for _, growth in constants) - loop.shift
    floor = -math.inf if math.isfinite(dwell.most) else floor * step
    late, mixed = dwell.late
    kinds = Kinds.of(loop.feedback, modes, mixed, loop.lag)
    sojourns = compress(loop, lengths, kinds)
    letters = _letters(lengths, max(3, LETTERS // modes))
    searched = branch_and_bound(sojourns, letters, floor, TOLERANCE / loop.past, budget // 2)
    rates: dict[Cycle, float] = {}
    climbing = 0
    for start in chain(searched.words, _random_words(sojourns, STARTS * modes)):
        word, looked = climb(sojourns, start)
        climbing += looked
        parts = (kinds.mode[word.kinds], lengths[word.index], kinds.late[word.kinds])
        cycle = Cycle.on_grid(list(zip(*(part.tolist() for part in parts), strict=True)), late)
        if not cycle.constant:
            rates[cycle] = max(word.rate, rates.get(cycle, -math.inf))
        if climbing >= budget // 2:
            break
    best = sorted(rates, key=lambda cycle: -rates[cycle])
    upper = None if searched.bound is None else loop.shift + searched.bound / step
    tried = [*_tight(best[:TIGHT], dwell), *best]
    return Candidates(tried, upper, searched.evaluated + climbing)


def _lengths(
    loop: SampledLoop, constants: list[tuple[Cycle, Growth]], dwell: Dwell
) -> Int[np.ndarray, " length"]:
    """Sojourns in samples, dense where they are short, over delays and oscillations."""
    shortest = math.ceil(dwell.least)
    slow = max(2.0 * _period(loop, *rated) for rated in constants)
    span = max(DELAYS * loop.past, round(min(slow, SLOWEST)))
    if math.isfinite(dwell.most):
        span = min(span, math.floor(dwell.most) - shortest)
    if span < 0:
        return np.empty(0, np.int64)
    offsets = np.append(0.0, np.geomspace(1.0, max(span, 1), LENGTHS))
    return shortest + np.unique(np.round(offsets).astype(np.int64))[: span + 1]


def _letters(lengths: Int[np.ndarray, " length"], count: int) -> Int[np.ndarray, " letter"]:
    """Indices of about `count` lengths: the shortest, then longer ones in a constant ratio."""
    added = lengths - lengths[0]
    last = max(1.0, float(added[-1]))
    first = min(max(1.0, lengths[0] / 10.0), last)
    wanted = np.append(0.0, np.geomspace(first, last, count - 1))
    return np.unique(np.searchsorted(added, wanted).clip(0, lengths.size - 1))


def _period(loop: SampledLoop, cycle: Cycle, growth: Growth) -> float:
    """How many samples the leading direction of a mode takes to turn, or to change by e^{2π}."""
    plain = SampledLoop.of(loop.plant, loop.feedback, 0.0)
    table, z = plain.table(Cycle(cycle.modes, (1.0,))), growth.vector
    after = plain.after(table, 1, np.real(z).copy()) + 1j * plain.after(table, 1, np.imag(z).copy())
    multiplier = np.vdot(z, after) / np.vdot(z, z).real
    turn = abs(cmath.log(multiplier)) if multiplier else math.inf
    return 2.0 * math.pi / max(turn, 1e-12)


def _random_words(sojourns: Sojourns, number: int) -> Iterator[Word]:
    """Cycles to climb from."""
    rng, follows = np.random.default_rng(2), sojourns.kinds.follows
    span = float(max(2, sojourns.length[-1] - sojourns.length[0]))
    while number:
        count = int(rng.integers(2, MOST_SOJOURNS + 1))
        word = [int(rng.integers(len(follows)))]
        while len(word) < count:
            word.append(int(rng.choice(np.flatnonzero(follows[word[-1]]))))
        if not follows[word[-1], word[0]]:
            continue
        number, kinds = number - 1, np.array(word)
        added = span ** rng.random(count)
        index = np.searchsorted(sojourns.length, sojourns.length[0] + added)
        index = index.clip(0, sojourns.length.size - 1)
        yield Word(kinds, index, float(sojourns.rates(kinds, index[None])[0]))


def _tight(cycles: list[Cycle], dwell: Dwell) -> list[Cycle]:
    """The same modes over the shortest whole length, where the dwell time is off the grid."""
    if dwell.least == math.floor(dwell.least):
        return []
    words = {cycle.modes: cycle for cycle in cycles}
    shortest = {modes: dwell.totals(len(modes)) for modes in words}
    return [
        _equal(modes, dwell, totals[0]) for modes, totals in shortest.items() if totals is not None
    ]


def _equal(modes: tuple[int, ...], dwell: Dwell, total: int) -> Cycle:
    gaps = dwell.near(np.full(len(modes), total / len(modes)), total)
    return Cycle(modes, tuple(gaps.tolist()))


def _without_grid(modes: int, dwell: Dwell) -> Iterator[Cycle]:
    """Cycles of equal sojourns, where no whole number is admissible."""
    number = 0
    for turns in range(2, TURNS + 1):
        totals = dwell.totals(turns)
        if totals is None:
            continue
        short = turns <= MOST_SOJOURNS
        for word in islice(mode_cycles(modes, turns) if short else _rounds(modes, turns), WORDS):
            number += 1
            yield _equal(word, dwell, totals[0])
        if number >= WORDS or (number and not short):
            return
    if not number:
        raise ArgumentError(
            "maximum_dwell leaves no cycle of a whole number of periods with up to "
            f"{TURNS} sojourns: raise it, or shorten the step."
        )


def _rounds(modes: int, turns: int) -> Iterator[tuple[int, ...]]:
    """Two modes, or all modes, in turn; nothing where that does not close."""
    for size in {2, modes}:
        if turns % size == 0:
            yield tuple(i % size for i in range(turns))
