"""What has been sent to one input, kept as it becomes known: polynomials end to end, and bends.

Under a rule what an input is sent at t is known once the plant has read it, as K x of that instant.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from deadtime.numerics.polynomials import gauss, shares
from deadtime.simulation.ideal.ideal_run import NODES
from deadtime.simulation.ideal.piecewise import Piecewise

DEPTH = 5  # a jump of a higher derivative weighs less than 1e-12 on pieces as short as these


@dataclass(eq=False)
class Sent:
    """What one input has been sent so far.

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
        """What was sent before time 0, over equal pieces, oldest first."""
        edges = np.linspace(-longest, 0.0, line.size + 1)
        values = [np.full(NODES + 2, value) for value in line]
        jumps = edges[1:-1][np.diff(line) != 0.0].tolist()
        return cls(edges.tolist(), values, [True] * line.size, [(t, 0) for t in [*jumps, 0.0]])

    @property
    def newest(self) -> float:
        """Up to when it is known, seconds."""
        return self.edges[-1]

    def send(self, end: float, values: Float[np.ndarray, " node"], held: bool = False) -> None:
        """Add a piece."""
        self.edges.append(end)
        self.values.append(values)
        self.held.append(held)

    def bend(self, order: int | None) -> None:
        """Take note that what follows bends from what there is; None: it does not."""
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
        """It as a function, up to `end`."""
        whole = with_edge(Piecewise(np.array(self.edges), np.array(self.values)[..., None]), end)
        edges = whole.edges[whole.edges <= end + whole.slack]
        return Piecewise(edges, whole.values[: edges.size - 1])


def with_edge(function: Piecewise, time: float) -> Piecewise:
    """The same function with an edge at a time within its own."""
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
