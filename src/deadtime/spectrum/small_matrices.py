"""Many small matrices at once, (points, rows, columns): inverses and spectral radii."""

from __future__ import annotations

import numpy as np

_POWERS, _TINY = 4, 1e-200


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


def spectral_radii(X: np.ndarray) -> np.ndarray:
    """The largest modulus of the eigenvalues, (points,); infinite where X is not finite."""
    if X.shape[-1] == 1:
        return np.abs(X[:, 0, 0])
    known = np.isfinite(X).all(axis=(1, 2))
    radius = np.full(X.shape[0], np.inf)
    radius[known] = np.abs(np.linalg.eigvals(X[known])).max(axis=1)
    return radius


def speeds(S: np.ndarray, C: np.ndarray) -> np.ndarray:
    """A v' such that I − ∫ f S C has an inverse for any f with ∫|f| v' < 1, (points,).

    C (cuts, n, m) takes any of its values along the integral. In any basis, ρ of the largest
    absolute values entry by entry will do; best in that of the eigenvectors of one S C.
    """
    X = S @ C[:, None]
    if X.shape[-1] == 1:
        return np.abs(X[..., 0, 0]).max(axis=0)
    plain = _bound(np.abs(X).max(axis=0))
    basis = np.linalg.eig(X[len(C) // 2])[1]
    able = np.linalg.cond(basis) < 1e6
    inner = np.linalg.inv(basis[able]) @ X[:, able] @ basis[able]
    plain[able] = np.minimum(plain[able], _bound(np.abs(inner).max(axis=0)))
    return plain


def _bound(Y: np.ndarray) -> np.ndarray:
    """An upper bound of the spectral radius of Y ≥ 0 (points, m, m), and close to it."""
    # (Y y)_i/y_i bounds it for every y > 0 (Collatz, Wielandt); powers of Y make y good.
    y = np.ones((*Y.shape[:-1], 1))
    for _ in range(_POWERS):
        y = Y @ y + 1e-9 * (Y @ y).max(axis=1, keepdims=True) + _TINY
        y /= y.max(axis=1, keepdims=True)
    return (Y @ y / y).max(axis=(1, 2))
