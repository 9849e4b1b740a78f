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
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag

from deadtime.base.errors import ArgumentError
from deadtime.feedback import Factor, Feedback
from deadtime.numerics.covariance import transition
from deadtime.plant import SampledPlant, Window

_AGREEMENT = 1e-13
_PROBABILITY = 1e-9


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
        from deadtime.laws.tables.markov_passage import passage_table

        return passage_table(K, generator, sampled)
    ahead, h = sampled.ahead, sampled.step
    states = modes * n
    Z = np.zeros((states + modes * m, states + modes * m))
    Z[:states, :states], Z[:states, states:] = _expected_system(A, B, generator)
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


def _expected_system(
    A: np.ndarray, B: np.ndarray, generator: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """𝒜 and ℬ."""
    free = np.asarray(block_diag(*A)) + np.kron(generator.T, np.eye(A.shape[1]))
    return free, np.asarray(block_diag(*B))


def _require_precision(generator: np.ndarray, step: float) -> None:
    """Refuse rates so fast that probabilities do not sum to 1 any more."""
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
