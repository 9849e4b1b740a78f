"""The transitions that a class of signals allows, as a graph on (mode, age).

Signals are right-continuous, and a switch in (k h, (k + 1) h] belongs to the period k: the sample
at its end sees it. The age a of mode i at a sample is the number of earlier samples that saw i.
Over the next period the plant either stays in i, a *full* step to (i, a + 1), or switches once, at
s into it, a *mixed* step to (j, 0). A sojourn of q full steps between two mixed ones lasts
(h − s) + q h + s', with s, s' ∈ (0, h], so between q h and (q + 2) h, neither included:

    |-- other --s-- i --|-- i --| … |-- i --|-- i --s'-- j --|
         mixed, h − s     age 0     age q−1    age q, mixed

Dwell times are measured by the controller's clock, whose tolerance δ is known: a sojourn lasts at
least (1 − δ) τ_d. With r = (1 − δ) τ_d/h, (q + 2) h must exceed r h (and as τ_d and h stand for all
reals within half a unit in the last place, r is taken 2⁻⁵⁰ of it smaller):

    q ≥ ⌊r⌋ − 1,

which is τ_d/h − 2 where τ_d/h is whole. At that q the sojourn has to end late, for h − s ≤ h:

    s' ≥ (r − ⌊r⌋) h.

A longest sojourn of (1 + δ) τ_max = R h allows q ≤ ⌈R⌉ − 1, at that q with s' ≤ (R − q) h, for
h − s ≥ 0; without one a mode may last for any time. All else that s and s' have to do with each
other is ignored, and their range is closed: [0, h]. So the graph contains every admissible signal
and a few more. With dwell times per mode these numbers are the mode's `LeavingAges`; a mixed step
leads to the modes that may follow, all others unless the class of signals restricts them.

Where the mode changes at samples only, s = h: in a mixed step the plant stays in i for the whole
period, and j is the mode of the next one. A sojourn of q full steps lasts (q + 1) h, so
q ≥ ⌈r⌉ − 1, q ≥ 0 and q ≤ ⌊R⌋ − 1. The graph then has these signals and no others.

An average dwell time τ_a with chatter N₀ ≥ 2 allows N₀ + T/τ_a switches in any window of T. Then
the "age" is the level of a bucket: it gains 1 per period, up to N₀ τ_a/h, and a switch takes r.
Rounded up, a mixed step needs a ≥ ⌊r⌋ − 1 and leads to a + 1 − ⌊r⌋. Two switches in one period are
not covered. In `stretches` V may rise at a switch instead, and does not depend on the level.

If the reported mode is that of L samples ago, the law at (i, a) uses (i, a − L) if a ≥ L. Else it
uses the mode seen b = L − a samples before i. A sojourn spans at least q + 1 ≥ ⌊r⌋ = p samples, so
the k-th sojourn back is reported only if b > (k − 1) p, and then at an age of at least k p − b. If
b ≤ p it is the mode before, with one row if rows depend on the mode alone and there are two modes.
In the graph any row that may be reported may act: V depends on the mode and its age, and not on the
modes before. With dwell times per mode p is the least, and k switches lead from the k-th mode back.

If up to L samples in a row may be lost, a node is (i, a, l): the last l samples were lost. A step
under a row of a measured sample leads to l = 0; one under a row of a lost sample, with l < L, to
l + 1. At the l-th lost sample in a row the law uses the mode reported l samples ago, so the modes
are those of a lag of l. It counts the age from the first measured sample of that mode, up to L
after the first one, and continues over lost ones: any age from a − L to a; but any age at all of a
mode that has ended, and any larger age where whole sojourns may be lost, L ≥ p.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from deadtime.feedback.table import Context, row_of
from deadtime.switching import SignalClass

READINGS = Fraction(1, 2**50)  # relative: a ratio of two decimals, of their floats, or of between


def decimal(value: float) -> Fraction:
    """The decimal that prints as this float: 0.3/0.1 is then exactly 3."""
    return Fraction(repr(float(value)))


def least_periods(dwell_time: float, step: float, tolerance: float) -> Fraction:
    """r: the least number of periods of a dwell time by the controller's clock."""
    part = (1 - decimal(tolerance)) * (1 - READINGS)
    return part * decimal(dwell_time) / decimal(step)


