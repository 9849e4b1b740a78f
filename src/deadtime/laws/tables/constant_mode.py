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

from deadtime.base.checks import read_only
from deadtime.feedback import Factor, Feedback
from deadtime.laws.tables.along_signal import rows_along
from deadtime.numerics.exponential import discretise, discretise_into, discretise_modes, product
from deadtime.numerics.kernels import kernel
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.switching import SwitchingSignal


@kernel
def place(tap, lag, G):
    """Add what a stretch gives its inputs to their taps, G (N, m, m), the youngest first."""
    m = tap.shape[0]
    for j in range(m):
        for i in range(m):
            G[lag[j] - 1, i, j] += tap[i, j]


@kernel
def _rows(A, B, K, weights, ahead, longest, delay):
    """Σ_i w_i of the rows above: F (m, n), G (N, m, m), N = `longest`."""
    m, n = K.shape[1:]
    kinds, stretches = ahead.length.size, ahead.kind.size
    F, G = np.zeros((m, n)), np.zeros((longest, m, m))
    Phi, Gamma = np.empty((kinds, n, n)), np.empty((kinds, n, m))
    row, carried, tap = np.empty((m, n)), np.empty((m, n)), np.empty((m, m))
    for i in range(A.shape[0]):
        for kind in range(kinds):
            discretise_into(A[i], B[i], ahead.length[kind], Phi[kind], Gamma[kind])
        for a in range(m):
            for b in range(n):
                row[a, b] = weights[i] * K[i, a, b]
        product(row, discretise(A[i], B[i], delay)[0], carried)
        for a in range(m):
            for b in range(n):
                F[a, b] += carried[a, b]
        for p in range(stretches - 1, -1, -1):
            product(row, Gamma[ahead.kind[p]], tap)
            place(tap, ahead.lag[p], G)
            product(row, Phi[ahead.kind[p]], carried)
            row, carried = carried, row
    return F, G


def constant_table(
    plant: SwitchedSystem,
    K: Float[np.ndarray, "mode m n"],
    weights: Float[np.ndarray, " mode"],
    step: float,
) -> Feedback:
    """The one-row table Σ_i w_i K_i P_i over the modes of a plant.

    With one delay it has its factorisation (S block-diagonal over modes), else it is dense.
    """
    A, B, sampled = plant.A, plant.B, SampledPlant(plant, step)
    if not plant.has_one_delay:
        return _dense_table(sampled, K, weights)
    F, G = _rows(
        A, B, K, read_only(weights), sampled.ahead, sampled.longest_lag, sampled.window.delay
    )
    Phi, Gamma = discretise_modes(A, B, sampled.step)
    modes, n, m = B.shape
    H = (weights[:, None, None] * K).transpose(1, 0, 2).reshape(1, m, modes * n)
    S = np.zeros((modes * n, modes * n))
    for i in range(modes):
        S[i * n : (i + 1) * n, i * n : (i + 1) * n] = Phi[i]
    factor = Factor(H, S, Gamma.reshape(modes * n, m), G[None, -1])
    return Feedback(F[None], G[None], "none", sampled.step, factor=factor)


def _dense_table(sampled: SampledPlant, K: np.ndarray, weights: np.ndarray) -> Feedback:
    """The table without a factorisation, for any delays."""
    modes = range(len(K))
    rows = [rows_along(sampled, K, SwitchingSignal.constant(i), 1) for i in modes]
    F, G = (np.tensordot(weights, np.stack(parts), 1) for parts in zip(*rows, strict=True))
    return Feedback(F, G, "none", sampled.step)
