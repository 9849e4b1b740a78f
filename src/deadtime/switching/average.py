"""The average dwell time of a signal, in one pass over its switches.

Between switch i and switch j ≥ i, at t_i and t_j, there are j − i + 1 of them: at most
N₀ + (t_j − t_i)/τ for all i, j means

    τ ≤ (t_j − t_i)/(j + 1 − N₀ − i)   wherever the denominator is positive,

the slope from the point (i, t_i) to the point (j + 1 − N₀, t_j). The least slope to a point comes
from the upper hull of the points to its left, and the hull's first points, once steeper than
those that follow, never matter again.

References
----------
K.-M. Chung and H.-I. Lu, "An optimal algorithm for the maximum-density segment problem", SIAM J.
Comput. 34(2), 2004.
"""

from __future__ import annotations

import numpy as np

from deadtime.numerics.kernels import kernel


@kernel
def least_slope(t, chatter):
    """min (t_j − t_i)/(j + 1 − chatter − i) over i ≤ j where positive; infinite for no pair."""
    hull = np.empty(t.size, np.int64)
    first, stop, new = 0, 0, 0
    least = np.inf
    for j in range(t.size):
        while new <= j and j + 1 - new > chatter:
            while stop - first >= 2:
                a, b = hull[stop - 2], hull[stop - 1]
                if (t[b] - t[a]) * (new - b) > (t[new] - t[b]) * (b - a):
                    break
                stop -= 1
            hull[stop] = new
            stop += 1
            new += 1
        if stop == first:
            continue
        while True:
            a = hull[first]
            slope = (t[j] - t[a]) / (j - a + 1 - chatter)
            if stop - first < 2:
                break
            b = hull[first + 1]
            if (t[j] - t[b]) / (j - b + 1 - chatter) > slope:
                break
            first += 1
        least = min(least, slope)
    return least
