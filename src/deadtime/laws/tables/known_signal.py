"""The rows of a forecast that is one known switching signal.

From t_k the forecast runs over N − 1 whole steps of the plant and then φ. With Φ⁰, Γ⁰ over the
first φ of a step and Φ¹, Γ¹ over the rest of it, u_{k−j} acts during phase 1 of step
k − j + N − 1 (for j < N; the phase of u_{k−N} is past) and phase 0 of step k − j + N. The
functional R = K_σ(t_k+D) is carried backwards from t_k + D over these phases: each adds R Γ to
the tap of its input and turns R into R Φ. What remains of R at t_k is F.
"""

from __future__ import annotations

import numpy as np

from deadtime.numerics.stacked import last, products, stack
from deadtime.plant import SampledPlant
from deadtime.plant.steps import Cuts


def future_rows(
    sampled: SampledPlant, final_gain: np.ndarray, cuts: Cuts
) -> tuple[np.ndarray, np.ndarray]:
    """F (steps, m, n) and G (steps, N, m, m) along a known signal, all samples at once.

    `final_gain` (steps, m, n) is K_σ(t_k + D) for every sample.
    """
    (steps, m, _), count = final_gain.shape, sampled.longest_lag
    table = sampled.along(cuts, steps + count - 1)
    # Of one delay all periods have as many pieces.
    index = table.entry.reshape(table.first.size - 1, -1)
    Phi, Gamma, R = last(table.Phi), last(table.Gamma), last(final_gain)
    G = np.zeros((count, m, m, steps))
    with np.errstate(all="ignore"):
        for j in range(1, count + 1):
            for late in range(2 if index.shape[1] > 1 and j < count else 1):
                phase = index[count - j - late : count - j - late + steps, late]
                G[j - 1] += products(R, Gamma.take(phase, axis=-1))
                R = products(R, Phi.take(phase, axis=-1))
    return stack(R), stack(G)
