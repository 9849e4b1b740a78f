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

from deadtime.steps import snap
from deadtime.switching import SwitchingSignal


@dataclass(frozen=True)
class Dwell:
    """The admissible sojourns, in sampling periods: from `least` to `most`, which may be inf."""

    least: float
    most: float

    @classmethod
    def of(cls, dwell_time: float, maximum_dwell: float | None, step: float) -> Dwell:
        """From seconds; a ratio within 1e-9 of an integer is that integer."""
        longest = math.inf if maximum_dwell is None else snap(maximum_dwell / step)
        return cls(snap(dwell_time / step), longest)

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

    def reduced(self) -> Cycle:
        """The shortest cycle that this one repeats.

        Examples
        --------
        >>> Cycle((0, 1, 0, 1), (2.0, 3.0, 2.0, 3.0)).reduced()
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

    def turned(self) -> Cycle:
        """The rotation that is the same for all rotations, for a cycle on the grid."""
        turns = range(len(self.modes))
        pairs = list(zip(self.modes, self.gaps, strict=True))
        first = min(pairs[i:] + pairs[:i] for i in turns)
        return Cycle(tuple(mode for mode, _ in first), tuple(gap for _, gap in first))


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
