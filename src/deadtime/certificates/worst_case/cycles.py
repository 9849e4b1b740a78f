"""Cycles: periodic switching signals whose length is a whole number of sampling periods.

A cycle is a sequence of modes and of sojourns, in sampling periods, that is gone through again
and again. Only if its length is a whole number of periods does the loop with its samples repeat
as the signal does, and has a growth rate: ln(spectral radius over the cycle)/length. Sojourns
themselves may be any real numbers, and the first switch may fall anywhere in a period.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float

from deadtime.plant.steps import snap
from deadtime.switching import SwitchingSignal

INSIDE = 1.0 - 1e-6  # of the clock's tolerance: so that no sojourn leaves it by round-off
LATE = 2.0**-10  # of a period: how long after its sample a switch is, at most, to be late
SEEN = 1e-7  # of a period: what is closer to its sample might count as at it


@dataclass(frozen=True)
class Dwell:
    """The admissible sojourns, in sampling periods: from `least` to `most`, which may be inf."""

    least: float
    most: float

    @classmethod
    def of(
        cls, dwell_time: float, maximum_dwell: float | None, step: float, tolerance: float = 0.0
    ) -> Dwell:
        """From seconds, and how wrong the clock may be; a ratio within 1e-9 of an integer is it."""
        longest = math.inf if maximum_dwell is None else snap(maximum_dwell / step)
        part = tolerance * INSIDE
        return cls(snap(dwell_time / step) * (1.0 - part), longest * (1.0 + part))

    @property
    def late(self) -> tuple[float, bool]:
        """How long after its sample a late switch falls, in periods, and whether it may be alone.

        A sojourn that begins late and ends in time is shorter by that than its samples tell, one
        that begins in time and ends late is longer. Where either is not allowed, all switches of a
        cycle are late or none.

        Examples
        --------
        >>> Dwell(2.0, math.inf).late, Dwell(1.9, math.inf).late
        ((0.0009765625, False), (0.0009765625, True))
        """
        spare = math.ceil(self.least) - self.least
        if math.isfinite(self.most):
            spare = min(spare, self.most - math.floor(self.most))
        late = min(LATE, 0.5 * spare)
        return (late, True) if late >= SEEN else (LATE, False)

    def totals(self, count: int) -> tuple[int, int] | None:
        """The least and the largest whole length of `count` sojourns; None if there is none.

        Examples
        --------
        >>> Dwell(2.5, 2.7).totals(2), Dwell(2.5, 2.7).totals(1)
        ((5, 5), None)
        """
        least = math.ceil(snap(count * self.least))
        most = count * self.most if math.isinf(self.most) else snap(count * self.most)
        if least > most:
            return None
        return least, 10**9 if math.isinf(most) else math.floor(most)

    def near(
        self, gaps: Float[np.ndarray, " sojourn"], total: int
    ) -> Float[np.ndarray, " sojourn"]:
        """Admissible sojourns of this total near `gaps`: what is missing is shared out evenly.

        The total must be one that `totals` allows.

        Examples
        --------
        >>> Dwell(2.5, 9.0).near(np.array([1.0, 4.0]), 6)
        array([2.5, 3.5])
        """
        result = np.clip(gaps, self.least, self.most)
        for _ in range(2 * gaps.size):
            missing = total - result.sum()
            if missing == 0.0:
                break
            free = result < self.most if missing > 0.0 else result > self.least
            if not free.any():
                break
            result[free] += missing / free.sum()
            result = np.clip(result, self.least, self.most)
        return result


@dataclass(frozen=True)
class Cycle:
    """One cycle (immutable).

    Attributes
    ----------
    modes : tuple of int
        The modes in turn; neighbours differ, the last and the first too.
    gaps : tuple of float
        Their sojourns in sampling periods; the sum is an integer.
    offset : float
        Where in its period the switch to the first mode falls, in [0, 1).
    """

    modes: tuple[int, ...]
    gaps: tuple[float, ...]
    offset: float = 0.0

    @property
    def periods(self) -> int:
        """The length of the cycle in sampling periods."""
        return round(sum(self.gaps))

    @property
    def constant(self) -> bool:
        """Whether the mode never changes."""
        return len(self.modes) == 1

    def instants(self) -> np.ndarray:
        """The switches to the modes in turn, in periods, within [0, periods)."""
        return self.offset + np.concatenate(([0.0], np.cumsum(self.gaps[:-1])))

    def signal(self, step: float) -> SwitchingSignal:
        """σ over one cycle, from 0."""
        times, modes = self.instants() * step, np.array(self.modes)
        if self.offset > 0.0:
            times, modes = np.append(0.0, times), np.append(self.modes[-1], modes)
        return SwitchingSignal(times, modes)

    def reduce(self) -> Cycle:
        """The shortest cycle that this one repeats.

        Examples
        --------
        >>> Cycle((0, 1, 0, 1), (2.0, 3.0, 2.0, 3.0)).reduce()
        Cycle(modes=(0, 1), gaps=(2.0, 3.0), offset=0.0)
        """
        count = len(self.modes)
        for size in range(1, count):
            times = count // size
            whole = abs(sum(self.gaps[:size]) - round(sum(self.gaps[:size]))) < 1e-9
            if (
                whole
                and times * size == count
                and self.modes[:size] * times == self.modes
                and np.allclose(self.gaps[:size] * times, self.gaps, rtol=0.0, atol=1e-9)
            ):
                return Cycle(self.modes[:size], self.gaps[:size], self.offset)
        return self

    @classmethod
    def on_grid(cls, sojourns: list[tuple[int, int, bool]], late: float) -> Cycle:
        """From modes, lengths in samples, and whether each begins `late` after its sample.

        All rotations give the same cycle.

        Examples
        --------
        >>> Cycle.on_grid([(1, 3, False), (0, 2, True)], late=0.125)
        Cycle(modes=(0, 1), gaps=(1.875, 3.125), offset=0.125)
        """
        first = min(sojourns[i:] + sojourns[:i] for i in range(len(sojourns)))
        modes, lengths, after = zip(*first, strict=True)
        begins = late * np.array(after)
        gaps = np.array(lengths) + np.roll(begins, -1) - begins
        return cls(modes, tuple(gaps.tolist()), float(begins[0])).reduce()


def mode_cycles(modes: int, count: int) -> Iterator[tuple[int, ...]]:
    """Sequences of `count` modes whose neighbours differ all round, one of each rotation.

    Examples
    --------
    >>> list(mode_cycles(3, 3))
    [(0, 1, 2), (0, 2, 1)]
    """
    for word in product(range(modes), repeat=count):
        turns = [word[i:] + word[:i] for i in range(count)]
        if word == min(turns) and all(a != b for a, b in zip(word, turns[-1], strict=True)):
            yield word
