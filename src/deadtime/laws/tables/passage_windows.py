"""The functional of the expected law under a Markov forecast: a first passage.

It is the limit of `markov_passage` as the period tends to 0. With d_1 < d_2 < … the distinct delays
of all modes and inputs, and U the modes that do not read what is sent to input j at t yet, i ∈ U
where D_i,j ≥ d_r, what is left of the expected state and of the probability obeys on
d_{r−1} < θ < d_r

    dX_i/dθ = (A_i + Σ_{k: D_i,k < d_r} b_i,k K_i,k) X_i + Σ_{l∈U} Λ_li X_l
              + Σ_{k: D_i,k ≥ d_r} b_i,k p_i u_k(t + θ − D_i,k),
    dp_i/dθ = Σ_{l∈U} Λ_li p_l,      da/dθ = Σ_{i∈U} Σ_{l∉U} Λ_il K_l,j X_i,

and at θ = D_i,j the law takes K_i,j X_i: u_j(t) is what a and these add up to. An input that is
sent at t or later is the feedback of the mode that reads it, at once. So every stage is one system,
of (X, a), fed by inputs whose weight moves on with the probabilities:

    e^{S (d_r − θ)} b_i,k p_i(θ) = (q_cᵀ ⊗ I) e^{S' (d_r − θ)} (e_i ⊗ b_i,k),
    S' = I ⊗ S − Λ_UU ⊗ I,

q_c the probabilities at d_r from mode c: a window on input k, from D_i,k − d_r to D_i,k − d_{r−1},
for every target j, stage r and delay of an i ∈ U. The windows are the same for all modes, and what
c changes is by how much they count. Where an input's delay is the same in all modes nothing is
taken on the way, and there is no a.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from deadtime.feedback import Functional
from deadtime.laws.tables.windows import functional_of
from deadtime.numerics.covariance import transition
from deadtime.plant import SwitchedSystem
from deadtime.switching import SwitchingSignal

_CLOSED_FORM = 1e-11  # of its gains: the most digits that the closed form may lose


class _WindowStage(NamedTuple):
    """What is left between two delays.

    end, length : d_r and d_r − d_{r−1}, seconds
    left : (modes,), U;  flow : (modes, modes), Λ_UUᵀ
    before, after : (modes, modes), p at its start and end by the mode c at t, a column each
    """

    end: float
    length: float
    left: Bool[np.ndarray, " mode"]
    flow: Float[np.ndarray, "mode mode"]
    before: Float[np.ndarray, "mode mode"]
    after: Float[np.ndarray, "mode mode"]


def passage_functional(
    plant: SwitchedSystem,
    K: Float[np.ndarray, "mode m n"],
    generator: Float[np.ndarray, "mode mode"],
    signal: SwitchingSignal,
) -> Functional | None:
    """The law in continuous time; None where its closed form loses more digits than it may."""
    modes, m, n = K.shape
    F, windows = np.empty((modes, m, n)), []
    taken = 0 if (plant.delays == plant.delays[0]).all() else 1  # whether there is an a
    for j in range(m):
        # Of (X, a), from the end of a stage to u_j.
        row = np.append(np.zeros(modes * n), np.ones(taken))
        for stage in reversed(_stages(plant.delays, j, generator)):
            for i in np.flatnonzero(plant.delays[:, j] == stage.end):
                row[i * n : (i + 1) * n] = K[i, j]
            S = _system(plant, K, generator, stage, j, row.size)
            whole = np.kron(np.eye(modes), S) - np.kron(stage.flow.T, np.eye(row.size))
            before = row @ transition(S, stage.length)
            C = np.zeros((modes, m, modes * row.size))
            C[:, j] = [np.kron(p, row) for p in stage.after.T]
            direct = np.stack([np.kron(p, before) for p in stage.before.T])
            with np.errstate(over="ignore", invalid="ignore"):
                lost = np.abs(C[:, j] @ transition(whole, stage.length) - direct)
            fed = _places(stage.left, n, row.size)
            if not lost[:, fed].max() <= _CLOSED_FORM * np.abs(direct[:, fed]).max():
                return None
            windows += _windows(plant, stage, C, whole)
            row = before
        F[:, j] = row[: modes * n].reshape(modes, n)
    return functional_of(F, windows, signal)


def _stages(delays: np.ndarray, j: int, generator: np.ndarray) -> list[_WindowStage]:
    """The stages until what is sent to input j has been read in all modes."""
    ends = np.unique(delays[delays <= delays[:, j].max()]).tolist()
    stages, p, begin = [], np.eye(len(delays)), 0.0
    for end in ends:
        left = delays[:, j] >= end
        flow = np.where(left[:, None] & left, generator.T, 0.0)
        after = transition(flow, end - begin) @ p
        stages.append(_WindowStage(end, end - begin, left, flow, p, after))
        p, begin = np.where((delays[:, j] == end)[:, None], 0.0, after), end
    return stages


def _system(
    plant: SwitchedSystem,
    K: np.ndarray,
    generator: np.ndarray,
    stage: _WindowStage,
    j: int,
    size: int,
) -> Float[np.ndarray, "q q"]:
    """The matrix that (X, a) obeys in a stage."""
    modes, _, n = K.shape
    S, states = np.zeros((size, size)), modes * n
    S[:states, :states] = np.kron(stage.flow, np.eye(n))
    for i in np.flatnonzero(stage.left):
        own, closed = slice(i * n, (i + 1) * n), plant.delays[i] < stage.end
        S[own, own] += plant.A[i] + plant.B[i][:, closed] @ K[i, closed]
        if size > states:
            S[-1, own] = generator[i, ~stage.left] @ K[~stage.left, j]
    return S


def _places(left: np.ndarray, n: int, size: int) -> Int[np.ndarray, " place"]:
    """Where e_i ⊗ (X, a) has the X_i, for the modes that are left."""
    modes = np.flatnonzero(left)[:, None]
    return (modes * (size + n) + np.arange(n)).ravel()


def _windows(
    plant: SwitchedSystem, stage: _WindowStage, C: np.ndarray, whole: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, float, float]]:
    """C, S', R, α and β of what is in flight in a stage, for every delay with which it is read."""
    modes, n, m = plant.B.shape
    windows = []
    for delay in np.unique(plant.delays[stage.left]):
        if delay < stage.end:
            continue
        R, size = np.zeros((len(whole), m)), len(whole) // modes
        for i in np.flatnonzero(stage.left):
            own = np.eye(modes)[i] > 0.0
            R[_places(own, n, size)] = np.where(plant.delays[i] == delay, plant.B[i], 0.0)
        near = float(delay - stage.end)
        windows.append((C, whole, R, near, near + stage.length))
    return windows