@dataclass(frozen=True)
class LeavingAges:
    """When a mode may be left, by its age in samples.

    Attributes
    ----------
    first : int
        The least age from which a step may switch.
    last : int
        The largest age with a node of its own.
    ends : bool
        Whether the mode must be left at the age `last` (a maximum dwell time).
    earliest, latest : float
        The first instant of a switch at the age `first`, and the last at `last` where the mode must
        be left then: fractions of the period. An `earliest` of 1: every switch is at the end.
    """

    first: int
    last: int
    ends: bool = False
    earliest: float = 0.0
    latest: float = 1.0

    @classmethod
    def of(
        cls,
        dwell_time: float,
        maximum_dwell: float,
        step: float,
        signals: SignalClass,
        reported: int,
    ) -> LeavingAges:
        """From a mode's dwell time and maximum; rows may change up to the age `reported`.

        A `first` of −1: one period may contain two switches.

        Examples
        --------
        >>> LeavingAges.of(0.25, math.inf, 0.1, SignalClass(0.25), 0)
        LeavingAges(first=1, last=2, ends=False, earliest=0.4999749999999977, latest=1.0)
        >>> LeavingAges.of(0.2, 0.35, 0.1, SignalClass(0.2, 0.35, at="samples"), 0)
        LeavingAges(first=1, last=2, ends=True, earliest=1.0, latest=1.0)
        """
        tolerance = signals.clock_tolerance
        r, R = least_periods(dwell_time, step, tolerance), None
        if math.isfinite(maximum_dwell):
            R = (1 + decimal(tolerance)) * (1 + READINGS) * decimal(maximum_dwell) / decimal(step)
        if signals.at == "samples":
            first = max(0, math.ceil(r) - 1)
            last = max(first, reported) if R is None else math.floor(R) - 1
            return cls(first, last, R is not None, 1.0)
        first = math.floor(r) - 1
        # Rounded outwards, so that float instants contain the exact ones.
        earliest = max(0.0, math.nextafter(float(r - first - 1), 0.0))
        if R is None:
            # The last age stands for all later ones, at which a mode may be left at any instant.
            return cls(first, max(first + 1, reported), False, earliest)
        last = math.ceil(R) - 1
        return cls(first, last, True, earliest, min(1.0, math.nextafter(float(R - last), 1.0)))


@dataclass(frozen=True)
class Transition:
    """One step of the graph: from (mode, age) under a row to (after, next_age).

    `instants` are the first and the last fraction of the period at which it may switch; `lost` and
    `next_lost` count the samples lost in a row before this sample, and before the next.
    """

    mode: int
    age: int
    row: int
    after: int
    next_age: int
    instants: tuple[float, float] = (0.0, 1.0)
    lost: int = 0
    next_lost: int = 0

    @property
    def switches(self) -> bool:
        """Whether the plant switches in this step, or at its end."""
        return self.mode != self.after

    @property
    def within(self) -> int:
        """The mode that the plant switches to within the period; `mode` where it does not."""
        return self.mode if self.instants[0] == 1.0 else self.after


@dataclass(frozen=True)
class NodeStretch:
    """Periods from one node to the next: full steps, one step that may switch, full steps.

    Attributes
    ----------
    knot, next_knot : int
        Indices of the nodes' ages among the knots of the modes before and after the step.
    waits, follows : int
        Numbers of full steps before and after the step.
    step : Transition
        The step that may switch.
    """

    knot: int
    waits: int
    step: Transition
    follows: int
    next_knot: int

    @property
    def periods(self) -> int:
        """The length L."""
        return self.waits + 1 + self.follows


