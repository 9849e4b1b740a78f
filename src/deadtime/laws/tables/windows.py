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
    >>> law.F.round(3).tolist(), law.near.tolist(), law.far.tolist()
    ([[-0.819], [-2.0]], [0.0, 0.0, 0.1], [0.1, 0.1, 0.2])
    """
    parts = [
        _mode(plant.A[i], plant.B[i], plant.delays[i], K[i], weights[i]) for i in range(plant.modes)
    ]
    windows = [window for _, own in parts for window in own]
    C, S, R, near, far = (
        np.ascontiguousarray(np.stack(part)) for part in zip(*windows, strict=True)
    )
    F = np.sum([F for F, _ in parts], axis=0)
    return Functional(F, C, S, R, near, far)


def _mode(
    A: np.ndarray, B: np.ndarray, delays: np.ndarray, K: np.ndarray, weight: float
) -> tuple[np.ndarray, list[tuple[np.ndarray, ...]]]:
    """F and the windows (C, S, R, α, β) of one mode."""
    from deadtime.numerics.exponential import discretise

    ends = np.unique(delays)
    ends = ends[np.append(True, np.diff(ends) > _SAME * ends[-1])]
    stage = np.searchsorted(ends, delays * (1.0 + _SAME), "right") - 1
    starts = np.concatenate(([0.0], ends[:-1]))
    windows, Q, F = [], np.zeros_like(K), np.zeros_like(K)
    for r in range(ends.size - 1, -1, -1):
        ending, closed = stage == r, stage < r
        Q[ending] = weight * K[ending]
        S = A + B[:, closed] @ K[closed]
        for s in range(r, ends.size):
            R = np.where(stage == s, B, 0.0)
            near = ends[s] - ends[r]
            windows.append((Q.copy(), S, R, np.array(near), np.array(ends[s] - starts[r])))
        Q = Q @ discretise(S, B, ends[r] - starts[r])[0]
    F += Q
    return F, windows
