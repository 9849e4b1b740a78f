"""`deadtime.laws.tables.known_signal` for eight samples at a time, compiled."""

# Intrinsics take one argument less than the functions that declare them.
# pyright: reportCallIssue=false

from __future__ import annotations

import numpy as np

from deadtime.numerics.kernels import kernel
from deadtime.numerics.lanes import LANES, gather, same, spread, table_product


@kernel(eager=True, nogil=True)
def carry_back(gains, index, Phi, Gamma, count, cut, row, tap, entering, moving):
    """R carried back from the final gains of a multiple of eight samples, all arrays flat."""
    size, taps = len(row), len(tap)
    whole = gains.size // size
    F, G = np.empty(whole * size), np.empty(whole * count * taps)
    samples, of_u, of_x = np.arange(LANES), np.empty(LANES, np.int64), np.empty(LANES, np.int64)
    for k in range(0, whole, LANES):
        R = gather(gains, (k + samples) * size, row)
        for j in range(1, count + 1):
            sums = same(0.0, tap)
            for late in range(2 if cut and j < count else 1):
                for lane in range(LANES):
                    phase = index[k + lane + count - j - late, late]
                    of_u[lane], of_x[lane] = phase * len(entering), phase * len(moving)
                sums = table_product(R, gather(Gamma, of_u, entering), sums)
                R = table_product(R, gather(Phi, of_x, moving), same(0.0, row))
            spread(G, (k * count + j - 1) * taps, count * taps, sums)
        spread(F, k * size, size, R)
    return F, G
