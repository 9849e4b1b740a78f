"""When a matrix is positive definite beyond doubt.

A large one: Cholesky's factorisation in floating point of X − c I runs to its end, with
c ≥ γ_{d+1}/(1 − γ_{d+1}) tr X, γ_k = k ε/(1 − k ε). Its backward error is then smaller than c,
whatever the order of its sums [Rump, BIT 46 (2006) 433; Higham, Accuracy and Stability, Thm
10.3], so X ≻ 0. Powers of two make the diagonal about 1 before, without rounding.

A small one, in balls: with a lower triangular W of full rank, W X Wᵀ has a diagonal that
dominates (Gershgorin).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from deadtime.certificates.proof import balls

UNIT = 2.0**-53


def powers_of_two(diagonal: np.ndarray) -> np.ndarray:
    """Powers of two t with t² · diagonal in [1/2, 2)."""
    safe = np.where(diagonal > 0.0, diagonal, 1.0)
    return 2.0 ** -np.round(0.5 * np.log2(safe))


def is_positive_definite(middle: np.ndarray, error: np.ndarray) -> bool:
    """Whether every symmetric X with |X − middle| ≤ error, entry by entry, is ≻ 0.

    Parameters
    ----------
    middle : (d, d)
        The symmetric midpoint, its diagonal about 1.
    error : (d,)
        Row sums of the error's bound.
    """
    d = len(middle)
    if not np.isfinite(middle).all() or not np.isfinite(error).all():
        return False
    if (np.diag(middle) <= 0.0).any():
        return False
    gamma = (d + 4) * UNIT / (1.0 - (d + 4) * UNIT)
    trace = float(np.diag(middle).sum()) * (1.0 + 2.0 * d * UNIT)
    shift = 2.0 * gamma * trace + float(np.max(error)) * (1.0 + 4.0 * d * UNIT)
    # The subtraction rounds by at most UNIT · (largest diagonal entry), which 2 γ tr covers.
    if not np.isfinite(shift) or np.abs(middle).max() > 4.0:
        return False  # off the diagonal more than a definite matrix of this diagonal can have
    try:
        factor = np.linalg.cholesky(middle - shift * np.eye(d))
    except np.linalg.LinAlgError:
        return False
    return bool(np.isfinite(factor).all())


def congruence(middle: np.ndarray) -> np.ndarray | None:
    """W, lower triangular in floats, with W X Wᵀ close to I; None if X is not near ≻ 0."""
    if not np.isfinite(middle).all() or (np.diag(middle) <= 0.0).any():
        return None
    unit = 1.0 / np.sqrt(np.diag(middle))
    try:
        factor = np.linalg.cholesky(middle * unit * unit[:, None])
    except np.linalg.LinAlgError:
        return None
    # By numpy.linalg.inv: SciPy's triangular solver waits for threads, even at this size.
    W = np.tril(np.linalg.inv(factor)) * unit
    return W if np.isfinite(W).all() and (np.diag(W) != 0.0).all() else None


def congruent(X: Any) -> tuple[float, Any] | None:
    """(a lower bound of the least eigenvalue of W X Wᵀ, Wᵀ) for a small ball X ≻ 0; else None."""
    W = congruence(balls.middle(X))
    if W is None:
        return None
    left = balls.exact(W)
    right = left.transpose()
    least = least_dominance(left * X * right)
    return (least, right) if least > 0.0 else None


def least_dominance(X: Any) -> float:
    """A lower bound of the least eigenvalue of a symmetric ball matrix, by Gershgorin."""
    size = X.nrows()
    bounds = [math.inf]
    for i in range(size):
        below = X[i, i].lower()
        for j in range(size):
            if j != i:
                below = below - X[i, j].abs_upper()
        bounds.append(_down(below))
    return min(bounds) if not any(map(math.isnan, bounds)) else -math.inf


def _down(value: Any) -> float:
    """A float below a ball."""
    return math.nextafter(float(value.lower()), -math.inf)
