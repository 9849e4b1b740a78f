"""The worst signal of a law that is no table: a search that measures growth in runs.

A law that decides by a rule, estimates the state or weighs a belief has no matrix over a cycle, but
can be run. Along a repeated cycle the size of (x, u) is taken over blocks of whole cycles, each a
delay long or longer; the slope of its logarithm over the later half of the blocks is the growth:
exact for a linear loop up to decaying transients, and for any other loop the growth of this run.

Cycles are drawn at random, short sojourns more often than long ones; switches fall on samples,
right after them and elsewhere. The best are improved as those of a table are (`worst_cycle`).

This proves nothing, and a nonlinear law may grow from other initial states.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from deadtime.certificates.worst_case.cycle_growth import Growth
from deadtime.certificates.worst_case.cycles import Admissible, Cycle, no_cycle
from deadtime.certificates.worst_case.growth_proof import GrowthProof
from deadtime.certificates.worst_case.witness import WorstCase, of_cycle, repeat
from deadtime.certificates.worst_case.worst_cycle import COARSE, Rated, polish, worst_of
from deadtime.feedback import Law
from deadtime.imperfections import ModeDelay
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.simulation import Trajectory, simulate
from deadtime.switching import SignalClass, SwitchingSignal

BLOCKS, MOST_BLOCKS = 16, 64
FEWEST = 4  # blocks that tell a slope
LARGEST = 1e90  # |x|, below the limit that ends a run
COST = 400  # a run counts as this many cycles on the compressed loop of a table
DELAYS = 4.0  # the longest sojourns tried, in blocks beyond the dwell time
MOST_SOJOURNS = 4
SHORT = 3  # a sojourn exceeds the shortest one by a uniform number to this power: mostly little
ON_GRID = 0.8  # of the cycles
POLISHED = 2  # cycles improved, by half of the runs
NO_PROOF = "the law is no table, and growth was measured in a run"


@dataclass(frozen=True, eq=False)
class RunLoop:
    """A plant under any law, run from one state (immutable)."""

    plant: SwitchedSystem
    law: Law
    signals: SignalClass
    step: float

    @cached_property
    def window(self) -> int:
        """The least number of periods in a block."""
        longest = max(self.plant.longest_delay, self.law.plant.longest_delay)
        return math.ceil(longest / self.step) + 1 + self.signals.mode_lag

    @cached_property
    def start(self) -> np.ndarray:
        """x(0) of all runs, of size 1."""
        x0 = np.random.default_rng(0).normal(size=self.plant.states)
        return x0 / np.linalg.norm(x0)

    def growth(self, cycle: Cycle, tolerance: float = 0.0) -> Growth | None:
        """The growth along a cycle, 1/s, in a run; None if the run ends too soon.

        The run is longer for a tolerance of 0.
        """
        block = cycle.periods * -(-self.window // cycle.periods)
        run = self.run(cycle, (BLOCKS if tolerance else MOST_BLOCKS) * block)
        periods = run.time.size - 1
        whole = periods // block
        sizes = np.concatenate((run.states[:, 1:], run.inputs[:, :periods]))[:, : whole * block]
        with np.errstate(over="ignore", invalid="ignore"):
            largest = np.abs(sizes).reshape(len(sizes), whole, block).max(axis=(0, 2))
        known = np.flatnonzero(~(largest < LARGEST))
        largest = largest[: known[0]] if known.size else largest
        start = self.start.astype(complex)
        if largest.size < FEWEST:
            return None
        later = largest[largest.size // 2 :]
        if not later.all():
            return Growth(-math.inf, start)
        time = np.arange(later.size) * block * self.step
        return Growth(float(np.polyfit(time, np.log(later), 1)[0]), start)

    def run(self, cycle: Cycle, periods: int) -> Trajectory:
        """A run along the repeated cycle; shorter if it diverges."""
        lag, signal = self.signals.mode_lag, SwitchingSignal.constant(cycle.modes[0])
        late = [ModeDelay(lag)] if lag else []
        if not cycle.constant:
            times = -(-periods // cycle.periods)
            least = self.signals.limits(self.plant.modes).dwell_time
            signal = repeat(cycle, times, least, self.step)
        horizon = periods * self.step
        return simulate(
            self.plant, self.law, signal, self.start, horizon, self.step, imperfections=late
        )


def worst_in_runs(loop: RunLoop, signals: Admissible, budget: int) -> WorstCase:
    """The worst cycle found in about budget / 400 runs, modes that may last among them."""
    runs, evaluated = max(10, budget // COST), 0
    known: list[Rated] = []
    window = float(loop.window)
    steady = [Cycle((mode,), (window,)) for mode in signals.lasting]
    cycles = [*steady, *_drawn(signals, DELAYS * window, runs // 2)]
    for cycle in cycles:
        tolerance = 0.0 if cycle.constant else COARSE
        growth, evaluated = loop.growth(cycle, tolerance), evaluated + 1
        if growth is not None:
            known.append((cycle, growth))
    moving = sorted((one for one in known if not one[0].constant), key=lambda one: -one[1].rate)
    for cycle, growth in moving[:POLISHED]:
        most = runs // (2 * POLISHED)
        better, faster, looked = polish(loop, signals, cycle, growth, most)
        known.append((better, faster))
        evaluated += looked
    cycle, growth = worst_of(known, loop)
    proof = GrowthProof(False, reason=NO_PROOF if growth.rate > 0.0 else "no growth was measured")
    plants = loop.plant, loop.law.plant
    past = max(SampledPlant.of(plant, loop.step).longest_lag for plant in plants)
    u0 = np.zeros((loop.plant.inputs, past))
    about = loop.plant, loop.law, loop.signals, loop.step
    return of_cycle(*about, cycle, growth.rate, proof, (loop.start, u0), 0.0, evaluated)


def _drawn(signals: Admissible, longest: float, number: int) -> Iterator[Cycle]:
    if not signals.recurring:
        return
    rng = np.random.default_rng(3)
    words, most = [], max(MOST_SOJOURNS, len(signals.recurring))
    for count in range(2, most + 1):
        if count <= MOST_SOJOURNS or not words:
            words += [word for word in signals.cycles(count) if signals.totals(word) is not None]
    if not words and signals.lasting:
        return
    if not words:
        raise no_cycle(most)
    for k in range(number):
        word = words[k % len(words)]
        span = np.minimum(longest, signals.most(word) - signals.least(word))
        added = span * rng.random(len(word)) ** SHORT if k >= len(words) else np.zeros(len(word))
        yield _cycle(rng, word, signals, signals.least(word) + added)


def _cycle(
    rng: np.random.Generator, word: tuple[int, ...], signals: Admissible, gaps: np.ndarray
) -> Cycle:
    """About these sojourns; switches at samples or right after them, or anywhere in a period."""
    late, mixed = signals.late
    lengths = np.ceil(gaps)
    if (signals.at_samples or rng.random() < ON_GRID) and (lengths <= signals.most(word)).all():
        after = rng.random(len(word) if mixed else 1) < 0.5 * (not signals.at_samples)
        each = np.broadcast_to(after, len(word)).tolist()
        return Cycle.on_grid(list(zip(word, lengths.astype(int).tolist(), each, strict=True)), late)
    low, high = signals.totals(word) or (0, 0)
    total = min(max(round(float(gaps.sum())), low), high)
    return Cycle(word, tuple(signals.near(gaps, total, word).tolist()), float(rng.random()))
