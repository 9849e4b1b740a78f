"""Parts of an ideal run under a rule, one motion each, and the inputs that it was sent.

Under a rule the input sent at t is known once the plant has read it, as K x of that instant. It is
stored as it becomes known: polynomials end to end, and the instants at which it is not smooth.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.numerics.polynomials import gauss, shares
from deadtime.simulation.digital import RunOutcome
from deadtime.simulation.digital_record import Slide, join, slides_in_words
from deadtime.simulation.ideal.ideal_run import NODES, IdealRecord
from deadtime.simulation.ideal.segments import Piecewise
from deadtime.switching import SwitchingSignal
from deadtime.switching.rules.motion import Leg, Motion

DEPTH = 5  # a jump of a higher derivative weighs less than 1e-12 on pieces as short as these
_SAME = 1e-12  # of the time: switches that are closer are one


@dataclass(eq=False)
class Sent:
    """The values that one input has been sent so far.

    Attributes
    ----------
    edges : list of float
        Ends of the pieces, seconds; the last is the newest instant that is known.
    values : list of (p + 2,) arrays
        At the support nodes of each piece.
    held : list of bool
        Whether a piece is constant.
    bends : list of (time, order)
        Where it is not smooth, and the derivative that jumps there.
    """

    edges: list[float]
    values: list[np.ndarray]
    held: list[bool]
    bends: list[tuple[float, int]]

    @classmethod
    def before(cls, line: Float[np.ndarray, " piece"], longest: float) -> Sent:
        """The values sent before time 0, over equal pieces, oldest first."""
        edges = np.linspace(-longest, 0.0, line.size + 1)
        values = [np.full(NODES + 2, value) for value in line]
        jumps = edges[1:-1][np.diff(line) != 0.0].tolist()
        return cls(edges.tolist(), values, [True] * line.size, [(t, 0) for t in [*jumps, 0.0]])

    @property
    def newest(self) -> float:
        """The newest instant that is known, seconds."""
        return self.edges[-1]

    def send(self, end: float, values: Float[np.ndarray, " node"], held: bool = False) -> None:
        """Add a piece."""
        self.edges.append(end)
        self.values.append(values)
        self.held.append(held)

    def bend(self, order: int | None) -> None:
        """Note the derivative that jumps at the newest instant; None: the input is smooth there."""
        if order is not None and order <= DEPTH:
            self.bends.append((self.newest, order))

    def at(self, times: Float[np.ndarray, " T"]) -> Float[np.ndarray, " T"]:
        """Its values at times that are known."""
        places = [max(bisect_right(self.edges, t) - 1, 0) for t in times.tolist()]
        place = np.minimum(places, len(self.values) - 1)
        result, support = np.empty(times.size), gauss(NODES).support
        for q in np.unique(place).tolist():
            own, begin = place == q, self.edges[q]
            c = (times[own] - begin) / (self.edges[q + 1] - begin)
            result[own] = shares(c, support) @ self.values[q]
        return result

    def is_held(self, begin: float, end: float) -> bool:
        """Whether it is constant between two instants."""
        first = max(bisect_right(self.edges, begin) - 1, 0)
        last = min(bisect_right(self.edges, end), len(self.values)) - 1
        inside = slice(first, max(first, last) + 1)
        return all(self.held[inside]) and len({v[0] for v in self.values[inside]}) == 1

    def until(self, end: float) -> Piecewise:
        """The input as a function, up to `end`."""
        whole = with_edge(Piecewise(np.array(self.edges), np.array(self.values)[..., None]), end)
        edges = whole.edges[whole.edges <= end + whole.slack]
        return Piecewise(edges, whole.values[: edges.size - 1])


def with_edge(function: Piecewise, time: float) -> Piecewise:
    """The function with one more edge, at a time within its own."""
    edges, values, support = function.edges, function.values, gauss(NODES).support
    if np.abs(edges - time).min() <= function.slack:
        return function
    q = int(np.searchsorted(edges, time)) - 1
    begin, length = edges[q], edges[q + 1] - edges[q]
    ends = np.array([begin, time, edges[q + 1]])
    parts = [
        np.tensordot(shares((a + (b - a) * support - begin) / length, support), values[q], 1)
        for a, b in pairwise(ends)
    ]
    return Piecewise(
        np.concatenate((edges[: q + 1], [time], edges[q + 1 :])),
        np.concatenate((values[:q], parts, values[q + 1 :])),
    )


class RulePart(NamedTuple):
    """A part of the run in one motion, seconds from its start, and the input held over it."""

    begin: float
    end: float
    motion: Motion
    leg: Leg
    u: np.ndarray

    @property
    def mode(self) -> int:
        return self.motion.mode_of(self.leg.place)


def no_loop(stop: str, arrived: float) -> ArgumentError:
    """The error of a start from which no ideal run goes on."""
    return ArgumentError(
        f"x0 leads to no ideal loop, {stop}, before all inputs of the law have arrived, at "
        f"{arrived:g} s: give a step for a run up to there."
    )


def outcome_of(record: IdealRecord, parts: list[RulePart], end: float, stop: str) -> RunOutcome:
    """The outcome of a run of these parts; `stop` says why it ended early at `end`, or is empty."""
    reached = parts[-1].end
    signal = _signal(parts, reached)
    found = []
    for part in parts:
        if part.leg.beside is not None and part.begin < end:
            modes = [part.motion.mode_of(p) for p in (part.leg.place, part.leg.beside.place)]
            found.append(Slide(part.begin, min(part.end, end), (min(modes), max(modes))))
    notes = [slides_in_words(join(found, _SAME * max(1.0, reached)))]
    diverged = stop.startswith("diverged")  # of which `simulate` makes the sentence
    if stop and not diverged:
        notes.insert(0, f"{stop}, a delay ahead: the run ends at t = {end:g} s.")
    note = " ".join(filter(None, notes))
    return RunOutcome(record, signal, end if stop else None, diverged, note)


def _signal(parts: list[RulePart], reached: float) -> SwitchingSignal:
    """The switching signal that the parts are, known up to where they reach."""
    times, modes = [0.0], [parts[0].mode]
    for part in parts[1:]:
        if part.mode == modes[-1]:
            continue
        if part.begin - times[-1] <= _SAME * max(1.0, reached):
            modes[-1] = part.mode
            if modes[-1] in modes[-2:-1]:
                del times[-1], modes[-1]
        else:
            times.append(part.begin)
            modes.append(part.mode)
    return SwitchingSignal(times, modes, reached)