@dataclass(frozen=True)
class SwitchGraph:
    """The graph (immutable).

    Attributes
    ----------
    clocks : tuple of LeavingAges
        The ages at which each mode may be left.
    following : tuple of tuples of int
        The modes that may follow each mode.
    bucket : int or None
        The levels that a switch takes from the age; None if a switch sets it to 0.
    context : str
        The quantities that select the table's row.
    ages : int
        Rows per mode of a (mode, age) table.
    lag : int
        L: the reported mode is that of L samples ago.
    losses : int
        The largest number of samples lost in a row; the rows of lost samples then come after
        those of measured ones. One of `lag` and `losses` is 0.

            row    | mode 0: age 0 … ages − 1 | mode 1: … | … | the same for lost samples |
            index    0        …      ages − 1    ages  …        measured … 2·measured − 1
    """

    clocks: tuple[LeavingAges, ...]
    following: tuple[tuple[int, ...], ...]
    bucket: int | None
    context: Context
    ages: int
    lag: int = 0
    losses: int = 0

    @classmethod
    def of(
        cls, modes: int, signals: SignalClass, step: float, context: Context, ages: int
    ) -> SwitchGraph:
        """The graph of a class of signals at a period, in seconds."""
        limits, lag, losses = signals.limits(modes), signals.mode_lag, signals.lost_samples
        following = limits.following
        if modes == 1:  # no switches, but rows may still change with the age
            own = LeavingAges(0, ages - 1 + losses)
            return cls((own,), following, None, context, ages, 0, losses)
        reported = ages - 1 + lag + losses
        each = zip(limits.dwell_time, limits.maximum_dwell, strict=True)
        clocks = tuple(LeavingAges.of(low, high, step, signals, reported) for low, high in each)
        if signals.chatter > 1:
            average, late = decimal(limits.dwell_time[0]), signals.at == "samples"
            least = least_periods(limits.dwell_time[0], step, signals.clock_tolerance)
            first = max(math.floor(least) - 1, late - 1)
            last = max(first, math.ceil(signals.chatter * average / decimal(step)))
            clocks = (LeavingAges(first, last, earliest=float(late)),) * modes
            return cls(clocks, following, first, context, ages, lag, losses)
        return cls(clocks, following, None, context, ages, lag, losses)

    @property
    def modes(self) -> int:
        """Number of modes."""
        return len(self.clocks)

    @property
    def first(self) -> int:
        """The least age, in samples, from which a step of some mode may switch."""
        return min(clock.first for clock in self.clocks)

    @property
    def last(self) -> int:
        """The largest age with a node of its own, over all modes."""
        return max(clock.last for clock in self.clocks)

    @property
    def is_free(self) -> bool:
        """Whether every mode may follow every other one."""
        return all(len(after) == self.modes - 1 for after in self.following)

    @property
    def switching(self) -> int:
        """Number of (mode, age, mode after) with a switch."""
        each = zip(self.clocks, self.following, strict=True)
        return sum(len(after) * (clock.last - clock.first + 1) for clock, after in each)

    def knots_of(self, mode: int, knots: tuple[int, ...]) -> tuple[int, ...]:
        """The knots that a mode reaches."""
        return tuple(age for age in knots if age <= self.clocks[mode].last)

    def row(self, mode: int, age: int) -> int:
        """The row of the table at (mode, age) if the mode is reported after `lag` samples."""
        return row_of(self.context, self.ages, mode, max(0, age - self.lag))

    @property
    def measured(self) -> int:
        """Number of rows of measured samples."""
        return 1 if self.context == "none" else self.modes * self.ages

    def place(self, mode: int, lost: int) -> int:
        """Index of V of a mode after some lost samples: all modes for 0 lost, then for 1, …."""
        return lost * self.modes + mode

    @property
    def places(self) -> int:
        """Number of pairs of a mode and a count of lost samples."""
        return (self.losses + 1) * self.modes

    def rows(self, mode: int, age: int) -> list[int]:
        """The rows that may act: of all modes that may be reported, and at all possible ages."""
        if self.losses:
            return self._measured_rows(mode, age)
        if self.bucket is not None and self.lag:
            return list(range(self.modes * self.ages))
        if self.bucket is not None and self.context == "mode_age":
            return list(range(mode * self.ages, (mode + 1) * self.ages))
        if age >= self.lag:
            return [self.row(mode, age)]
        reported = self._before(mode, self.lag - age).items()
        return [i * self.ages + a for i, least in sorted(reported) for a in range(least, self.ages)]

    def _measured_rows(self, mode: int, age: int, since: int = 0) -> list[int]:
        """The rows for the ages that a law may have counted by a sample `since` samples ago."""
        if self.context != "mode_age":
            return [row_of(self.context, 1, mode, 0)]
        first, last = max(0, age - since - self.losses) + since, age
        if self.bucket is not None or self.losses > self.first:  # a whole sojourn may be lost
            first, last = (0 if self.bucket is not None else first), self.ages - 1
        ages = range(min(first, self.ages - 1), min(last, self.ages - 1) + 1)
        return [mode * self.ages + a for a in ages]

    def lost_rows(self, mode: int, age: int, lost: int) -> list[int]:
        """The rows that may act at the `lost`-th sample lost in a row."""
        count = self.measured
        if self.context == "none":
            rows = [0]
        elif self.bucket is not None:
            rows = list(range(count))
        elif age >= lost or self.modes == 1:
            rows = self._measured_rows(mode, age, lost)
        else:
            reported = sorted(self._before(mode, lost - age))
            rows = [i * self.ages + a for i in reported for a in range(self.ages)]
        return [count + row for row in rows]

    def _before(self, mode: int, samples: int) -> dict[int, int]:
        """Modes that may have been seen `samples` before this one first was, and least ages."""
        shortest, least, here = self.first + 1, dict[int, int](), {mode}
        for back in range(1, -(-samples // shortest) + 1):
            here = {i for i in range(self.modes) if not here.isdisjoint(self.following[i])}
            age = max(0, back * shortest - samples)
            if all(least.get(i, 1) == 0 for i in here):  # earlier sojourns add nothing
                break
            for i in here:
                least[i] = min(age, self.ages - 1, least.get(i, age))
        return least

    def rows_after(self, step: Transition, follows: int) -> list[int]:
        """The rows of the first periods after a switch, while the old mode is still reported.

        For a step that begins at an age of `lag` − 1 or more.
        """
        if not step.switches:
            return []
        first = step.age + 1 - self.lag
        ages = range(first, first + min(self.lag, follows))
        return [row_of(self.context, self.ages, step.mode, age) for age in ages]

    def all(self, knots: tuple[int, ...] = (0,)) -> list[Transition]:
        """The transitions to check.

        Between two `knots` the inequalities are linear in the age if the rows are equal: the first
        and the last step of each segment then imply the others. Where rows change with the age
        every age is checked.
        """
        changing = self.ages if self.context == "mode_age" and self.bucket is None else 0
        shared = {*knots, 0, changing + self.lag + self.losses}
        if self.lag:  # ages at which the set of rows that may act changes
            reported = [[self.rows(i, a) for i in range(self.modes)] for a in range(self.lag + 1)]
            shared |= {a for a in range(1, self.lag + 1) if reported[a] != reported[a - 1]}
        if self.losses:
            changing += self.losses
        # A switch takes `bucket` from the level, so it ends at a knot if it starts so far above it.
        shared |= {knot + (self.bucket or 0) for knot in knots}
        transitions = []
        for i, clock in enumerate(self.clocks):
            marks = {*shared, clock.first, clock.first + 1, clock.last}
            ends = {a for mark in marks for a in (mark - 1, mark)}
            for a in range(clock.last + 1):
                # Every age with changing rows, and both neighbours of every mark.
                if not (self.lag <= a < self.lag + changing or a in ends):
                    continue
                for row, lost, next_lost in self._reported(i, a):
                    transitions += self._steps(i, a, row, lost, next_lost)
        return transitions

    def _reported(self, mode: int, age: int) -> Iterator[tuple[int, int, int]]:
        """The rows that may act, and the numbers of lost samples before this one and the next."""
        for lost in range(self.losses + 1):
            for row in self.rows(mode, age):
                yield row, lost, 0
            for row in self.lost_rows(mode, age, lost + 1) if lost < self.losses else ():
                yield row, lost, lost + 1

    def _steps(self, mode: int, age: int, row: int, lost: int, next_lost: int) -> list[Transition]:
        """The step without a switch, if the mode may last, and the steps with one."""
        clock, steps = self.clocks[mode], self.switches(mode, age, row)
        if age < clock.last or not clock.ends:
            steps = [Transition(mode, age, row, mode, min(age + 1, clock.last)), *steps]
        if not self.losses:
            return steps
        return [replace(step, lost=lost, next_lost=next_lost) for step in steps]

    def stretches(self, knots: tuple[int, ...]) -> list[NodeStretch]:
        """The stretches between nodes at these ages, which `validate` knows to cover the graph."""
        stretches = []
        if self.bucket is not None:  # one node per mode, for all levels
            full = ((i, clock.last) for i, clock in enumerate(self.clocks))
            reported = ((*at, *one) for at in full for one in self._reported(*at))
            steps = (step for at in reported for step in self._steps(*at))
            return [NodeStretch(0, 0, replace(step, age=0, next_age=0), 0, 0) for step in steps]
        if self.losses:  # every age is a knot, and every stretch a period
            each = self.all(tuple(range(self.last + 1)))
            return [NodeStretch(step.age, 0, step, 0, step.next_age) for step in each]
        for i, clock in enumerate(self.clocks):
            own = self.knots_of(i, knots)
            for k, age in enumerate(own):
                if k + 1 < len(own):
                    end = own[k + 1]
                    full = Transition(i, end - 1, self.row(i, end - 1), i, end)
                    stretches.append(NodeStretch(k, end - 1 - age, full, 0, k + 1))
                else:
                    end = clock.last + 1
                    if not clock.ends:
                        full = Transition(i, clock.last, self.row(i, clock.last), i, clock.last)
                        stretches.append(NodeStretch(k, 0, full, 0, k))
                for at in range(max(clock.first, age), end):
                    mixed = self.switches(i, at, self.row(i, at))
                    stretches += [NodeStretch(k, at - age, step, knots[0], 0) for step in mixed]
        return stretches

    def switches(self, mode: int, age: int, row: int) -> list[Transition]:
        """The mixed steps from (mode, age)."""
        clock = self.clocks[mode]
        if age < clock.first:
            return []
        after = 0 if self.bucket is None else age - self.bucket
        low = clock.earliest if age == clock.first or clock.earliest == 1.0 else 0.0
        high = clock.latest if age == clock.last else 1.0
        steps = self.following[mode]
        return [Transition(mode, age, row, j, after, (low, high)) for j in steps]


def interpolation(knots: tuple[int, ...], age: int) -> list[tuple[int, Fraction]]:
    """The knots around an age, and their exact weights; constant past the last knot.

    Examples
    --------
    >>> interpolation((0, 4, 9), 5)
    [(1, Fraction(4, 5)), (2, Fraction(1, 5))]
    """
    after = int(np.searchsorted(knots, age, side="right"))
    if after == len(knots):
        return [(after - 1, Fraction(1))]
    late = Fraction(age - knots[after - 1], knots[after] - knots[after - 1])
    return [(after - 1, 1 - late), (after, late)] if late else [(after - 1, Fraction(1))]
