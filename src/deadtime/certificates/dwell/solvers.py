"""Solvers of the search: semidefinite programs by Clarabel, a Riccati equation by doubling.

Symmetric matrices are packed as in `deadtime.numerics.lmi`. P follows from Π as the
stabilising solution of a Riccati equation.

K ≻ 0 of `proof.evidence` is a Kalman–Yakubovich–Popov inequality. With slack (t/2) Q₀ and
(t/2) R₀ on its diagonal blocks it holds with equality of rank d for

    P = MᵀPM + Q + (MᵀPB + S)(−R − BᵀPB)⁻¹(BᵀPM + Sᵀ),

X = −P the solution of the discrete algebraic Riccati equation of (M, B, −Q, −R, −S). Doubling
[Chu, Fan, Lin, Wang, Int. J. Control 77 (2004) 767] squares the closed loop at each step, so a
loop of decay 1 − 10⁻⁶ takes about 20 steps, whatever its order.
"""

from __future__ import annotations

import threading
from typing import Any

import numpy as np

from deadtime.numerics.lmi import library, packing, settings_of

# The maximum counts as positive if the value reached is above LEAST, the duality gap below this
# part of it, and the residual small.
CLEAR, CLEAR_RESIDUAL, LEAST = 0.5, 1e-6, 1e-7
STOPPED = "CallbackTerminated"  # the status of a stopped solver
MOST_STEPS = 60


def squares(left: np.ndarray) -> np.ndarray:
    """left* E left for every basis matrix E of a packed symmetric matrix: (entries, k, k)."""
    rows, columns, _ = packing(len(left))
    product = left[rows][:, :, None].conj() * left[columns][:, None, :]
    both = product + product.conj().transpose(0, 2, 1)
    return np.where((rows == columns)[:, None, None], product, both)


def maximise(
    A: Any, b: np.ndarray, sizes: list[int], *, roughly: bool = False
) -> tuple[np.ndarray, str] | None:
    """Maximise the last unknown subject to b − A x in the cones; None if that fails.

    A is an array or a sparse matrix. `roughly`: stop once the unknown is certainly positive, if the
    solver has callbacks.
    """
    from scipy.sparse import csc_matrix

    solver = library("clarabel")
    unknowns = A.shape[1]
    cost = np.zeros(unknowns)
    cost[-1] = -1.0
    settings = settings_of(solver)
    cones = [solver.PSDTriangleConeT(size) for size in sizes]
    nothing = csc_matrix((unknowns, unknowns))
    try:
        ready = solver.DefaultSolver(nothing, cost, csc_matrix(A), b, cones, settings)
        # No callback in the main thread: the solver would swallow a Ctrl-C there.
        main = threading.current_thread() is threading.main_thread()
        if roughly and not main and hasattr(ready, "set_termination_callback"):
            ready.set_termination_callback(_is_clear)
        solution = ready.solve()
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException:  # a panic in compiled code is no Exception
        return None
    x = np.array(solution.x)
    return (x, str(solution.status)) if np.isfinite(x).all() else None


def _is_clear(progress: Any) -> bool:
    """Whether the maximum is certainly positive, between two iterations of the solver."""
    reached = -progress.cost_primal
    return (
        reached > LEAST
        and progress.gap_abs < CLEAR * reached
        and progress.res_primal < CLEAR_RESIDUAL
    )


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
            # G and H are kept symmetric against rounding.
            H = H + 0.5 * (step + step.T)
            if not np.isfinite(H).all():
                return None
            # Convergence is quadratic, so the last step is far below the accuracy of H.
            if np.abs(step).max() <= 1e-15 * np.abs(H).max():
                return -0.5 * (H + H.T)
    except np.linalg.LinAlgError:
        return None
    return None
