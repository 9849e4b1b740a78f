"""The table of the expected law under a Markov forecast where delays differ: a first passage.

The sample u_k of input j is first read when the mode i of that instant reads so late, θ ≥ D_i,j
(`along_signal`): of the mass that is in mode i at θ = D_i,j, and of what enters it later, the law
takes K_i,j x and looks no further. With U the modes that do not read u_k,j yet,
X_i = E[x 1{σ = i}] and p_i the part of the expected state and of the probability in i ∈ U that is
left, and a = E[K_σ,j x] of what has been taken,

    dX_i/dθ = A_i X_i + Σ_{l∈U} Λ_li X_l + Σ_j' b_i,j' (p_i u_j' or V_i,j'),
    dp_i/dθ = Σ_{l∈U} Λ_li p_l,      da/dθ = Σ_{i∈U} Σ_{l∉U} Λ_il K_l,j X_i.

An input j' that is in flight is a number, u_j'. One that is still to be computed is the feedback
K_i,j' x of the instant at which mode i first reads it: V_i,j' is set to K_i,j' X_i there, and at a
switch into a mode that reads such an input where the one before did not; else it is held, and
moves with the mode as p does. That is exact for one input, and where an input's delay is the same
in all modes; else V forgets that a mode which reads later than the one before reads again what was
read already.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from deadtime.feedback import Feedback
from deadtime.laws.tables.readings import Reading, readings
from deadtime.numerics.covariance import transition
from deadtime.plant import SampledPlant


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
        if key not in kept:
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
            G[:, -1 - part.sample[i, j], target, j] += taps[i, j]
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
