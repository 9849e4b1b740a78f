"""The table of a law which forecasts that the mode never changes.

The forecast that mode i is held gives, with the input held over each period, the exact functional

    K P = K e^{AD} x_k + Σ_{j<N} K Φ(h)^{j−1} Γ(h) u_{k−j} + K Φ(h)^{N−1} Γ(φ) u_{k−N}:

u_{k−j} has left a whole period h of the delay line for j < N, but of u_{k−N} only the last φ
still lies ahead. The averaged, single-mode and mean laws are weighted sums of such rows.
Where inputs or modes have delays of their own each row is that of `along_signal`, along the signal
that stays in i.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from deadtime.feedback import Factor, Feedback
from deadtime.laws.tables.along_signal import rows_along
from deadtime.numerics.exponential import discretise_modes
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.switching import SwitchingSignal


def constant_table(
    plant: SwitchedSystem,
    K: Float[np.ndarray, "mode m n"],
    weights: Float[np.ndarray, " mode"],
    step: float,
) -> Feedback:
    """The one-row table Σ_i w_i K_i P_i over the modes of a plant.

    With one delay it has its factorisation (S block-diagonal over modes), else it is dense.
    """
    sampled = SampledPlant(plant, step)
    if not plant.has_one_delay:
        return _dense_table(sampled, K, weights)
    window, (modes, n, m) = sampled.window, plant.B.shape
    spans = window.step, window.phase, window.delay
    (Phi, Gamma), (_, late), (whole, _) = (discretise_modes(plant.A, plant.B, t) for t in spans)
    row = weights[:, None, None] * K
    with np.errstate(all="ignore"):  # a table refuses what overflows
        F = (row @ whole).sum(axis=0)
        last = (row @ np.linalg.matrix_power(Phi, window.count - 1) @ late).sum(axis=0)
        H = row.transpose(1, 0, 2).reshape(1, m, modes * n)
        S, of = np.zeros((modes, n, modes, n)), np.arange(modes)
        S[of, :, of] = Phi
        size = modes * n
        factor = Factor(H, S.reshape(size, size), Gamma.reshape(size, m), last[None])
        return Feedback(F[None], factor.taps(window.count), "none", window.step, factor=factor)


def _dense_table(sampled: SampledPlant, K: np.ndarray, weights: np.ndarray) -> Feedback:
    """The table without a factorisation, for any delays."""
    modes = range(len(K))
    rows = [rows_along(sampled, K, SwitchingSignal.constant(i), 1) for i in modes]
    F, G = (np.tensordot(weights, np.stack(parts), 1) for parts in zip(*rows, strict=True))
    return Feedback(F, G, "none", sampled.step)
