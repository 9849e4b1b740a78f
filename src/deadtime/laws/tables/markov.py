"""The table of the expected law under a Markov forecast: block exponentials, no time grid.

Let p(s) be the probabilities of the modes s seconds ahead and X_i(s) = E[x 1{σ = i}], the part
of the expected state that is in mode i. With the generator Λ (rows sum to 0) and a held input,

    dX_i/ds = A_i X_i + Σ_j Λ_ji X_j + B_i p_i u,    dp/ds = Λᵀ p,

so that X and p ⊗ u together obey a constant matrix,

    Z = [[𝒜, ℬ], [0, Λᵀ ⊗ I_m]],    𝒜 = blkdiag(A_i) + Λᵀ ⊗ I_n,    ℬ = blkdiag(B_i),

and E[K_σ(D) x(D)] = [K] X(D), [K] = [K_0 … K_l]. From mode c, X(0) = e_c ⊗ x and p(0) = e_c:

    F_c = [K] e^{D𝒜} (e_c ⊗ I_n),
    G_{c,j} = [K] E^{j−1} Γ̃(h) (e^{(D−jh)Λᵀ} e_c ⊗ I_m),  j < N,    E = e^{h𝒜},
    G_{c,N} = [K] E^{N−1} Γ̃(φ) (e_c ⊗ I_m),

Γ̃(τ) the top right block of e^{Zτ}: u_{k−j} begins to act D − jh ahead, when the mode is spread
over p = e^{(D−jh)Λᵀ} e_c. The probabilities move on while an input travels, so the factor
carries one copy of the expected state per mode. With M = e^{−hΛᵀ},

    G_{c,j} = Σ_s [K] E^{j−1} Γ̃_s (M^{j−1} q_c)_s,   q_c = e^{(D−h)Λᵀ} e_c
            = (q_cᵀ ⊗ [K]) (Mᵀ ⊗ E)^{j−1} stack_s Γ̃_s,

of order (l + 1)² n, and real whatever the eigenvalues of Λ. M grows where probabilities decay,
so the factor loses digits like e^{max|Re λ| D} and is given only while it reproduces the rows.

The ideal loop takes the same form in the limit h → 0: with the current mode c,

    u(t) = (q_cᵀ ⊗ [K]) (e^{𝒜'D} L x(t) + ∫_{t−D}^{t} e^{𝒜'(t−θ)} ℬ' u(θ) dθ),   q_c = e^{DΛᵀ} e_c,
    𝒜' = I ⊗ 𝒜 − Λ ⊗ I,    ℬ' = stack_s ℬ (e_s ⊗ I_m),    L = stack_s (e_s ⊗ I_n):

a frozen system of (l + 1)² n states that starts from L x(t) (`passage_windows`).

**Where delays differ by mode or input** time is cut into readings, stretches in which no mode reads
another sample. An expectation over futures follows all modes at once, so time is cut at every
arrival of an input in any mode. In a stretch the mode i reads sample[i, j] of input j, counted from
u_k: below 0 it is in flight, from 0 on it is still to be computed.

The table is then that of a first passage. The sample u_k of input j is first read when the mode i
of that instant reads so late, θ ≥ D_i,j (`along_signal`): of the mass that is in mode i at θ =
D_i,j, and of what enters it later, the law takes K_i,j x, its last step. With U the modes
that do not read u_k,j yet, X_i = E[x 1{σ = i}] and p_i the part of the expected state and of the
probability in i ∈ U that is left, and a = E[K_σ,j x] of what has been taken,

    dX_i/dθ = A_i X_i + Σ_{l∈U} Λ_li X_l + Σ_j' b_i,j' (p_i u_j' or V_i,j'),
    dp_i/dθ = Σ_{l∈U} Λ_li p_l,      da/dθ = Σ_{i∈U} Σ_{l∉U} Λ_il K_l,j X_i.

An input j' that is in flight is a number, u_j'. One that is still to be computed is the feedback
K_i,j' x of the instant at which mode i first reads it: V_i,j' is set to K_i,j' X_i there, and at a
switch into a mode that reads such an input where the one before did not; else it is held, and moves
with the mode as p does. That is exact for one input, and where an input's delay is the same in all
modes; else V forgets that a mode which reads later than the one before reads again what was read
already.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import block_diag

from deadtime.base.errors import ArgumentError
from deadtime.feedback import Factor, Feedback
from deadtime.numerics.covariance import transition
from deadtime.plant import SampledPlant, Window


class Reading(NamedTuple):
    """A stretch ahead.

    period : p, of [t_{k+p}, t_{k+p+1})
    length : seconds
    sample : (modes, m), what each mode reads
    arrives : (modes, m), whether it began to read that at the stretch's start
    """

    period: int
    length: float
    sample: Int[np.ndarray, "mode m"]
    arrives: Bool[np.ndarray, "mode m"]

    @property
    def to_come(self) -> Bool[np.ndarray, "mode m"]:
        """Whether the input that a mode reads is not yet computed at t_k."""
        return self.sample >= 0


def readings(sampled: SampledPlant) -> list[Reading]:
    """The stretches from t_k on, until every mode reads inputs computed at t_k or later."""
    return list(_readings(sampled))


def _readings(sampled: SampledPlant) -> Iterator[Reading]:
    every, modes = sampled.every_stretch, range(sampled.plant.modes)
    ends = np.unique(every.stop)
    starts = np.append(0.0, ends[:-1])
    stops = np.split(every.stop, every.first[1:-1])  # the ends of each mode's own stretches
    place = np.stack([every.first[i] + np.searchsorted(stops[i], starts, "right") for i in modes])
    lag = every.lag[place].swapaxes(0, 1)  # (stretches of a period, modes, m)
    before = -1 - lag[-1]
    for p in range(sampled.longest_lag + 1):
        for start, end, own in zip(starts.tolist(), ends.tolist(), lag, strict=True):
            sample = p - own
            yield Reading(p, end - start, sample, sample > before)
            before = sample
            if (sample >= 0).all():
                return


def passage_table(
    K: Float[np.ndarray, "mode m n"],
    generator: Float[np.ndarray, "mode mode"],
    sampled: SampledPlant,
) -> Feedback:
    """One row per current mode."""
    modes, m, n = K.shape
    F, G = np.empty((modes, m, n)), np.zeros((modes, sampled.longest_lag, m, m))
    ahead = readings(sampled)
    for target in range(m):
        _fill_row(K, generator, sampled, ahead, target, F, G)
    return Feedback(F, G, "mode", sampled.step)


def _fill_row(K, generator, sampled, ahead, target, F, G):
    """The rows of one input, F[:, target] and G[:, :, target]."""
    modes, m, n = K.shape
    states, held = modes * n, modes * m
    kept: dict[tuple[float, bytes], np.ndarray] = {}
    maps, spread = [], [np.eye(modes)]
    for part in ahead:
        key = part.length, part.to_come.tobytes()
        if key not in kept:  # few lengths and few sets of readers occur, in many stretches
            kept[key] = transition(_motion(K, generator, sampled, part, target), part.length)
        maps.append(kept[key])
        spread[-1][part.to_come[:, target]] = 0.0
        spread.append(kept[key][-modes:, -modes:] @ spread[-1])
    row = np.zeros(states + held + 1)
    row[-1] = 1.0
    X, V = row[:states].reshape(modes, n), row[states:-1].reshape(modes, m)
    for part, over, at in zip(ahead[::-1], maps[::-1], spread[-2::-1], strict=True):
        size = row.size
        taps = (row @ over[:size, size:]).reshape(modes, m, modes) @ at
        row[:] = row @ over[:size, :size]
        for i, j in np.argwhere(~part.to_come):
            G[:, -1 - part.sample[i, j], target, j] += taps[i, j]  # sample −1 is u_{k−1}, tap 0
        for i, j in np.argwhere(part.arrives & part.to_come):
            X[i] += V[i, j] * K[i, j]
            V[i, j] = 0.0
        for i in np.flatnonzero(part.arrives[:, target] & (part.sample[:, target] == 0)):
            X[i], V[i] = K[i, target], 0.0
    F[:, target] = X


def _motion(K, generator, sampled: SampledPlant, part: Reading, target: int) -> np.ndarray:
    """The constant matrix that (X, V, a, p once for each mode and input that reads it) obeys."""
    A, B = sampled.plant.A, sampled.plant.B
    modes, m, n = K.shape
    # Rows and columns:  | X, modes·n | V, modes·m | a | p, modes·m·modes |
    states, held = modes * n, modes * m
    to_come, left = part.to_come, ~part.to_come[:, target]
    flow = np.where(left[:, None] & left, generator.T, 0.0)  # into a mode, from another
    first = states + held + 1
    Z = np.zeros((first + modes * m * modes,) * 2)
    Z[:states, :states] = np.kron(flow, np.eye(n))
    Z[first:, first:] = np.kron(np.eye(modes * m), flow)
    for i in np.flatnonzero(left):
        own = slice(i * n, (i + 1) * n)
        Z[own, own] += A[i]
        Z[first - 1, own] = generator[i, ~left] @ K[~left, target]
        for j in range(m):
            place = states + i * m + j
            if not to_come[i, j]:
                Z[own, first + (i * m + j) * modes + i] = B[i, :, j]
                continue
            Z[own, place] = B[i, :, j]
            for other in np.flatnonzero(left):
                if to_come[other, j]:
                    Z[place, states + other * m + j] = flow[i, other]
                else:
                    Z[place, other * n : (other + 1) * n] = flow[i, other] * K[i, j]
    return Z


_AGREEMENT = 1e-13  # relative to the largest tap: the error that a factor may have
_PROBABILITY = 1e-9  # by which probabilities may miss the sum 1


def markov_table(
    A: Float[np.ndarray, "mode n n"],
    B: Float[np.ndarray, "mode n m"],
    K: Float[np.ndarray, "mode m n"],
    generator: Float[np.ndarray, "mode mode"],
    sampled: SampledPlant,
) -> Feedback:
    """One row per current mode."""
    modes, n, m = B.shape
    _require_precision(generator, sampled.step)
    if not sampled.plant.has_one_delay:
        return passage_table(K, generator, sampled)
    ahead, h = sampled.ahead, sampled.step
    states = modes * n
    Z = np.zeros((states + modes * m, states + modes * m))
    Z[:states, :states] = np.kron(generator.T, np.eye(n)) + np.asarray(block_diag(*A))  # 𝒜
    Z[:states, states:] = block_diag(*B)  # ℬ
    Z[states:, states:] = np.kron(generator.T, np.eye(m))
    whole = [transition(Z, length) for length in ahead.length.tolist()]
    moved = [transition(generator.T, length) for length in ahead.length.tolist()]
    spread = [np.eye(modes)]  # the modes' probabilities at the start of every stretch
    for kind in ahead.kind[:-1]:
        spread.append(moved[kind] @ spread[-1])

    G = np.zeros((modes, sampled.longest_lag, m, m))
    row, inputs = K.transpose(1, 0, 2).reshape(m, states), np.arange(m)
    for p in range(ahead.kind.size - 1, -1, -1):
        over = whole[ahead.kind[p]]
        taps = (row @ over[:states, states:]).reshape(m, modes, m)
        tap = np.einsum("asb,sc->cab", taps, spread[p])
        G[:, ahead.lag[p] - 1, :, inputs] += tap.transpose(2, 0, 1)
        row = row @ over[:states, :states]
    F = row.reshape(m, modes, n).transpose(1, 0, 2)

    E = transition(Z, h)
    factor = _factor(K, generator, E[:states, :states], E[:states, states:], G, sampled.window)
    return Feedback(np.ascontiguousarray(F), G, "mode", h, factor=factor)


def _require_precision(generator: np.ndarray, step: float) -> None:
    """Refuse rates so fast that probabilities no longer sum to 1."""
    with np.errstate(over="ignore", invalid="ignore"):
        lost = np.abs(transition(generator.T, step).sum(axis=0) - 1.0).max()
    if not lost <= _PROBABILITY:
        raise ArgumentError(
            f"model has rates up to {generator.max():.2g} 1/s, which double precision cannot tell "
            f"apart from infinite ones over a step of {step:g} s: use MeanPredictor, the limit of "
            "fast switching, or slower rates."
        )


def _factor(
    K: np.ndarray,
    generator: np.ndarray,
    E: np.ndarray,
    forced: np.ndarray,
    G: np.ndarray,
    window: Window,
) -> Factor | None:
    """The factor, or None where it loses digits."""
    modes, m, n = K.shape
    ahead = transition(generator.T, window.delay - window.step) if window.count > 1 else np.eye(1)
    S = np.kron(transition(-generator, window.step), E)
    blocks = forced.reshape(modes * n, modes, m).transpose(1, 0, 2).reshape(modes * modes * n, m)
    if not (np.isfinite(S).all() and window.count > 1):
        return None
    H = np.einsum("sc,iab->casib", ahead, K).reshape(modes, m, modes * modes * n)
    factor = Factor(H, S, np.ascontiguousarray(blocks), G[:, -1])
    with np.errstate(over="ignore", invalid="ignore"):
        error = np.abs(factor.taps(window.count) - G).max()
    return factor if error <= _AGREEMENT * np.abs(G).max() else None
