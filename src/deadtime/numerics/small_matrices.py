"""Stacks of small matrices, (points, rows, columns): inverses, traces, ordered eigenvalues.

For a matrix function Δ with the singular value decomposition Δ = Σ σₖ uₖ vₖᴴ,

    d ln det Δ = tr(Δ⁻¹ dΔ) = Σ_k (uₖᴴ dΔ vₖ)/σₖ.

Rows and columns are scaled to similar size first: otherwise the round-off of large entries exceeds
small ones.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex

_TINY = 1e-200


def inverses(X: np.ndarray) -> np.ndarray:
    """X⁻¹; a large matrix for a singular X."""
    if X.shape[-1] == 1:
        return 1.0 / np.where(X == 0.0, _TINY, X)
    try:
        return np.linalg.inv(X)
    except np.linalg.LinAlgError:  # one of them is exactly singular
        size = np.abs(X).max(axis=(1, 2), keepdims=True) + _TINY
        return np.linalg.inv(X + np.finfo(float).eps * size * np.eye(X.shape[-1]))


def traces(inverse: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """tr(X⁻¹ dX), (points,)."""
    return np.einsum("pij,pji->p", inverse, slope)


def matched(values: np.ndarray) -> np.ndarray:
    """Eigenvalues (points, k), each row in the order of the nearest ones of the row before."""
    if values.shape[1] < 2:
        return values
    from scipy.optimize import linear_sum_assignment

    values = values.copy()
    for i in range(1, len(values)):
        apart = np.abs(values[i - 1][:, None] - values[i])
        values[i] = values[i][linear_sum_assignment(apart)[1]]
    return values


class Decomposed(NamedTuple):
    """Scaled Δ = U diag(σ) Vᴴ at points, and other matrices with the same scaling."""

    left: np.ndarray
    values: np.ndarray
    right: np.ndarray
    others: tuple[np.ndarray, ...]

    def slope(self, k: int) -> Complex[np.ndarray, " point"]:
        """tr(Δ⁻¹ dΔ), dΔ the k-th of the others."""
        along = np.einsum("pik,pij,pkj->pk", self.left.conj(), self.others[k], self.right.conj())
        return (along / np.maximum(self.values, 1e-300)).sum(axis=1)


def decompose(Delta: np.ndarray, *others: np.ndarray) -> Decomposed:
    """Δ (points, k, k), and others, scaled and decomposed."""
    for axis in (2, 1):
        size = np.abs(Delta).max(axis=axis, keepdims=True)
        size[size == 0.0] = 1.0
        Delta, others = Delta / size, tuple(other / size for other in others)
    return Decomposed(*np.linalg.svd(Delta), others)
