"""The segments of an ideal run, between instants where it is not analytic, and polynomials on them.

The state's slope jumps at a switch. A delay passes every jump on, one derivative smoother: to the
times shifted by the plant's delay (through the input) and by the law's (through the edge of its
window). A jump passed on ten times is below double precision.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.feedback import Forecast, Functional
from deadtime.numerics.polynomials import gauss
from deadtime.plant import SwitchedSystem
from deadtime.simulation.initial_input import InputHistory
from deadtime.switching import SwitchingSignal
from deadtime.switching.grid import first_reads

NODES = 10  # of a segment
_RESOLUTION = 1.5  # longest segment times the fastest rate
_SAME = 1e-12  # of the run's length: edges that are closer are one
_MOST_SEGMENTS = 1e6
_MOST_WORK = 6e10  # multiplications: a minute or so
_FLOW = 60.0  # cost of a window's exponentials on a segment, in units of its order cubed


class Shift(NamedTuple):
    """A delay by which jumps are passed on.

    seconds; the mode in which the input is read, None for any; and the factor by which a jump's
    weight falls per derivative, to be divided by the order of that derivative.
    """

    seconds: float
    mode: int | None
    weight: float


def merge(times: np.ndarray, low: float, high: float) -> Float[np.ndarray, " edge"]:
    """The times within [low, high], sorted, both ends included, near repeats dropped.

    Examples
    --------
    >>> merge(np.array([2.0, 1.0, 1.0 + 1e-14, 5.0]), 0.0, 3.0)
    array([0., 1., 2., 3.])
    """
    tolerance = _SAME * max(1.0, high - low)
    inner = np.sort(times[(times > low + tolerance) & (times < high - tolerance)])
    kept = inner[np.concatenate(([True], np.diff(inner) > tolerance))] if inner.size else inner
    return np.concatenate(([low], kept, [high]))


def pass_on(
    times: np.ndarray,
    shifts: list[Shift],
    signal: SwitchingSignal,
    high: float,
    faint: float = 1e-15,
) -> np.ndarray:
    """The times and their shifts up to `high`, as long as jumps weigh more than `faint`.

    Delays that differ between modes pass an input on by those of the mode that reads it. For a
    system of rate λ, Gauss sums of p nodes on segments of length h are off by (λh/2p)ᵏ/k! from a
    jump of the k-th derivative: the product of the shifts' weights.

    Examples
    --------
    >>> shifts = [Shift(0.5, 0, 0.01), Shift(0.2, 1, 0.01)]
    >>> signal = SwitchingSignal([0.0, 0.6], [0, 1])
    >>> pass_on(np.array([0.0]), shifts, signal, 0.95).round(9).tolist()
    [0.0, 0.5, 0.7, 0.9]
    """
    close = _SAME * max(1.0, high)
    reached, weight, order = [times], np.ones(times.size), 0
    while times.size:
        order += 1
        found, weights = [], []
        for shift in shifts:
            t, w = times + shift.seconds, weight * (shift.weight / order)
            kept = (t <= high) & (w > faint)
            if shift.mode is not None:
                inside = np.maximum(t, 0.0)
                kept &= (
                    (signal(inside) == shift.mode)
                    | (signal(np.maximum(inside - close, 0.0)) == shift.mode)
                    | (signal(inside + close) == shift.mode)
                )
            found.append(t[kept])
            weights.append(w[kept])
        times, weight = np.concatenate(found), np.concatenate(weights)
        if times.size:
            place = np.argsort(times, kind="stable")
            times, weight = times[place], weight[place]
            first = np.flatnonzero(np.append(True, np.diff(times) > close))
            times, weight = times[first], np.maximum.reduceat(weight, first)
            reached.append(times)
    return np.concatenate(reached)


def subdivide(edges: np.ndarray, longest: float) -> Float[np.ndarray, " edge"]:
    """The edges, with segments longer than `longest` cut into equal parts.

    Examples
    --------
    >>> subdivide(np.array([0.0, 0.1, 1.0]), 0.5)
    array([0.  , 0.1 , 0.55, 1.  ])
    """
    parts = np.maximum(1, np.ceil(np.diff(edges) / longest - 1e-9).astype(int))
    fraction = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    start = np.repeat(edges[:-1], parts)
    return np.append(start + fraction * np.repeat(np.diff(edges) / parts, parts), edges[-1])


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
        """Seconds before an edge within which a time counts as at the edge."""
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
    """Several functions as one, over the time in which all are known, on the segments of all.

    Functions on the same segments keep their values; others are interpolated.

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


def _require_no_minutes(law: Functional, time: float, shortest: float, longest: float) -> None:
    """Refuse delays that differ by so little that very many segments are needed."""
    count, windows, order = time / longest, law.near.size, law.S.shape[1]
    summed = float((law.far - law.near).sum()) / longest
    if count * (summed * order**2 + _FLOW * windows * order**3) > _MOST_WORK:
        raise ArgumentError(
            f"step must be given: delays that differ by {shortest:.3g} s take {count:,.0f} "
            f"segments of {longest:.2g} s, and minutes for the law's {windows} windows: make them "
            "equal, shorten the horizon, or give a step."
        )


def segments_of(
    plant: SwitchedSystem,
    law: Functional | Forecast,
    signal: SwitchingSignal,
    horizon: float,
    history: InputHistory,
    rereads: bool = False,
) -> tuple[Float[np.ndarray, " edge"], int]:
    """The edges of all segments, and the index of the first after time 0.

    `rereads`: predictions read again, after a switch, what they have predicted themselves.
    """
    delays, reaches = np.unique(plant.delays), law.reaches
    breaks = np.concatenate([law.breaks, *(law.breaks - reach for reach in reaches)])
    if rereads:
        apart = np.unique(reaches[:, None] - reaches)
        longer = np.concatenate([law.breaks + more for more in apart if more > 0.0])
        breaks = np.concatenate([breaks, longer, *(longer - reach for reach in reaches)])
    # x is known until the plant reads inputs after the end of the run.
    high = float(first_reads(signal, plant.delays, np.array([horizon]), 0.0).min())
    low = -max(reaches[-1], delays[-1])
    before = np.concatenate((history.jumps, breaks, -reaches, -delays))
    seeds = np.concatenate(([0.0], signal.times, breaks, history.jumps))
    # Short enough for the polynomials, and for delayed inputs to lie in segments already done.
    speeds = law.speeds(plant)
    shortest = min([delays[0], *reaches[reaches > 0.0].tolist()])
    longest = min(_RESOLUTION / max(speeds.fastest, np.finfo(float).tiny), shortest / 2.0)
    if isinstance(law, Functional) and shortest < delays[0]:
        _require_no_minutes(law, high - low, shortest, longest)
    if (high - low) / longest > _MOST_SEGMENTS:
        raise ArgumentError(
            f"horizon is too long for the ideal loop: it would take {(high - low) / longest:.0e} "
            f"segments of {longest:.1e} s; shorten it, or give a step."
        )
    size = longest / (2 * NODES)
    alike = plant.modes_share_delays
    through = [
        Shift(float(delay), i, speeds.arriving * size)
        for i in ([None] if alike else range(plant.modes))
        for delay in np.unique(plant.delays[i or 0])
    ]
    through += [Shift(end, None, jump * size) for end, jump in speeds.windows.items()]
    reached = pass_on(seeds, through, signal, high, speeds.faint)
    after = np.concatenate((reached, [horizon]))
    past = subdivide(merge(before, low, 0.0), longest)
    future = subdivide(merge(after, 0.0, high), longest)
    return np.concatenate((past, future[1:])), past.size - 1
