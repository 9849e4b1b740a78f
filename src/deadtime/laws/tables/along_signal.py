"""Rows of laws along a signal that is known, the constant one of a single mode among them.

The sample u_k of input j is first read at

    θ_j = min {θ ≥ 0: θ ≥ D_i,j,  i = σ(t_k + θ)},    and   u_k,j = K_i,j x(t_k + θ_j)

is the exact feedback, K_i,j row j of K_i. On the way there the model is under inputs that are in
flight, and, from where one of them is read for the first time that is computed at t_k or later,
under that one: the same feedback, of x as it is predicted then, and held for as long as it is read.
All of it is linear in x(t_k) and the inputs in flight. Each functional K_i,j x(t_k + θ_j) is
carried backwards over the pieces of the signal: a piece adds R Γ to the weight of the input that
acts in it, and R becomes R Φ; where an input to come is first read, its weight w becomes part of
the state's, R + w K.

For one mode and a delay per input that is the predictor of Tsubakino, Oliveira and Krstic
(Automatica 2016) for held inputs.

**One mode for good.** The forecast that mode i is held gives, with the input held over each period,
the exact functional

    K P = K e^{AD} x_k + Σ_{j<N} K Φ(h)^{j−1} Γ(h) u_{k−j} + K Φ(h)^{N−1} Γ(φ) u_{k−N}:

u_{k−j} has left a whole period h of the delay line for j < N, but of u_{k−N} only the last φ still
lies ahead. The averaged, single-mode and mean laws are weighted sums of such rows. Where inputs or
modes have delays of their own each row is that of `along_signal`, along the signal that stays in i.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from deadtime.feedback import Factor, Feedback
from deadtime.numerics.exponential import discretise_modes
from deadtime.numerics.kernels import kernel
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.switching import SwitchingSignal
from deadtime.switching.grid import cuts_of


@kernel
def _first_reads(table, sample, k, before, read):
    """Where sample k of each input is first read: `read` (m,), in pieces.

    before (pieces, m) are the newest samples that had been read at the start of each piece from the
    first of period k on, counted from k, −1 for none of them.
    """
    m = read.size
    for j in range(m):
        read[j], before[0, j] = -1, -1
    missing, q, p = m, table.first[k], 0
    while missing:
        for j in range(m):
            newest = max(before[p, j], sample[q, j] - k)
            before[p + 1, j] = newest
            if newest >= 0 and read[j] < 0:
                read[j] = q
                missing -= 1
        q, p = q + 1, p + 1


@kernel
def _fill_rows(table, sample, K, F, G):
    """F (steps, m, n) and G (steps, N, m, m) of the samples from 0 on; G is to be zero before."""
    steps, longest, m, _ = G.shape
    n, most = K.shape[2], 1
    for k in range(steps):
        most = max(most, table.first[k + longest + 1] - table.first[k])
    before, read = np.empty((most + 1, m), np.int64), np.empty(m, np.int64)
    later, moved = np.zeros((m, longest + 1)), np.empty(n)
    for k in range(steps):
        _first_reads(table, sample, k, before, read)
        for target in range(m):
            R = F[k, target]
            for i in range(n):
                R[i] = K[table.mode[table.entry[read[target]]], target, i]
            for q in range(read[target] - 1, table.first[k] - 1, -1):
                e, p = table.entry[q], q - table.first[k]
                for j in range(m):
                    weight = 0.0
                    for i in range(n):
                        weight += R[i] * table.Gamma[e, i, j]
                    if sample[q, j] < k:
                        G[k, k - sample[q, j] - 1, target, j] += weight
                    else:
                        later[j, sample[q, j] - k] += weight
                for i in range(n):
                    moved[i] = 0.0
                    for o in range(n):
                        moved[i] += R[o] * table.Phi[e, o, i]
                for i in range(n):
                    R[i] = moved[i]
                for j in range(m):
                    for s in range(before[p, j] + 1, sample[q, j] - k + 1):
                        for i in range(n):
                            R[i] += later[j, s] * K[table.mode[e], j, i]
                        later[j, s] = 0.0  # read from here on: no earlier piece has this input


def rows_along(
    sampled: SampledPlant, gains: Float[np.ndarray, "mode m n"], signal: SwitchingSignal, steps: int
) -> tuple[Float[np.ndarray, "step m n"], Float[np.ndarray, "step N m m"]]:
    """F and G of the samples 0, …, steps − 1 along a signal.

    Examples
    --------
    >>> from deadtime.plant import SwitchedSystem
    >>> plant = SwitchedSystem([[[0.0]]], [[[1.0, 1.0]]], delay=[0.2, 0.1])
    >>> K = np.array([[[-1.0], [-2.0]]])
    >>> F, G = rows_along(SampledPlant(plant, 0.1), K, SwitchingSignal.constant(0), 1)
    >>> F.round(3).tolist(), G.round(3).tolist()
    ([[[-0.8], [-2.0]]], [[[[-0.1, -0.08], [0.0, -0.2]], [[-0.08, 0.0], [-0.2, 0.0]]]])
    """
    m, n = gains.shape[1:]
    table = sampled.along(cuts_of(signal, sampled), steps + sampled.longest_lag + 1)
    F, G = np.empty((steps, m, n)), np.zeros((steps, sampled.longest_lag, m, m))
    with np.errstate(all="ignore"):  # a table refuses what overflows
        _fill_rows(table, table.sample, gains, F, G)
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
    sampled = SampledPlant(plant, step)
    if not plant.has_one_delay:
        rows = [rows_along(sampled, K, SwitchingSignal.constant(i), 1) for i in range(len(K))]
        F, G = (np.tensordot(weights, np.stack(parts), 1) for parts in zip(*rows, strict=True))
        return Feedback(F, G, "none", sampled.step)
    window, (modes, n, m) = sampled.window, plant.B.shape
    spans = window.step, window.phase, window.delay
    (Phi, Gamma), (_, late), (whole, _) = (discretise_modes(plant.A, plant.B, t) for t in spans)
    row = weights[:, None, None] * K
    with np.errstate(all="ignore"):  # a table refuses what overflows
        F = (row @ whole).sum(axis=0)
        last = (row @ np.linalg.matrix_power(Phi, window.count - 1) @ late).sum(axis=0)
        H = row.transpose(1, 0, 2).reshape(1, m, modes * n)
        S, of = np.zeros((modes, n, modes, n)), np.arange(modes)
        S[of, :, of] = Phi  # blkdiag(Φ_i), as S is (mode, n, mode, n)
        size = modes * n
        factor = Factor(H, S.reshape(size, size), Gamma.reshape(size, m), last[None])
        return Feedback(F[None], factor.taps(window.count), "none", window.step, factor=factor)
