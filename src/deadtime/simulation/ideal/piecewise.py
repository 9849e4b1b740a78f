"""Functions of time that are polynomials on segments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deadtime.base.frozen import Frozen
from deadtime.numerics.polynomials import gauss
from deadtime.simulation.ideal.breakpoints import merge
from deadtime.simulation.initial_input import InputHistory


@dataclass(frozen=True, eq=False)
class Piecewise(Frozen):
    """A vector-valued function of time, a polynomial on each segment; values are right limits.

    Attributes
    ----------
    edges : (segments + 1,)
        Ends of the segments.
    values : (segments, nodes, k)
        Values at the support nodes of each segment: its start, Gauss points, its end.

    Examples
    --------
    >>> line = Piecewise(np.array([0.0, 2.0]), 2.0 * gauss(3).support[None, :, None])
    >>> line(np.array([0.5, 1.5])).ravel()
    array([0.5, 1.5])
    """

    edges: Float[np.ndarray, " edge"]
    values: Float[np.ndarray, "segment node k"]

    @property
    def slack(self) -> float:
        """How far before an edge a time counts as at it."""
        return 1e-12 * max(1.0, float(self.edges[-1]))

    def __call__(self, times: Float[np.ndarray, " T"]) -> Float[np.ndarray, "T k"]:
        """Values at times within the edges, in any order."""
        from deadtime.simulation.ideal.collocation import sample

        nodes, edges = gauss(self.values.shape[1] - 2), self.edges
        # A time within round-off before an edge is at it.
        following = edges[np.minimum(np.searchsorted(edges, times), edges.size - 1)]
        close = following - times <= self.slack
        times = np.where(close, following, times)
        order = np.argsort(times, kind="stable")
        result = np.empty((times.size, self.values.shape[2]))
        result[order] = sample(
            edges, self.values, nodes.support, nodes.barycentric, times[order], 0
        )
        return result

    def form_integral(self, start: float, end: float, Q: np.ndarray | None = None) -> float:
        """∫fᵀQf over [start, end], both of them edges; None: Q = I."""
        inside = (self.edges[:-1] >= start - 1e-12) & (self.edges[1:] <= end + 1e-12)
        weights = np.diff(self.edges)[inside, None] * gauss(self.values.shape[1] - 2).weights
        f = self.values[inside, 1:-1]
        return float(np.sum(weights * np.sum(f**2 if Q is None else f * (f @ Q), axis=2)))


def side_by_side(functions: list[Piecewise]) -> Piecewise:
    """Functions as one, on the segments of all and where all are known.

    Those on the same segments keep their values, others are interpolated.

    Examples
    --------
    >>> t = gauss(3).support[None, :, None]
    >>> slow = Piecewise(np.array([0.0, 2.0]), 2.0 * t)
    >>> both = side_by_side([slow, Piecewise(np.array([0.0, 1.0]), 3.0 * t)])
    >>> both.edges, both(np.array([0.5])).round(12)
    (array([0., 1.]), array([[0.5, 1.5]]))
    """
    first = functions[0]
    if all(np.array_equal(each.edges, first.edges) for each in functions):
        return Piecewise(first.edges, np.concatenate([each.values for each in functions], axis=2))
    low, high = max(each.edges[0] for each in functions), min(each.edges[-1] for each in functions)
    edges = merge(np.concatenate([each.edges for each in functions]), float(low), float(high))
    joint = InputHistory(lambda t: np.hstack([each(t) for each in functions]), np.empty(0))
    return Piecewise(edges, joint.on(edges, gauss(first.values.shape[1] - 2)))
