"""Where the ideal loop is not analytic, and the segments between.

The state's slope jumps at a switch; a delay passes every jump on, one derivative smoother:
to the times shifted by the plant's delay (through the input) and by the law's (through the
edge of its window). A jump passed on ten times has no weight left in double precision.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

_DEPTH = 10
_SAME = 1e-12


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


def add_shifts(times: np.ndarray, delays: tuple[float, ...], high: float) -> np.ndarray:
    """The times and all their shifts by sums of up to ten of the delays, up to `high`.

    Examples
    --------
    >>> add_shifts(np.array([0.0, 0.3]), (1.0,), 2.5).tolist()
    [0.0, 0.3, 1.0, 1.3, 2.0, 2.3]
    """
    steps = sorted(set(delays))
    reached, front = [times], times
    for _ in range(_DEPTH):
        front = np.concatenate([front + delay for delay in steps])
        front = np.unique(front[front <= high])
        if not front.size:
            break
        reached.append(front)
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
