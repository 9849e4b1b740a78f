"""The compiled map from a period's start to measurements within it."""

from __future__ import annotations

import numpy as np

from deadtime.numerics.kernels import kernel
from deadtime.plant.pieces import up_to


@kernel
def ways(A, B, table, cut_offset, cut_mode, entry, offset):
    """Φ and Γ of entries from their starts up to `offset` seconds after their period's sample."""
    n, m = B.shape[1:]
    Phi, Gamma = np.empty((entry.size, n, n)), np.empty((entry.size, n, m))
    for v in range(entry.size):
        one_Phi, one_Gamma = up_to(A, B, table, cut_offset, cut_mode, entry[v], offset[v])
        for i in range(n):
            for j in range(n):
                Phi[v, i, j] = one_Phi[i, j]
            for j in range(m):
                Gamma[v, i, j] = one_Gamma[i, j]
    return Phi, Gamma
