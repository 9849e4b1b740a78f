"""The transitions that a class of signals allows, as a graph on (mode, age).

At a sample the mode i has been seen for a samples before. Over the next period the plant either
stays in i, a *full* step to (i, a + 1), or switches once, at any instant in it, a *mixed* step
to (j, 0). With r = τ_d/h and a switch s into its period, a sojourn of q full steps between two
mixed ones lasts (h − s) + q h + s', s, s' ∈ (0, h]; that is τ_d or more only if q > r − 2, and
at whole r only if q ≥ r − 1:

    q ≥ ⌊τ_d/h⌋ − 1.

All pairs (s, s') are allowed at that q, which is more than the dwell time allows. A maximum
dwell time τ_max allows q ≤ ⌈τ_max/h⌉ − 1; without one a mode may last for ever.

An average dwell time τ_a with chatter N₀ ≥ 2 allows N₀ + T/τ_a switches in any window of T. Then
the "age" is the level of a bucket instead: it gains 1 per period, up to N₀ r, and a switch takes
r of it. Rounded up, a mixed step needs a ≥ ⌊r⌋ − 1 and leads to a + 1 − ⌊r⌋. More than one
switch per period is not described.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np


def exact_ratio(time: float, step: float) -> Fraction:
    """time/step of the decimals that print as these numbers."""
    return Fraction(repr(float(time))) / Fraction(repr(float(step)))


@dataclass(frozen=True)
class Transition:
    """One step of the graph: from (mode, age) under a row to (after, next_age)."""

    mode: int
    age: int
    row: int
    after: int
    next_age: int

    @property
    def switches(self) -> bool:
        """Whether the plant switches in this step."""
        return self.mode != self.after


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
    """

    modes: int
    first: int
    last: int
    ends: bool
    bucket: int | None
    context: str
    ages: int

    @classmethod
    def of(
        cls,
        modes: int,
        times: tuple[float, float | None],
        chatter: int,
        step: float,
        context: str,
        ages: int,
    ) -> Transitions:
        """The graph of a (dwell time, maximum dwell time) at a period, in seconds."""
        dwell_time, maximum_dwell = times
        if modes == 1:
            last = ages - 1 if context == "mode_age" else 0
            return cls(1, 0, last, False, None, context, ages)
        ratio = exact_ratio(dwell_time, step)
        first = math.floor(ratio) - 1
        if chatter > 1:
            last = max(first, math.ceil(chatter * ratio))
            return cls(modes, first, last, False, first, context, ages)
        if maximum_dwell is not None:
            last = max(first, math.ceil(exact_ratio(maximum_dwell, step)) - 1)
            return cls(modes, first, last, True, None, context, ages)
        last = max(first, ages - 1) if context == "mode_age" else first
        return cls(modes, first, last, False, None, context, ages)

    def row(self, mode: int, age: int) -> int:
        """The row of the table at (mode, age)."""
        if self.context == "none":
            return 0
        return mode * self.ages + min(age, self.ages - 1)

    def rows(self, mode: int, age: int) -> list[int]:
        """The rows that may apply: a bucket's level does not tell the true age."""
        if self.bucket is not None and self.context == "mode_age":
            return list(range(mode * self.ages, (mode + 1) * self.ages))
        return [self.row(mode, age)]

    def all(self, knots: tuple[int, ...] = (0,)) -> list[Transition]:
        """The transitions to check.

        Between two `knots` all that depends on the age is linear in it, unless the rows change
        with it; there the first and the last step of each segment imply the others.
        """
        everything = self.context == "mode_age" and self.bucket is None
        marks = {*knots, self.first, self.last, 0}
        marks |= {knot + (self.bucket or 0) for knot in knots}
        ends = {a for mark in marks for a in (mark - 1, mark)}
        found = []
        for i in range(self.modes):
            for a in range(self.last + 1):
                if not (everything or a in ends):
                    continue
                for row in self.rows(i, a):
                    if a < self.last or not self.ends:
                        found.append(Transition(i, a, row, i, min(a + 1, self.last)))
                    if a >= self.first:
                        after = 0 if self.bucket is None else a - self.bucket
                        others = (j for j in range(self.modes) if j != i)
                        found += [Transition(i, a, row, j, after) for j in others]
        return found


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
