"""P from Π: the stabilising solution of a Riccati equation, by structured doubling.

K ≻ 0 of `proof.evidence` is a Kalman–Yakubovich–Popov inequality. With slack (t/2) Q₀ and
(t/2) R₀ on its diagonal blocks it holds with equality of rank d for

    P = MᵀPM + Q + (MᵀPB + S)(−R − BᵀPB)⁻¹(BᵀPM + Sᵀ),

X = −P the solution of the discrete algebraic Riccati equation of (M, B, −Q, −R, −S). Doubling
[Chu, Fan, Lin, Wang, Int. J. Control 77 (2004) 767] squares the closed loop at each step, so a
loop of decay 1 − 10⁻⁶ takes about 20 steps, whatever its order.
"""

from __future__ import annotations

import numpy as np

MOST_STEPS = 60


def solve_riccati(
    M: np.ndarray, B: np.ndarray, Q: np.ndarray, R: np.ndarray, S: np.ndarray
) -> np.ndarray | None:
    """P, symmetric; None where doubling breaks down."""
    from scipy.linalg import lu_factor, lu_solve

    d = len(M)
    try:
        inverse = np.linalg.inv(-R)
        A = M + B @ inverse @ S.T
        H = -Q - S @ inverse @ S.T
        G = B @ inverse @ B.T
        for _ in range(MOST_STEPS):
            factor = lu_factor(np.eye(d) + G @ H, overwrite_a=True, check_finite=False)
            WA = lu_solve(factor, A, check_finite=False)
            step = A.T @ (H @ WA)
            G = G + A @ lu_solve(factor, G, check_finite=False) @ A.T
            G = 0.5 * (G + G.T)
            A = A @ WA
            H = H + 0.5 * (step + step.T)
            if not np.isfinite(H).all():
                return None
            if np.abs(step).max() <= 1e-15 * np.abs(H).max():
                return -0.5 * (H + H.T)
    except np.linalg.LinAlgError:
        return None
    return None
