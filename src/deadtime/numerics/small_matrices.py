"""Many small matrices at once, (points, rows, columns): inverses and traces."""

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
