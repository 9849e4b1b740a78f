"""The transitions that a class of signals allows, as a graph on (mode, age).

Signals are right-continuous, and a switch in (k h, (k + 1) h] belongs to the period k: one that
falls on a sample is seen by it. At a sample the mode i has been seen for a samples before. Over
the next period the plant either stays in i, a *full* step to (i, a + 1), or switches once, s into
it, a *mixed* step to (j, 0). A sojourn of q full steps between two mixed ones lasts
(h − s) + q h + s', with s, s' ∈ (0, h], so between q h and (q + 2) h, neither included.

What counts as admissible is measured by the controller's clock, of which a tolerance δ is known:
a sojourn lasts at least (1 − δ) τ_d. With r = (1 − δ) τ_d/h, (q + 2) h must exceed r h (and as τ_d
and h stand for all reals within half a unit in the last place, r is taken 2⁻⁵⁰ of it smaller):

    q ≥ ⌊r⌋ − 1,

which is τ_d/h − 2 where τ_d/h is whole. At that q the sojourn has to end late, for h − s ≤ h:

    s' ≥ (r − ⌊r⌋) h.

A longest sojourn of (1 + δ) τ_max = R h allows q ≤ ⌈R⌉ − 1, at that q with s' ≤ (R − q) h, for
h − s ≥ 0; without one a mode may last for any time. All else that s and s' have to do with each
other is left out, and their range is closed: [0, h]. So the graph has every admissible signal and
a few more.

An average dwell time τ_a with chatter N₀ ≥ 2 allows N₀ + T/τ_a switches in any window of T. Then
the "age" is the level of a bucket instead: it gains 1 per period, up to N₀ τ_a/h, and a switch
takes r of it. Rounded up, a mixed step needs a ≥ ⌊r⌋ − 1 and leads to a + 1 − ⌊r⌋. More than one
switch per period is not described.

A law that is told the mode of L samples ago acts at (i, a) by (i, a − L) where a ≥ L. Else it goes
by what was seen b = L − a samples before i was. A sojourn shows at least q + 1 ≥ ⌊r⌋ = p samples,
so that the k-th sojourn back is told only if b > (k − 1) p, and then at an age of at least k p − b.
Where b ≤ p that is the mode before, and one row if rows go by the mode and there are two. In the
graph any row that may be told may act: V knows the mode and its age and not what was before.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from deadtime.feedback.table import Context, row_of

READINGS = Fraction(1, 2**50)  # of a ratio of two numbers: decimals, and binary64, and between


def decimal(value: float) -> Fraction:
    """The decimal that prints as a number."""
    return Fraction(repr(float(value)))


def shortest(dwell_time: float, step: float, tolerance: float) -> tuple[int, float]:
    """(the fewest full steps of a sojourn, the earliest s'/h there), rounded down.

    −1 full steps: one period may hold two switches.

    Examples
    --------
    >>> shortest(0.2, 0.1, 1e-5), shortest(0.25, 0.1, 1e-5)
    ((0, 0.9999799999999981), (1, 0.4999749999999977))
    """
    part = (1 - decimal(tolerance)) * (1 - READINGS)
    periods = part * decimal(dwell_time) / decimal(step)
    whole = math.floor(periods)
    return whole - 1, max(0.0, math.nextafter(float(periods - whole), 0.0))


def longest(maximum_dwell: float, step: float, tolerance: float) -> tuple[int, float]:
    """(the most full steps of a sojourn with a longest one, the latest s'/h there), rounded up."""
    part = (1 + decimal(tolerance)) * (1 + READINGS)
    periods = part * decimal(maximum_dwell) / decimal(step)
    most = math.ceil(periods) - 1
    return most, min(1.0, math.nextafter(float(periods - most), 1.0))


@dataclass(frozen=True)
class Transition:
    """One step of the graph: from (mode, age) under a row to (after, next_age).

    `instants` are the first and the last fraction of the period at which it may switch.
    """

    mode: int
    age: int
    row: int
    after: int
    next_age: int
    instants: tuple[float, float] = (0.0, 1.0)

    @property
    def switches(self) -> bool:
        """Whether the plant switches in this step."""
        return self.mode != self.after


@dataclass(frozen=True)
class Stretch:
    """Periods from one node to the next that the loop meets: full steps, one step, full steps.

    Attributes
    ----------
    knot, next_knot : int
        Which of the ages told apart the nodes have, in the modes before and after the step.
    waits, follows : int
        How many full steps come before and after the step.
    step : Transition
        The one that may switch.
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
class Transitions:
    """The graph (immutable).

    Attributes
    ----------
    modes : int
        Number of modes.
    first : int
        The least age, in samples, from which a step may switch.
    last : int
        The largest age that is told apart.
    ends : bool
        Whether a mode must be left at the age `last` (a maximum dwell time).
    bucket : int or None
        What a switch takes from the age; None where it sets it to 0.
    context : str
        What selects the table's row.
    ages : int
        Rows per mode of a (mode, age) table.
    earliest, latest : float
        The first instant of a switch at the age `first`, and the last at `last` where a mode must
        be left then: fractions of the period.
    lag : int
        L, how many samples ago the mode was that the law is told.
    """

    modes: int
    first: int
    last: int
    ends: bool
    bucket: int | None
    context: Context
    ages: int
    earliest: float = 0.0
    latest: float = 1.0
    lag: int = 0

    @classmethod
    def of(
        cls,
        modes: int,
        times: tuple[float, float | None],
        chatter: int,
        step: float,
        tolerance: float,
        context: Context,
        ages: int,
        lag: int = 0,
    ) -> Transitions:
        """The graph of a (dwell time, maximum dwell time) at a period, in seconds."""
        dwell_time, maximum_dwell = times
        if modes == 1:
            return cls(1, 0, ages - 1, False, None, context, ages)
        first, earliest = shortest(dwell_time, step, tolerance)
        if chatter > 1:
            last = max(first, math.ceil(chatter * decimal(dwell_time) / decimal(step)))
            return cls(modes, first, last, False, first, context, ages, lag=lag)
        if maximum_dwell is not None:
            last, latest = longest(maximum_dwell, step, tolerance)
            return cls(modes, first, last, True, None, context, ages, earliest, latest, lag)
        # The last age stands for all later ones, at which a mode may be left at any instant.
        last = max(first + 1, ages - 1 + lag)
        return cls(modes, first, last, False, None, context, ages, earliest, lag=lag)

    def row(self, mode: int, age: int) -> int:
        """The row of the table at (mode, age), where that is what the law is told."""
        return row_of(self.context, self.ages, mode, max(0, age - self.lag))

    def rows(self, mode: int, age: int) -> list[int]:
        """The rows that may apply: of what may be told, and of any age at a bucket's level."""
        if self.bucket is not None and self.lag:
            return list(range(self.modes * self.ages))
        if self.bucket is not None and self.context == "mode_age":
            return list(range(mode * self.ages, (mode + 1) * self.ages))
        if age >= self.lag:
            return [self.row(mode, age)]
        told = self._before(mode, self.lag - age).items()
        return [i * self.ages + a for i, least in sorted(told) for a in range(least, self.ages)]

    def _before(self, mode: int, samples: int) -> dict[int, int]:
        """Which modes may have been seen so many samples before one was, and their least ages."""
        shortest, least = self.first + 1, dict[int, int]()
        for back in range(1, -(-samples // shortest) + 1):
            age = max(0, back * shortest - samples)
            for i in self._sojourns_back(mode, back):
                least[i] = min(age, self.ages - 1, least.get(i, age))
        return least

    def _sojourns_back(self, mode: int, back: int) -> list[int]:
        """The modes that may have been so many sojourns before one."""
        if self.modes == 2:
            return [(mode + back) % 2]
        return self.others(mode) if back == 1 else list(range(self.modes))

    def rows_after(self, step: Transition, follows: int) -> list[int]:
        """The rows of the first periods after a switch, as far as the mode before it is told.

        For a step that begins at an age of `lag` − 1 or more.
        """
        if not step.switches:
            return []
        first = step.age + 1 - self.lag
        ages = range(first, first + min(self.lag, follows))
        return [row_of(self.context, self.ages, step.mode, age) for age in ages]

    def all(self, knots: tuple[int, ...] = (0,)) -> list[Transition]:
        """The transitions to check.

        Between two `knots` all that depends on the age is linear in it, unless the rows change
        with it, as they do up to the last of them; there the first and the last step of each
        segment imply the others.
        """
        changing = self.ages if self.context == "mode_age" and self.bucket is None else 0
        marks = {*knots, self.first, self.first + 1, self.last, 0, changing + self.lag}
        if self.lag:
            marks |= self._changes()
        marks |= {knot + (self.bucket or 0) for knot in knots}
        ends = {a for mark in marks for a in (mark - 1, mark)}
        transitions = []
        for i in range(self.modes):
            for a in range(self.last + 1):
                if not (self.lag <= a < self.lag + changing or a in ends):
                    continue
                for row in self.rows(i, a):
                    if a < self.last or not self.ends:
                        transitions.append(Transition(i, a, row, i, min(a + 1, self.last)))
                    transitions += self.switches(i, a, row)
        return transitions

    def _changes(self) -> set[int]:
        """The ages up to the lag at which what may be told is not what it is a sample before."""
        told = [[self.rows(i, a) for i in range(self.modes)] for a in range(self.lag + 1)]
        return {a for a in range(1, self.lag + 1) if told[a] != told[a - 1]}

    def stretches(self, knots: tuple[int, ...]) -> list[Stretch]:
        """The stretches between nodes at these ages, which `validate` found to cover the graph."""
        stretches = []
        for i in range(self.modes):
            for k, age in enumerate(knots):
                if k + 1 < len(knots):
                    end = knots[k + 1]
                    full = Transition(i, end - 1, self.row(i, end - 1), i, end)
                    stretches.append(Stretch(k, end - 1 - age, full, 0, k + 1))
                else:
                    end = self.last + 1
                    if not self.ends:
                        full = Transition(i, self.last, self.row(i, self.last), i, self.last)
                        stretches.append(Stretch(k, 0, full, 0, k))
                for at in range(max(self.first, age), end):
                    mixed = self.switches(i, at, self.row(i, at))
                    stretches += [Stretch(k, at - age, step, knots[0], 0) for step in mixed]
        return stretches

    def switches(self, mode: int, age: int, row: int) -> list[Transition]:
        """The mixed steps from (mode, age)."""
        if age < self.first:
            return []
        after = 0 if self.bucket is None else age - self.bucket
        low = self.earliest if age == self.first else 0.0
        high = self.latest if age == self.last else 1.0
        return [Transition(mode, age, row, j, after, (low, high)) for j in self.others(mode)]

    def others(self, mode: int) -> list[int]:
        """The modes that one may switch to."""
        return [j for j in range(self.modes) if j != mode]


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
