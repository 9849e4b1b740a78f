"""Many small matrices at once, (points, rows, columns): inverses, traces, eigenvalues in order."""

from __future__ import annotations

import numpy as np

_TINY = 1e-200


def inverses(X: np.ndarray) -> np.ndarray:
    """X⁻¹, large where there is none."""
    if X.shape[-1] == 1:
        return 1.0 / np.where(X == 0.0, _TINY, X)
    try:
        return np.linalg.inv(X)
    except np.linalg.LinAlgError:
        size = np.abs(X).max(axis=(1, 2), keepdims=True) + _TINY
        return np.linalg.inv(X + np.finfo(float).eps * size * np.eye(X.shape[-1]))


def traces(inverse: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """tr(X⁻¹ dX), (points,)."""
    return np.einsum("pij,pji->p", inverse, slope)


def matched(values: np.ndarray) -> np.ndarray:
    """Rows of eigenvalues (points, k), each in the order of the nearest ones of the row before."""
    if values.shape[1] < 2:
        return values
    from scipy.optimize import linear_sum_assignment

    values = values.copy()
    for i in range(1, len(values)):
        apart = np.abs(values[i - 1][:, None] - values[i])
        values[i] = values[i][linear_sum_assignment(apart)[1]]
    return values
