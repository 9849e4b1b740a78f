"""The rows of a forecast that is one known switching signal.

The functional R = K_σ(t_k+D) is carried backwards from t_k + D over the pieces in which inputs
act that are in flight at t_k: each adds R Γ to the taps of its inputs and turns R into R Φ. What
remains of R at t_k is F.
"""

from __future__ import annotations

import numpy as np

from deadtime.plant import SampledPlant
from deadtime.plant.steps import Cuts


def future_rows(
    sampled: SampledPlant, final_gain: np.ndarray, cuts: Cuts
) -> tuple[np.ndarray, np.ndarray]:
    """F (steps, m, n) and G (steps, N, m, m) along a known signal, of all samples at once.

    `final_gain` (steps, m, n) is K_σ(t_k + D) for every sample.
    """
    steps, m, _ = final_gain.shape
    table = sampled.along(cuts, steps + sampled.longest_lag)
    sample = table.sample
    pieces = np.searchsorted(sample[:, 0], np.arange(steps)) - table.first[:steps]
    R, G = final_gain.copy(), np.zeros((steps, sampled.longest_lag, m, m))
    for back in range(1, pieces.max() + 1):
        k = np.flatnonzero(pieces >= back)
        piece = table.first[k] + pieces[k] - back
        Phi, Gamma = table.Phi[table.entry[piece]], table.Gamma[table.entry[piece]]
        tap = np.einsum("kia,kaj->kij", R[k], Gamma)
        for j in range(m):
            G[k, k - sample[piece, j] - 1, :, j] += tap[:, :, j]
        R[k] = np.einsum("kia,kab->kib", R[k], Phi)
    return R, G
