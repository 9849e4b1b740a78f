"""Where the ideal loop is not analytic, and the segments between.

The state's slope jumps at a switch; a delay passes every jump on, one derivative smoother:
to the times shifted by the plant's delay (through the input) and by the law's (through the
edge of its window). A jump passed on ten times has no weight left in double precision.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.switching import SwitchingSignal

_SAME = 1e-12


class Shift(NamedTuple):
    """A delay by which jumps are passed on.

    seconds; the mode in which it is read, None for any; and by how much a jump counts less one
    derivative further up, over the order of that derivative.
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
    """The times and their shifts up to `high`, as long as what is passed on weighs over `faint`.

    A plant with delays of its own in every mode passes an input on by those of the mode that reads
    it. Gauss sums of p nodes on segments of length h see a jump of the k-th derivative, of what
    moves at a rate λ, as (λh/2p)ᵏ/k!, which is what the weights of shifts multiply to.

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
