"""Ideal laws as windows on the past inputs: one mode for good, and a Markov forecast.

**The mode never changes.** The prediction along mode i starts from x(t). Input k, sent with a delay
D_k, is in flight up to t + D_k; from there on the mode is under its own feedback K_k x̂. With d_1 <
d_2 < … the distinct delays and d_0 = 0,

    dx̂/dθ = S_r x̂ + Σ_{D_k ≥ d_r} b_k u_k(t + θ − D_k),   d_{r−1} < θ < d_r,
    S_r = A + Σ_{D_k < d_r} b_k K_k,        u_j(t) = K_j x̂(t + D_j).

Solved stage by stage, with E_r = e^{S_r (d_r − d_{r−1})} and Q_{r,j} = K_j E_s … E_{r+1} where
D_j = d_s, that is

    u_j(t) = Q_{0,j} x(t)
             + Σ_{r ≤ s} Σ_{k: D_k ≥ d_r} ∫ Q_{r,j} e^{S_r (τ − D_k + d_r)} b_k u_k(t − τ) dτ,

τ from D_k − d_r to D_k − d_{r−1}: windows on the past. Modes are summed with their weights. For
one mode this is the predictor of Tsubakino, Oliveira and Krstic (Automatica
2016); for one delay a single window [0, D] of S = A.

**A Markov forecast** makes a first passage, the limit of `tables.markov.passage_table` as the
period tends to 0. With d_1 < d_2 < … the distinct delays of all modes and inputs, and U the modes
that do not read what is sent to input j at t yet, i ∈ U where D_i,j ≥ d_r, what is left of the
expected state and of the probability obeys on d_{r−1} < θ < d_r

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

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from deadtime.feedback import Functional
from deadtime.numerics.covariance import transition
from deadtime.plant import SwitchedSystem
from deadtime.switching import SwitchingSignal

_SAME = 1e-12  # of the longest delay: delays so close are one


def constant_functional(
    plant: SwitchedSystem, K: Float[np.ndarray, "mode m n"], weights: Float[np.ndarray, " mode"]
) -> Functional:
    """Σ_i w_i of the exact feedbacks of a plant's modes, each held throughout.

    Examples
    --------
    >>> plant = SwitchedSystem([[[0.0]]], [[[1.0, 1.0]]], delay=[0.2, 0.1])
    >>> law = constant_functional(plant, np.array([[[-1.0], [-2.0]]]), np.ones(1))
    >>> law.F[0].round(3).tolist(), law.near.tolist(), law.far.tolist()
    ([[-0.819], [-2.0]], [0.0, 0.0, 0.1], [0.1, 0.1, 0.2])
    """
    F, windows = np.zeros(K.shape[1:]), []
    for A, B, delays, own, weight in zip(plant.A, plant.B, plant.delays, K, weights, strict=True):
        # Defaults bind this mode's matrices: a closure would see those of the last mode.
        def closed_loop(closed: np.ndarray, A=A, B=B, own=own) -> np.ndarray:
            return A + B[:, closed] @ own[closed]

        at_once, ahead = stages(closed_loop, B, weight * own, delays)
        F += at_once
        windows += [(w.Q[None], w.S, np.where(w.fed, B, 0.0), w.near, w.far) for w in ahead]
    return functional_of(F[None], windows, _one_row)


def _one_row(times: np.ndarray) -> Int[np.ndarray, " time"]:
    """Row 0 at all times: a module's function, so that laws that keep their functional pickle."""
    return np.zeros(times.size, np.int64)


class Stage(NamedTuple):
    """The part of a prediction between two delays: a window on inputs that were sent.

    Q : (m, q), from the stage's end to u;  S : (q, q), its matrix;  fed : (m,), the inputs
    near, far : α, β, seconds;  end : d_r, when the stage ends, seconds ahead
    """

    Q: np.ndarray
    S: np.ndarray
    fed: np.ndarray
    near: float
    far: float
    end: float


def stages(
    closed_loop: Callable[[np.ndarray], np.ndarray],
    B: Float[np.ndarray, "q k"],
    K: Float[np.ndarray, "m q"],
    delays: Float[np.ndarray, " m"],
) -> tuple[Float[np.ndarray, "m q"], list[Stage]]:
    """Q_0 and the stages of u_j = K_j x̂(D_j); `closed_loop` gives S_r of the inputs with D_k < d_r.

    B, by which x̂ is fed, sets the units in which e^{Sτ} is computed.
    """
    from deadtime.numerics.exponential import discretise

    ends = np.unique(delays)
    ends = ends[np.append(True, np.diff(ends) > _SAME * ends[-1])]  # a stage needs a length
    stage = np.searchsorted(ends, delays * (1.0 + _SAME), "right") - 1
    starts = np.concatenate(([0.0], ends[:-1]))
    ahead, Q = [], np.zeros_like(K)
    for r in range(ends.size - 1, -1, -1):
        Q[stage == r] = K[stage == r]
        S = closed_loop(stage < r)
        for s in range(r, ends.size):
            near, far = float(ends[s] - ends[r]), float(ends[s] - starts[r])
            ahead.append(Stage(Q.copy(), S, stage == s, near, far, float(ends[r])))
        Q = Q @ discretise(S, B, ends[r] - starts[r])[0]
    return Q, ahead


def functional_of(
    F: Float[np.ndarray, "row m n"],
    windows: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray, float, float]],
    row: Callable[[np.ndarray], np.ndarray],
) -> Functional:
    """A `Functional` from its windows (C of all rows, S, R, α, β)."""
    C, S, R, near, far = (np.stack(part) for part in zip(*windows, strict=True))
    return Functional(F, np.ascontiguousarray(C.swapaxes(0, 1)), S, R, near, far, row)


_CLOSED_FORM = 1e-11  # of its gains: the most digits that the closed form may lose


class _WindowStage(NamedTuple):
    """The modes that remain between two delays, and how their probabilities move there.

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
    taken = 0 if plant.modes_share_delays else 1  # whether there is an a
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
