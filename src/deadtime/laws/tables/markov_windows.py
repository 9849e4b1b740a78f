"""The functional of the expected law under a Markov forecast, with a delay per input.

Where the delay D_k of an input is the same in all modes, what is in flight and what is under the
law's own feedback depends on the time ahead θ alone. With d_1 < d_2 < … the distinct delays and
d_0 = 0, the moments X_i(θ) = E[x(t + θ) 1{σ(t + θ) = i}], stacked, and the probabilities p obey

    dX/dθ = 𝒮_r X + Σ_{k: D_k ≥ d_r} ℬ_k p(θ) u_k(t + θ − D_k),    d_{r−1} < θ < d_r,
    𝒮_r = blkdiag(A_i + Σ_{D_k < d_r} b_i,k K_i,k) + Λᵀ ⊗ I,    ℬ_k = blkdiag(b_i,k),
    dp/dθ = Λᵀ p,    u_j(t) = [K_0,j … K_l,j] X(D_j),

from X(0) = e_c ⊗ x(t) and p(0) = e_c, c the mode at t. So the stages are those of one system
(`windows`), fed by inputs whose weight moves on with the probabilities: at τ − α = d_r − θ

    e^{𝒮_r (d_r − θ)} ℬ_k p(θ) = (q_cᵀ ⊗ I) e^{𝒮'_r (d_r − θ)} stack_s(ℬ_k e_s),
    q_c = e^{d_r Λᵀ} e_c,    𝒮'_r = I ⊗ 𝒮_r − Λ ⊗ I,

as with one delay (`markov`). The windows are the same for all modes, and what c changes is by how
much they count: C_c = q_cᵀ ⊗ Q, Q from the end of the stage to u.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag

from deadtime.feedback import Functional
from deadtime.laws.tables.windows import Stage, functional_of, stages
from deadtime.numerics.covariance import transition
from deadtime.plant import SwitchedSystem
from deadtime.switching import SwitchingSignal


def markov_functional(
    plant: SwitchedSystem,
    K: Float[np.ndarray, "mode m n"],
    generator: Float[np.ndarray, "mode mode"],
    signal: SwitchingSignal,
    tolerance: float,
) -> Functional | None:
    """The law in continuous time; None where its closed form loses more digits than tolerated.

    Every input of the plant must have the same delay in all modes.
    """
    modes, n, m = plant.B.shape
    size = modes * n

    def closed_loop(closed: np.ndarray) -> np.ndarray:
        own = plant.A + plant.B[:, :, closed] @ K[:, closed]
        return np.asarray(block_diag(*own)) + np.kron(generator.T, np.eye(n))

    forced = np.asarray(block_diag(*plant.B))
    row = K.transpose(1, 0, 2).reshape(m, size)
    at_once, ahead = stages(closed_loop, forced, row, plant.delays[0])
    inputs = forced.reshape(size, modes, m).transpose(1, 0, 2).reshape(modes * size, m)
    windows = []
    for stage in ahead:
        S = np.kron(np.eye(modes), stage.S) - np.kron(generator, np.eye(size))
        C = np.einsum("sc,ia->cisa", transition(generator.T, stage.end), stage.Q)
        C = C.reshape(modes, m, modes * size)
        if not _exact(C, S, stage, generator, tolerance):
            return None
        windows.append((C, S, np.where(stage.fed, inputs, 0.0), stage.near, stage.far))
    F = at_once.reshape(m, modes, n).transpose(1, 0, 2)
    return functional_of(np.ascontiguousarray(F), windows, signal)


def _exact(
    C: np.ndarray, S: np.ndarray, stage: Stage, generator: np.ndarray, tolerance: float
) -> bool:
    """Whether a window is Q e^{𝒮_r (d_r − d_{r−1})} (p(d_{r−1}) ⊗ I) at its far end.

    There 𝒮' has carried the probabilities back over the whole stage, where they may have decayed.
    """
    modes, length = generator.shape[0], stage.far - stage.near
    size = stage.S.shape[0]
    n = size // modes
    each = np.eye(size).reshape(size, modes, n).transpose(1, 0, 2).reshape(modes * size, n)
    spread = transition(generator.T, stage.end - length)
    over = stage.Q @ transition(stage.S, length)
    direct = np.stack([over @ np.kron(p[:, None], np.eye(n)) for p in spread.T])
    with np.errstate(over="ignore", invalid="ignore"):
        closed = C @ transition(S, length) @ each
        return bool(np.abs(closed - direct).max() <= tolerance * np.abs(direct).max())
