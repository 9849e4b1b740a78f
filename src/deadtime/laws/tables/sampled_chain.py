"""The table of the expected law under any model at samples: a chain of mode and age, exactly.

Switches take effect at samples, so a mode lasts whole periods and (mode, age) is a Markov chain:
from (i, a) the next sample finds (i, a + 1) with probability 1 − haz_i(a), or (j, 0) with
haz_i(a) T_ij, where haz_i(a) = P(S_i ≤ (a + 1) h | S_i > a h). Going backwards from t_{k+p+1} to
t_{k+p}, functionals of (mode, age) are

    R   of the expected state,
    w   of each input that is held and was computed after t_k in that future,
    g   of each input in flight, a weight,

all averaged over what the sample t_{k+p+1} finds,

    ⟨R⟩(i, a) = (1 − haz_i(a)) R(i, a + 1) + haz_i(a) Σ_j T_ij R(j, 0),

then carried through the stretches of period p in mode i: R Γ is added to the w or g of the input
that acts, and R becomes R Φ. Where an input to come is first read, R + w K and w = 0; where the
mode reads u_k itself, R = K and what comes later counts no more, as in `markov_passage`. With one
delay of N periods that is R_N = K_i and R_p = ⟨R_{p+1}⟩ Φ_i, and ⟨R_{p+1}⟩ Γ_i is the weight of
u_{k+p−N}, seen from t_{k+p}; p times ⟨·⟩ brings it back to t_k.

Averaging a weight back costs (modes)(ages + N) m² products a period, the table (N²/2) of these;
where age says nothing there is one age, which lasts, in place of ages + N. A weight to which no
mode adds any more is brought back at once: then it stays in the cache of a processor.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import read_only
from deadtime.feedback import Feedback
from deadtime.numerics.exponential import discretise_each
from deadtime.numerics.kernels import kernel
from deadtime.plant import SampledPlant
from deadtime.switching.models.model import SampledChain


@kernel(eager=True)
def _fresh(R, jump, fresh):
    """fresh(i) = Σ_j T_ij R(j, 0), entry by entry; R (modes, entries, ages)."""
    for i in range(fresh.shape[0]):
        for e in range(fresh.shape[1]):
            fresh[i, e] = 0.0
            for j in range(fresh.shape[0]):
                fresh[i, e] += jump[i, j] * R[j, e, 0]


@kernel(eager=True, fastmath={"contract"})
def _one_sample_back(R, hazard, fresh, ages):
    """R ← ⟨R⟩ in place for the ages below `ages`; the oldest age of all lasts."""
    modes, entries, total = R.shape
    for i in range(modes):
        for e in range(entries):
            row, new = R[i, e], fresh[i, e]
            for a in range(min(ages, total - 1)):
                row[a] = row[a + 1] + hazard[i, a] * (new - row[a + 1])
            if ages >= total:
                row[total - 1] += hazard[i, total - 1] * (new - row[total - 1])


@kernel(eager=True, fastmath={"contract"})
def _add(result, factor, row, ages):
    """result += factor · row, up to an age."""
    for a in range(ages):
        result[a] += factor * row[a]


@kernel(eager=True)
def _entered(R, w, jump, K, p, first, last, fresh_R, fresh_w):
    """Add the inputs that the mode entered at the end of period p is the first to read."""
    modes, m, n = K.shape
    for i in range(modes):
        for after in range(modes):
            for j in range(m):
                weight = jump[i, after] * w[after, j, 0]
                if weight != 0.0 and p < last[i, j] and p + 1 >= first[after, j]:
                    fresh_w[i, j] -= weight
                    for x in range(n):
                        fresh_R[i, x] += weight * K[after, j, x]


@kernel(eager=True)
def _through(R, w, g, i, K, Phi, Gamma, lag, arrives, p, target, ages, moved):
    """Back through a stretch of mode i in period p; g (slots, modes, m, ages) of the taps."""
    (m, n), slots = K.shape, g.shape[0]
    for j in range(m):
        s = p - lag[j]
        for x in range(n):
            _add(w[i, j] if s >= 0 else g[(-1 - s) % slots, i, j], Gamma[x, j], R[i, x], ages)
    for x in range(n):
        moved[x, :ages] = 0.0
        for y in range(n):
            _add(moved[x], Phi[y, x], R[i, y], ages)
    for x in range(n):
        for a in range(ages):
            R[i, x, a] = moved[x, a]
    for j in range(m):
        if arrives[j] and p >= lag[j]:
            for x in range(n):
                _add(R[i, x], K[j, x], w[i, j], ages)
            w[i, j] = 0.0
    if p >= lag[target]:
        w[i], g[:, i] = 0.0, 0.0
        for x in range(n):
            R[i, x] = K[target, x]


@kernel(eager=True)
def chain_rows(K, hazard, jump, ages, A, B, length, lag, arrives, begin):
    """F (modes, m, n, ages) and G (modes, N, m, m, ages); `hazard` (modes, ages + N or 1).

    Stretches of mode i are begin[i], …, begin[i + 1] − 1, A and B those of its mode; `arrives`
    (stretches, m) says whether a stretch is the first that reads its input.
    """
    Phi, Gamma = discretise_each(A, B, length)
    (modes, m, n), total = K.shape, hazard.shape[1]
    least, N = lag.min(), lag.max()
    slots = N - least + 1  # taps that are open at once, in a ring
    first, last = lag[begin[:-1]], lag[begin[1:] - 1]
    F, G = np.zeros((modes, m, n, ages)), np.zeros((modes, N, m, m, ages))
    fresh_R, fresh_w, moved = np.empty((modes, n)), np.empty((modes, m)), np.empty((n, total))
    for target in range(m):
        R, w = np.zeros((modes, n, total)), np.zeros((modes, m, total))
        g = np.zeros((slots, modes, m, total))
        for p in range(N, -1, -1):
            reach = min(ages + p, total)
            _fresh(R, jump, fresh_R)
            _fresh(w, jump, fresh_w)
            _entered(R, w, jump, K, p, first, last, fresh_R, fresh_w)
            _one_sample_back(R, hazard, fresh_R, reach)
            _one_sample_back(w, hazard, fresh_w, reach)
            for tap in range(max(least - 1 - p, 0), max(N - 1 - p, 0)):
                _fresh(g[tap % slots], jump, fresh_w)
                _one_sample_back(g[tap % slots], hazard, fresh_w, reach)
            for i in range(modes):
                for e in range(begin[i + 1] - 1, begin[i] - 1, -1):
                    piece = K[i], Phi[e], Gamma[e], lag[e], arrives[e]
                    _through(R, w, g, i, *piece, p, target, reach, moved)
            # No earlier period adds to this weight, nor does an earlier one read u_k.
            for tap in range(max(least - 1 - p, 0), N if p == 0 else max(least - p, 0)):
                weight = g[tap % slots]
                for back in range(p, 0, -1):
                    _fresh(weight, jump, fresh_w)
                    _one_sample_back(weight, hazard, fresh_w, min(ages + back - 1, total))
                G[:, tap, target] = weight[:, :, :ages]
                weight[:] = 0.0
        F[:, target] = R[:, :, :ages]
    return F, G


def chain_table(
    K: Float[np.ndarray, "mode m n"], chain: SampledChain, ages: int | None, sampled: SampledPlant
) -> Feedback:
    """The table by mode and age, or by mode alone; `chain` reaches N ages past it, or has one."""
    count, (modes, m, n) = ages or 1, K.shape
    begin, start, stop, lag = sampled.every_stretch
    of = np.repeat(np.arange(modes), np.diff(begin))
    parts = map(read_only, (sampled.plant.A[of], sampled.plant.B[of], stop - start))
    before = np.roll(lag, 1, axis=0)
    before[begin[:-1]] = lag[begin[1:] - 1] + 1  # of the period before, one sample older
    F, G = chain_rows(K, chain.hazard, chain.jump, count, *parts, lag, lag < before, begin)
    F = np.ascontiguousarray(F.transpose(0, 3, 1, 2)).reshape(modes * count, m, n)
    G = np.ascontiguousarray(G.transpose(0, 4, 1, 2, 3)).reshape(modes * count, -1, m, m)
    return Feedback(F, G, "mode" if ages is None else "mode_age", sampled.step, count)
