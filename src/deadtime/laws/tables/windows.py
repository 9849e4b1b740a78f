"""The functional of a law which forecasts that the mode never changes, of several delays.

The prediction along mode i starts from x(t). Input k, sent with a delay D_k, is in flight up to
t + D_k; from there on the mode is under its own feedback K_k x̂. With d_1 < d_2 < … the distinct
delays and d_0 = 0,

    dx̂/dθ = S_r x̂ + Σ_{D_k ≥ d_r} b_k u_k(t + θ − D_k),   d_{r−1} < θ < d_r,
    S_r = A + Σ_{D_k < d_r} b_k K_k,        u_j(t) = K_j x̂(t + D_j).

Solved stage by stage, with E_r = e^{S_r (d_r − d_{r−1})} and Q_{r,j} = K_j E_s … E_{r+1} where
D_j = d_s, that is

    u_j(t) = Q_{0,j} x(t)
             + Σ_{r ≤ s} Σ_{k: D_k ≥ d_r} ∫ Q_{r,j} e^{S_r (τ − D_k + d_r)} b_k u_k(t − τ) dτ,

τ from D_k − d_r to D_k − d_{r−1}: windows on the past. Modes are summed with their weights. For
one mode this is the predictor of Tsubakino, Oliveira and Krstic (Automatica
2016); for one delay a single window [0, D] of S = A.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.feedback import Functional
from deadtime.plant import SwitchedSystem

_SAME = 1e-12  # of the longest delay: delays so close are one


def constant_functional(
    plant: SwitchedSystem,
    K: Float[np.ndarray, "mode m n"],
    weights: Float[np.ndarray, " mode"],
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

        def closed_loop(closed: np.ndarray, A=A, B=B, own=own) -> np.ndarray:
            return A + B[:, closed] @ own[closed]

        at_once, ahead = stages(closed_loop, B, weight * own, delays)
        F += at_once
        windows += [(w.Q[None], w.S, np.where(w.fed, B, 0.0), w.near, w.far) for w in ahead]
    return functional_of(F[None], windows, _one_row)


def _one_row(times: np.ndarray) -> np.ndarray:
    return np.zeros(times.size, np.int64)


class Stage(NamedTuple):
    """What a prediction takes of some inputs between two delays: a window on what was sent.

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
    ends = ends[np.append(True, np.diff(ends) > _SAME * ends[-1])]
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
