"""The rows of a forecast that is one known switching signal.

From t_k the forecast runs over N − 1 whole steps of the plant and then φ. With Φ⁰, Γ⁰ over the
first φ of a step and Φ¹, Γ¹ over the rest of it, u_{k−j} acts during phase 1 of step
k − j + N − 1 (for j < N; the phase of u_{k−N} is past) and phase 0 of step k − j + N. The
functional R = K_σ(t_k+D) is carried backwards from t_k + D over these phases: each adds R Γ to
the tap of its input and turns R into R Φ. What remains of R at t_k is F.
"""

from __future__ import annotations

import time

import numpy as np

from deadtime.numerics.stacked import add_products, last, products, stack
from deadtime.plant import SampledPlant
from deadtime.plant.pieces import PieceTable
from deadtime.plant.steps import Cuts

PATIENCE = 0.5  # seconds that NumPy may take in a process before what is compiled takes over
_spent = [0.0]


def future_rows(
    sampled: SampledPlant, final_gain: np.ndarray, cuts: Cuts
) -> tuple[np.ndarray, np.ndarray]:
    """F (steps, m, n) and G (steps, N, m, m) along a known signal.

    `final_gain` (steps, m, n) is K_σ(t_k + D) for every sample. Many signals are left to compiled
    loops, which give the same bits.
    """
    if _spent[0] > PATIENCE:
        return by_lanes(sampled, final_gain, cuts)
    began = time.perf_counter()
    count = sampled.longest_lag
    table = sampled.along(cuts, len(final_gain) + count - 1)
    rows = at_once(table, final_gain, count)
    _spent[0] += time.perf_counter() - began
    return rows


def at_once(table: PieceTable, final_gain: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """`future_rows` by NumPy, all samples at once."""
    steps, m, _ = final_gain.shape
    # Of one delay all periods have as many pieces.
    index = table.entry.reshape(table.first.size - 1, -1)
    Phi, Gamma, R = last(table.Phi), last(table.Gamma), last(final_gain)
    G = np.zeros((count, m, m, steps))
    with np.errstate(all="ignore"):
        for j in range(1, count + 1):
            for late in range(2 if index.shape[1] > 1 and j < count else 1):
                phase = index[count - j - late : count - j - late + steps, late]
                add_products(R, Gamma.take(phase, axis=-1), G[j - 1])
                R = products(R, Phi.take(phase, axis=-1))
    return stack(R), np.ascontiguousarray(G.transpose(3, 0, 1, 2))


def by_lanes(
    sampled: SampledPlant, final_gain: np.ndarray, cuts: Cuts
) -> tuple[np.ndarray, np.ndarray]:
    """`future_rows` compiled, eight samples at a time."""
    from deadtime.laws.tables.known_signal_lanes import carry_back
    from deadtime.numerics.lanes import LANES

    (steps, m, n), count = final_gain.shape, sampled.longest_lag
    whole = -(-steps // LANES) * LANES
    table = sampled.along(cuts, whole + count - 1)
    index = table.entry.reshape(table.first.size - 1, -1)
    gains = np.concatenate((final_gain, np.zeros((whole - steps, m, n))))
    shape = (0.0,) * (m * n), (0.0,) * (m * m), (0.0,) * (n * m), (0.0,) * (n * n)
    F, G = carry_back(
        gains.reshape(-1),
        index,
        table.Phi.reshape(-1),
        table.Gamma.reshape(-1),
        count,
        index.shape[1] > 1,
        *shape,
    )
    return F.reshape(whole, m, n)[:steps], G.reshape(whole, count, m, m)[:steps]
