"""Cycles: periodic switching signals whose length is a whole number of sampling periods.

A cycle is a periodic sequence of modes and sojourns, in sampling periods. If its length is a whole
number of periods, the sampled loop is periodic, too, and its growth rate is ln(spectral radius over
the cycle)/length. The sojourns may be any real numbers, and the first switch may fall anywhere in a
period.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.plant.discretisation import snap
from deadtime.switching import SignalClass, SwitchingSignal

INSIDE = 1.0 - 1e-6  # of the clock's tolerance: round-off then keeps sojourns admissible
LATE = 2.0**-10  # of a period: the delay of a late switch after its sample, at most
SEEN = 1e-7  # of a period: a switch closer to its sample might count as on it


def no_cycle(most: int) -> ArgumentError:
    """The refusal where no cycle of up to so many sojourns is a whole number of periods."""
    return ArgumentError(
        "maximum_dwell leaves no cycle of a whole number of periods with up to "
        f"{most} sojourns that transitions allows: raise it, or shorten the step."
    )


def pattern_sizes(
    modes: tuple[int, ...], sojourns: tuple[float, ...], rtol: float = 0.0, atol: float = 0.0
) -> Iterator[int]:
    """Sizes of the shorter patterns that a cycle repeats, also of no whole number of periods.

    Examples
    --------
    >>> list(pattern_sizes((0, 1, 0, 1), (0.25, 0.3, 0.25, 0.3)))
    [2]
    """
    for size in range(1, len(modes)):
        times = len(modes) // size
        if modes[:size] * times == modes and np.allclose(
            sojourns[:size] * times, sojourns, rtol=rtol, atol=atol
        ):
            yield size


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
    lost : tuple of int
        The lost samples of the cycle, 0 the first.
    """

    modes: tuple[int, ...]
    gaps: tuple[float, ...]
    offset: float = 0.0
    lost: tuple[int, ...] = ()

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
        Cycle(modes=(0, 1), gaps=(2.0, 3.0), offset=0.0, lost=())
        """
        for size in pattern_sizes(self.modes, self.gaps, atol=1e-9):
            length = sum(self.gaps[:size])
            if abs(length - round(length)) < 1e-9:
                return Cycle(self.modes[:size], self.gaps[:size], self.offset)
        return self

    @classmethod
    def on_grid(cls, sojourns: list[tuple[int, int, bool]], late: float) -> Cycle:
        """A cycle from modes, lengths in samples, and flags of a start `late` after the sample.

        All rotations give the same cycle.

        Examples
        --------
        >>> Cycle.on_grid([(1, 3, False), (0, 2, True)], late=0.125)
        Cycle(modes=(0, 1), gaps=(1.875, 3.125), offset=0.125, lost=())
        """
        first = min(sojourns[i:] + sojourns[:i] for i in range(len(sojourns)))
        modes, lengths, after = zip(*first, strict=True)
        begins = late * np.array(after)
        gaps = np.array(lengths) + np.roll(begins, -1) - begins
        return cls(modes, tuple(gaps.tolist()), float(begins[0])).reduce()


@dataclass(frozen=True)
class Dwell:
    """The sojourns of a mode, in sampling periods: from `least` to `most`, which may be inf."""

    least: float
    most: float

    @classmethod
    def of(
        cls, dwell_time: float, maximum_dwell: float, step: float, tolerance: float = 0.0
    ) -> Dwell:
        """From seconds and the clock's relative error; a ratio within 1e-9 of an integer is it."""
        endless = math.isinf(maximum_dwell)
        longest = math.inf if endless else snap(maximum_dwell / step)
        part = tolerance * INSIDE
        return cls(snap(dwell_time / step) * (1.0 - part), longest * (1.0 + part))

    @property
    def shortest(self) -> int:
        """The least whole number of periods."""
        return math.ceil(self.least)

    @property
    def longest(self) -> float:
        """The largest whole number of periods, or inf; less than `shortest` if there is none."""
        return float(math.floor(self.most)) if math.isfinite(self.most) else math.inf

    @property
    def spare(self) -> float:
        """The part of a period by which whole sojourns may be shorter and longer."""
        spare = math.ceil(self.least) - self.least
        if math.isfinite(self.most):
            spare = min(spare, self.most - math.floor(self.most))
        return spare


