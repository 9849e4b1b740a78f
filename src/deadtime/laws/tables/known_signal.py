"""The rows of a forecast that is one known switching signal, compiled.

From t_k the forecast runs over N − 1 whole steps of the plant and then φ. With Φ⁰, Γ⁰ over the
first φ of a step and Φ¹, Γ¹ over the rest of it, u_{k−j} acts during phase 1 of step
k − j + N − 1 (for j < N; the phase of u_{k−N} is past) and phase 0 of step k − j + N. The
functional R = K_σ(t_k+D) is carried backwards from t_k + D over these phases: each adds R Γ to
the tap of its input and turns R into R Φ. What remains of R at t_k is F.
"""

# Intrinsics take one argument less than the functions that declare them.
# pyright: reportCallIssue=false

from __future__ import annotations

import numpy as np
from numba import njit

from deadtime.numerics.lanes import LANES, gather, same, spread, table_product
from deadtime.plant import SampledPlant
from deadtime.plant.steps import Cuts


def future_rows(
    sampled: SampledPlant, final_gain: np.ndarray, cuts: Cuts
) -> tuple[np.ndarray, np.ndarray]:
    """F (steps, m, n) and G (steps, N, m, m) along a known signal.

    `final_gain` (steps, m, n) is K_σ(t_k + D) for every sample.
    """
    steps, m, n = final_gain.shape
    whole, count = -(-steps // LANES) * LANES, sampled.longest_lag
    table = sampled.along(cuts, whole + count - 1)
    # Of one delay all periods have as many pieces.
    index = table.entry.reshape(table.first.size - 1, -1)
    gains = np.concatenate((final_gain, np.zeros((whole - steps, m, n))))
    shape = (0.0,) * (m * n), (0.0,) * (m * m), (0.0,) * (n * m), (0.0,) * (n * n)
    F, G = _carry_back(
        gains.reshape(-1),
        index,
        table.Phi.reshape(-1),
        table.Gamma.reshape(-1),
        count,
        index.shape[1] > 1,
        *shape,
    )
    return F.reshape(whole, m, n)[:steps], G.reshape(whole, count, m, m)[:steps]


@njit(cache=True, nogil=True)
def _carry_back(gains, index, Phi, Gamma, count, cut, row, tap, entering, moving):
    """`future_rows` for eight samples at a time, all arrays flat."""
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
