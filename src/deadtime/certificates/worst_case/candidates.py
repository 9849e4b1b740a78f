"""Candidate cycles: from branch and bound and from random cycles, improved by hill climbing.

Further candidates are short rings: two to four modes in turn, each at about its shortest sojourn.
Their length need not be a whole number of periods, so they are repeated up to five times. Where
sojourns last between one period and two, no word on the grid is near them. They are evaluated on
the loop itself.

Switches fall on samples; for a law that reads the mode also right after samples, where it sees
them a period late (`products`), which is often worse.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator
from itertools import chain, islice, product

import numpy as np
from jaxtyping import Int

from deadtime.certificates.worst_case.cycle_growth import Growth, SampledLoop
from deadtime.certificates.worst_case.cycles import Admissible, Cycle, no_cycle
from deadtime.certificates.worst_case.products import Kinds, Sojourns, compress
from deadtime.certificates.worst_case.word_search import LETTERS, Word, branch_and_bound, climb
from deadtime.certificates.worst_case.worst_cycle import COARSE, Rated

LENGTHS = 200  # lengths of sojourns of the compressed loop
DELAYS = 8  # the longest sojourn, in delays, at least
STARTS = 14  # random cycles per mode
MOST_SOJOURNS = 6  # in a random cycle; with restricted transitions at least the number of modes
DRAWS = 100  # attempts per random cycle that closes
TOLERANCE = 1e-2  # of the branch and bound: growth over a delay
SLOWEST = 2000.0  # samples; a limit on the slowest motion that sets the longest sojourn
TIGHT = 6  # cycles that are also tried at the shortest length
TURNS = 40  # sojourns of a cycle without a grid, at most
WORDS = 30  # sequences of modes without a grid
RING = 4  # sojourns of a short ring, at most
RINGS = 40  # number of short rings
ROUNDS = 5
LONGEST = 60  # periods of all rounds together; a longer ring is near one on the grid
PHASES = (0.0, 0.25, 0.5, 0.75)


def candidates(
    loop: SampledLoop, constants: list[Rated], signals: Admissible, budget: int
) -> tuple[list[Cycle], list[Rated], int]:
    """Candidate cycles; `constants` are the constant modes and their growth.

    Returns the cycles, the most promising first; short rings with their growth, the best first;
    and the number of cycles evaluated.
    """
    lengths, (rings, turned) = _lengths(loop, constants, signals), _rings(loop, signals)
    if lengths.size == 0:
        return list(_without_grid(signals)), rings, turned
    step, modes = loop.step, loop.plant.modes
    known = [constants[mode][1].rate for mode in signals.lasting]
    floor = (max(known) - loop.shift) * step if known else -math.inf
    kinds = Kinds.of(loop.feedback, signals, loop.lag)
    sojourns = compress(loop, lengths, kinds, signals)
    count, ends = max(3, LETTERS // modes), zip(sojourns.low, sojourns.high, strict=True)
    letters = [low + _some(lengths[low : high + 1], count) for low, high in ends]
    precision = TOLERANCE / loop.past
    words, looked_at = branch_and_bound(sojourns, letters, floor, precision, budget // 2)
    rates: dict[Cycle, float] = {}
    climbing = 0
    for start in chain(words, _random_words(sojourns, signals, STARTS * modes)):
        word, looked = climb(sojourns, start)
        climbing += looked
        parts = (kinds.mode[word.kinds], lengths[word.index], kinds.late[word.kinds])
        cycle = Cycle.on_grid(
            list(zip(*(part.tolist() for part in parts), strict=True)), signals.late[0]
        )
        if not cycle.constant:
            rates[cycle] = max(word.rate, rates.get(cycle, -math.inf))
        if climbing >= budget // 2:
            break
    best = sorted(rates, key=lambda cycle: -rates[cycle])
    tried = [*_tight(best[:TIGHT], signals), *best]
    return tried, rings, looked_at + climbing + turned


def _rings(loop: SampledLoop, signals: Admissible) -> tuple[list[Rated], int]:
    """The short rings near the shortest sojourns, the best first, and the number evaluated."""
    words = chain.from_iterable(signals.cycles(count) for count in range(2, RING + 1))
    rated: dict[Cycle, Growth | None] = {}
    for word, rounds in product(islice(words, RINGS), range(1, ROUNDS + 1)):
        modes = word * rounds
        totals = signals.totals(modes)
        if totals is None or totals[0] > LONGEST:
            continue
        gaps = tuple(signals.near(signals.least(modes), totals[0], modes).tolist())
        for phase in (0.0,) if signals.at_samples else PHASES:
            cycle = Cycle(modes, gaps, phase).reduce()
            if cycle not in rated:
                rated[cycle] = loop.growth(cycle, COARSE)
    known = [(cycle, growth) for cycle, growth in rated.items() if growth is not None]
    return sorted(known, key=lambda pair: -pair[1].rate), len(rated)


def _lengths(
    loop: SampledLoop, constants: list[Rated], signals: Admissible
) -> Int[np.ndarray, " length"]:
    """Sojourns in samples, dense where they are short, up to several delays and oscillations.

    The union over the modes; empty where a mode has no sojourn of whole periods.
    """
    slow = max(2.0 * _period(loop, *rated) for rated in constants)
    found = []
    for dwell in {signals.dwell[i] for i in signals.recurring}:
        span = max(DELAYS * loop.past, round(min(slow, SLOWEST)))
        span = int(min(span, dwell.longest - dwell.shortest))
        if span < 0:
            return np.empty(0, np.int64)
        offsets = np.append(0.0, np.geomspace(1.0, max(span, 1), LENGTHS))
        found.append(dwell.shortest + np.unique(np.round(offsets).astype(np.int64))[: span + 1])
    return np.unique(np.concatenate(found))


def _some(lengths: Int[np.ndarray, " length"], count: int) -> Int[np.ndarray, " letter"]:
    """Indices of about `count` lengths: the shortest, then longer ones in a constant ratio."""
    added = lengths - lengths[0]
    last = max(1.0, float(added[-1]))
    first = min(max(1.0, lengths[0] / 10.0), last)
    wanted = np.append(0.0, np.geomspace(first, last, count - 1))
    return np.unique(np.searchsorted(added, wanted).clip(0, lengths.size - 1))


def _period(loop: SampledLoop, cycle: Cycle, growth: Growth) -> float:
    """Samples in which the leading direction of a mode turns once, or changes by e^{2π}."""
    plain = SampledLoop.of(loop.plant, loop.feedback, 0.0)
    table, z = plain.table(Cycle(cycle.modes, (1.0,))), growth.vector
    after = plain.after(table, 1, np.real(z).copy()) + 1j * plain.after(table, 1, np.imag(z).copy())
    multiplier = np.vdot(z, after) / np.vdot(z, z).real
    turn = abs(cmath.log(multiplier)) if multiplier else math.inf
    return 2.0 * math.pi / max(turn, 1e-12)


def _random_words(sojourns: Sojourns, signals: Admissible, number: int) -> Iterator[Word]:
    rng, follows = np.random.default_rng(2), sojourns.kinds.follows
    span = float(max(2, sojourns.length[-1] - sojourns.length[0]))
    longest = MOST_SOJOURNS if signals.is_free else max(MOST_SOJOURNS, len(signals.recurring))
    for _ in range(DRAWS * number):
        if not number:
            return
        count = int(rng.integers(2, longest + 1))
        word = [int(rng.integers(len(follows)))]
        while len(word) < count:
            word.append(int(rng.choice(np.flatnonzero(follows[word[-1]]))))
        if not follows[word[-1], word[0]]:
            continue
        number, kinds = number - 1, np.array(word)
        added, low = span ** rng.random(count), sojourns.low[kinds]
        index = np.searchsorted(sojourns.length, sojourns.length[low] + added)
        index = index.clip(low, sojourns.high[kinds])
        yield Word(kinds, index, float(sojourns.rates(kinds, index[None])[0]))


def _tight(cycles: list[Cycle], signals: Admissible) -> list[Cycle]:
    """The cycles of these modes at the shortest whole length, if a dwell time is off the grid."""
    if all(signals.dwell[i].least == signals.dwell[i].shortest for i in signals.recurring):
        return []
    words = {cycle.modes: cycle for cycle in cycles}
    shortest = {modes: signals.totals(modes) for modes in words}
    return [_equal(modes, signals, totals[0]) for modes, totals in shortest.items() if totals]


def _equal(modes: tuple[int, ...], signals: Admissible, total: int) -> Cycle:
    """A cycle of about equal sojourns."""
    gaps = signals.near(np.full(len(modes), total / len(modes)), total, modes)
    return Cycle(modes, tuple(gaps.tolist()))


def _without_grid(signals: Admissible) -> Iterator[Cycle]:
    """Cycles of about equal sojourns, for modes without an admissible whole number of periods."""
    number = 0
    for turns in range(2, TURNS + 1):
        short = turns <= MOST_SOJOURNS
        words = signals.cycles(turns) if short else _rounds(signals, turns)
        for word in islice(words, WORDS):
            totals = signals.totals(word)
            if totals is None:
                continue
            number += 1
            yield _equal(word, signals, totals[0])
        if number >= WORDS or (number and not short):
            return
    if not number:
        raise no_cycle(TURNS)


def _rounds(signals: Admissible, turns: int) -> Iterator[tuple[int, ...]]:
    """Two modes, or all modes, in turn; with restricted transitions any short cycle."""
    longest = max(MOST_SOJOURNS, len(signals.recurring))
    for size in {2, signals.modes} if signals.is_free else range(2, longest + 1):
        word = next(signals.cycles(size), None)
        if word is not None and turns % size == 0:
            yield word * (turns // size)