@dataclass(frozen=True)
class Admissible:
    """The sojourns of every mode, and the switches that can be part of a cycle (immutable).

    Examples
    --------
    >>> ways = np.roll(np.eye(3), 1, 1)
    >>> ring = SignalClass([2.0, 2.0, 3.0], transitions=ways, clock_tolerance=0.0)
    >>> signals = Admissible.of(ring, 3, step=1.0)
    >>> list(signals.cycles(3)), list(signals.cycles(2)), signals.totals((0, 1, 2))[0]
    ([(0, 1, 2)], [], 7)
    """

    dwell: tuple[Dwell, ...]
    following: tuple[tuple[int, ...], ...]
    lasting: tuple[int, ...]
    at_samples: bool = False

    @classmethod
    def of(cls, signals: SignalClass, modes: int, step: float) -> Admissible:
        """The cycles of a class of signals, its clock tolerance included."""
        limits, off = signals.limits(modes), signals.clock_tolerance
        times = zip(limits.dwell_time, limits.maximum_dwell, strict=True)
        dwell = tuple(Dwell.of(least, most, step, off) for least, most in times)
        whole = signals.at == "samples"
        if whole:
            dwell = tuple(Dwell(max(1.0, float(one.shortest)), one.longest) for one in dwell)
        return cls(dwell, limits.recurring, limits.lasting, whole)

    @property
    def modes(self) -> int:
        """Number of modes."""
        return len(self.dwell)

    @property
    def recurring(self) -> tuple[int, ...]:
        """The modes that can be part of a cycle."""
        return tuple(i for i, after in enumerate(self.following) if after)

    @property
    def is_free(self) -> bool:
        """Whether every mode may follow every other one."""
        return all(len(after) == self.modes - 1 for after in self.following)

    @cached_property
    def _bounds(self) -> tuple[np.ndarray, np.ndarray]:
        return np.array([d.least for d in self.dwell]), np.array([d.most for d in self.dwell])

    @cached_property
    def late(self) -> tuple[float, bool]:
        """The delay of a late switch after its sample, in periods, and whether cycles may mix.

        A sojourn that begins late and ends on a sample is shorter by this than its samples suggest,
        one that begins on a sample and ends late is longer. If either is not admissible, all
        switches of a cycle are late or none.

        Examples
        --------
        >>> ways = ((1,), (0,))
        >>> Admissible((Dwell(2.0, math.inf),) * 2, ways, ()).late
        (0.0009765625, False)
        >>> Admissible((Dwell(1.9, math.inf),) * 2, ways, ()).late
        (0.0009765625, True)
        """
        spare = min(self.dwell[i].spare for i in self.recurring)
        late = min(LATE, 0.5 * spare)
        return (late, True) if late >= SEEN else (LATE, False)

    def least(self, word: tuple[int, ...]) -> Float[np.ndarray, " sojourn"]:
        """The shortest sojourns of modes in turn, in periods."""
        return self._bounds[0][list(word)]

    def most(self, word: tuple[int, ...]) -> Float[np.ndarray, " sojourn"]:
        """The longest sojourns of modes in turn, in periods."""
        return self._bounds[1][list(word)]

    def totals(self, word: tuple[int, ...]) -> tuple[int, int] | None:
        """The least and the largest whole length of these modes in turn; None if there is none.

        Examples
        --------
        >>> tight = Admissible((Dwell(2.5, 2.7),) * 2, ((1,), (0,)), ())
        >>> tight.totals((0, 1)), tight.totals((0,))
        ((5, 5), None)
        """
        own = [self.dwell[i] for i in word]
        least, most = _sum([d.least for d in own]), _sum([d.most for d in own])
        low = math.ceil(snap(least))
        most = most if math.isinf(most) else snap(most)
        if low > most:
            return None
        return low, 10**9 if math.isinf(most) else math.floor(most)

    def near(
        self, gaps: Float[np.ndarray, " sojourn"], total: int, word: tuple[int, ...]
    ) -> Float[np.ndarray, " sojourn"]:
        """Admissible sojourns of this total near `gaps`: the difference is shared evenly.

        The total must be within `totals`. Where modes change at samples only all are whole numbers,
        and the difference goes to the sojourns one period at a time.

        Examples
        --------
        >>> two = Admissible((Dwell(2.5, 9.0),) * 2, ((1,), (0,)), ())
        >>> two.near(np.array([1.0, 4.0]), 6, (0, 1))
        array([2.5, 3.5])
        """
        least, most = self.least(word), self.most(word)
        if self.at_samples:
            result = np.clip(np.round(gaps), least, most)
            for _ in range(round(abs(total - result.sum()))):
                sign = math.copysign(1.0, total - result.sum())
                ends = most if sign > 0.0 else least
                result[
                    int(np.argmin(np.where(result != ends, sign * (result - gaps), np.inf)))
                ] += sign
            return result
        result = np.clip(gaps, least, most)
        for _ in range(2 * gaps.size):
            missing = total - result.sum()
            if missing == 0.0:
                break
            free = result < most if missing > 0.0 else result > least
            if not free.any():
                break
            result[free] += missing / free.sum()
            result = np.clip(result, least, most)
        return result

    def cycles(self, count: int) -> Iterator[tuple[int, ...]]:
        """The cyclic sequences of `count` modes."""
        return mode_cycles(self.following, count)


def _sum(lengths: list[float]) -> float:
    """The sum, with one rounding per distinct length: n equal sojourns sum to n times one."""
    return sum(number * length for length, number in Counter(lengths).items())


def mode_cycles(following: Sequence[Sequence[int]], count: int) -> Iterator[tuple[int, ...]]:
    """Cyclic sequences of `count` modes by allowed transitions, one of each rotation.

    Examples
    --------
    >>> list(mode_cycles([(1, 2), (0, 2), (0, 1)], 3))
    [(0, 1, 2), (0, 2, 1)]
    """
    walks = [(first,) for first in reversed(range(len(following)))]
    while walks:
        word = walks.pop()
        if len(word) < count:
            # The first rotation begins with the least mode.
            after = [j for j in following[word[-1]] if j >= word[0]]
            walks += [(*word, j) for j in reversed(after)]
        elif word[0] in following[word[-1]] and word == min(
            word[i:] + word[:i] for i in range(count)
        ):
            yield word
