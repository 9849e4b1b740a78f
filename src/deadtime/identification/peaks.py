"""Whether a delay has other peaks that are plausible, from the likelihood of all its cells."""

from __future__ import annotations

import numpy as np

from deadtime.identification.intervals import LEVEL
from deadtime.identification.likelihoods.likelihood import Likelihood
from deadtime.identification.parameters import Layout
from deadtime.identification.start import Start

_PROFILE = 3.841458820694124  # χ² of one degree of freedom at 95 %


def over_other_peaks(
    log: Likelihood, interval: np.ndarray, start: Start, row: int, inflation: float
) -> np.ndarray:
    """An interval and all beyond it up to the last cell that a fresh rise makes plausible."""
    h, curve = log.recording.step, start.scanned[row]
    fall = plausible_fall(log.layout, start.weights, curve.size, inflation)
    ends = interval.copy()
    first = max(int(np.ceil(interval[0] / h - 1e-9)) - start.first, 0)  # the cell of the end
    last = max(int(np.ceil(interval[1] / h - 1e-9)) - start.first, 0)
    top = int(curve.argmax())  # a neighbour is the same peak: cells of uneven rows are rough
    first, last = first - (top == first - 1), last + (top == last + 1)
    below, above = curve[: first + 1][::-1], curve[last:]
    if (found := fresh_rise(below, curve.max() - fall)) is not None:
        ends[0] = min(ends[0], (start.first + first - found - 1) * h)
    if (found := fresh_rise(above, curve.max() - fall)) is not None:
        ends[1] = max(ends[1], (start.first + last + found) * h)
    if start.vectors is not None:  # then the curve is a profile, and no place is left out of it
        near = start.first + np.flatnonzero(curve >= curve.max() - 0.5 * inflation * _PROFILE)
        if near[0] * h < interval[0] - h:
            ends[0] = min(ends[0], (near[0] - 1) * h)
        if (near[-1] - 1) * h > interval[1] + h:
            ends[1] = max(ends[1], near[-1] * h)
    return np.clip(ends, *log.bounds)


def plausible_fall(layout: Layout, weights: int, cells: int, inflation: float) -> float:
    """How far below the likeliest cell's log likelihood a plausible one's is at most.

    A cell's weights are free in each mode that has the delay. Of as many cells as there are each
    may be the likeliest by chance, so that the level is Bonferroni's.
    """
    from scipy.stats import chi2

    free = weights * (1 if layout.per_mode else layout.modes)
    return 0.5 * inflation * float(chi2.isf((1.0 - LEVEL) / cells, free))


def fresh_rise(outwards: np.ndarray, level: float) -> int | None:
    """The last cell above a level that is likelier than one before it."""
    least = np.minimum.accumulate(outwards)
    found = np.flatnonzero((outwards > least) & (outwards >= level))
    return int(found[-1]) if found.size else None
