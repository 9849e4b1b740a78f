"""The table of the expected law under any model at samples: a chain of mode and age, exactly.

Switches are seen at samples, so a mode lasts whole periods and (mode, age) is a Markov chain:
from (i, a) the next sample finds (i, a + 1) with probability 1 − haz_i(a), or (j, 0) with
haz_i(a) T_ij, where haz_i(a) = P(S_i ≤ (a + 1) h | S_i > a h). Let R_p(i, a) be the expected
functional K_σ(t_k+D) x(t_k + D) of the state at t_{k+p}, and ⟨R⟩(i, a) its mean one sample later,

    ⟨R⟩(i, a) = (1 − haz_i(a)) R(i, a + 1) + haz_i(a) Σ_j T_ij R(j, 0).

The model is in mode i all through period p, so, with φ = h,

    R_N(i, a) = K_i,    R_p = ⟨R_{p+1}⟩ Φ_i(h),
    weight of u_{k+p−N} seen from t_{k+p}: ⟨R_{p+1}⟩ Γ_i(h),

and p times ⟨·⟩ brings that weight back to t_k. With φ < h the last period is a part, R_{N−1} =
K_i Φ_i(φ), and each earlier one has two inputs: u_{k+p−N} for φ and then u_{k+p−N+1} for h − φ.

Averaging a weight back costs (modes)(ages + N) m² products a period, the table (N²/2) of these;
where age says nothing there is one age, which lasts, in place of ages + N.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from deadtime.feedback import Feedback
from deadtime.numerics.exponential import discretise_modes, multiply
from deadtime.numerics.kernels import kernel
from deadtime.plant import SampledPlant
from deadtime.switching.models.model import SampledChain


@kernel(eager=True, fastmath={"contract"})
def _one_sample_back(R, hazard, transition, ages, fresh):
    """R ← ⟨R⟩ in place for the ages below `ages`; R (modes, entries, ages), `fresh` is scratch.

    The oldest age of all lasts.
    """
    modes, entries, total = R.shape
    for i in range(modes):
        for e in range(entries):
            fresh[i, e] = 0.0
            for j in range(modes):
                fresh[i, e] += transition[i, j] * R[j, e, 0]
    for i in range(modes):
        for e in range(entries):
            row, new = R[i, e], fresh[i, e]
            for a in range(min(ages, total - 1)):
                row[a] = row[a + 1] + hazard[i, a] * (new - row[a + 1])
            if ages >= total:
                row[total - 1] += hazard[i, total - 1] * (new - row[total - 1])


@kernel(eager=True)
def _apply(R, M, ages, result):
    """result(i, a) = R(i, a) M_i, the matrices of R and result flattened into entries."""
    modes, inner, columns = M.shape
    rows = R.shape[1] // inner
    for i in range(modes):
        for r in range(rows):
            for c in range(columns):
                entry = result[i, r * columns + c]
                entry[:ages] = 0.0
                for k in range(inner):
                    factor, source = M[i, k, c], R[i, r * inner + k]
                    for a in range(ages):
                        entry[a] += factor * source[a]


@kernel(eager=True)
def _constant(matrices, ages):
    """The functional that is matrices[i] at every age, as (modes, entries, ages)."""
    modes, rows, columns = matrices.shape
    result = np.empty((modes, rows * columns, ages))
    for i in range(modes):
        for r in range(rows):
            for c in range(columns):
                result[i, r * columns + c] = matrices[i, r, c]
    return result


@kernel(eager=True)
def chain_rows(A, B, K, hazard, transition, ages, step, phase, count):
    """F (modes, m·n, ages) and G (modes, N, m·m, ages); `hazard` (modes, ages + N or 1)."""
    modes, m, n = K.shape
    total = hazard.shape[1]
    partial = phase < step
    Phi, Gamma = discretise_modes(A, B, step)
    Phi_first, Gamma_first = discretise_modes(A, B, phase)
    Phi_rest, Gamma_rest = discretise_modes(A, B, step - phase)
    through = np.empty_like(Gamma)
    for i in range(modes):
        through[i] = multiply(Phi_rest[i], Gamma_first[i])
    G = np.zeros((modes, count, m * m, ages))
    R, moved = _constant(K, total), np.empty((modes, m * n, total))
    fresh, fresh_weight = np.empty((modes, m * n)), np.empty((modes, m * m))
    early, late = np.zeros((modes, m * m, total)), np.zeros((modes, m * m, total))
    for p in range(count - 1, -1, -1):
        reach = min(ages + p, total)
        last = partial and p == count - 1
        if not last:
            _one_sample_back(R, hazard, transition, reach, fresh)
            # u_{k+p−N+1} in the rest of period p joins the same input's part in period p + 1.
            if partial:
                _apply(R, Gamma_rest, reach, late)
                _one_sample_back(early, hazard, transition, reach, fresh_weight)
                for i in range(modes):
                    late[i, :, :reach] += early[i, :, :reach]
                for back in range(p, 0, -1):
                    _one_sample_back(late, hazard, transition, ages + back - 1, fresh_weight)
                G[:, count - p - 2] = late[:, :, :ages]
        _apply(R, Gamma_first if last else through if partial else Gamma, reach, early)
        if not partial or p == 0:
            for back in range(p, 0, -1):
                _one_sample_back(early, hazard, transition, ages + back - 1, fresh_weight)
            G[:, count - p - 1] = early[:, :, :ages]
        _apply(R, Phi_first if last else Phi, reach, moved)
        R, moved = moved, R
    return R[:, :, :ages], G


def chain_table(
    K: Float[np.ndarray, "mode m n"], chain: SampledChain, ages: int | None, sampled: SampledPlant
) -> Feedback:
    """The table by mode and age, or by mode alone; `chain` reaches N ages past it, or has one."""
    count, (modes, m, n) = ages or 1, K.shape
    if not sampled.plant.has_one_delay:
        from deadtime.laws.tables.sampled_chain_passage import chain_passage

        F, G = chain_passage(K, chain, count, sampled)
    else:
        A, B, window = sampled.plant.A, sampled.plant.B, sampled.window
        hazard, jump = chain.hazard, chain.jump
        F, G = chain_rows(A, B, K, hazard, jump, count, window.step, window.phase, window.count)
        F, G = F.transpose(0, 2, 1), np.ascontiguousarray(G.transpose(0, 3, 1, 2))
    F, G = F.reshape(modes * count, m, n), G.reshape(modes * count, -1, m, m)
    context = "mode" if ages is None else "mode_age"
    return Feedback(np.ascontiguousarray(F), G, context, sampled.step, count)
