"""Loops that are products of exponentials, and where they stop to decay, by SciPy alone."""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq, minimize


def ellipses(k: float, a: float) -> np.ndarray:
    """Two modes that turn along ellipses with axes 1 : √k, one upright and one lying."""
    return np.array([[[-a, 1.0], [-k, -a]], [[-a, k], [-1.0, -a]]])


def commuting(rng) -> np.ndarray:
    """Modes with the same eigenvectors."""
    T = rng.normal(size=(3, 3))
    return np.stack([T @ np.diag(rng.uniform(-2, 0, 3)) @ np.linalg.inv(T) for _ in range(3)])


def triangular(rng) -> np.ndarray:
    """Modes that are upper triangular."""
    A = np.triu(rng.normal(size=(2, 3, 3)), 1)
    A[:, range(3), range(3)] = rng.uniform(-2, 0, (2, 3))
    return A


def normal(rng) -> np.ndarray:
    """Modes whose exponentials have their spectral radius as norm."""
    A = []
    for a, w, b in rng.uniform((-2, 1, -2), (0, 3, 0), (2, 3)):
        Q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        A.append(Q @ np.array([[a, w, 0], [-w, a, 0], [0, 0, b]]) @ Q.T)
    return np.stack(A)


def multiplier(A, cycle) -> float:
    """The spectral radius of e^{A_i t} … over a cycle of (mode, time)."""
    product = np.eye(A.shape[1])
    for mode, time in cycle:
        product = expm(A[mode] * time) @ product
    return float(np.abs(np.linalg.eigvals(product)).max())


def worst_multiplier(A, low, high) -> float:
    """The largest spectral radius over cycles of modes 0 and 1, sojourns in [low, high]."""
    grids = [np.linspace(a, b, 60) for a, b in zip(low, high, strict=True)]
    first, second = (expm(M * t[:, None, None]) for M, t in zip(A, grids, strict=True))
    sizes = np.abs(np.linalg.eigvals(second[None] @ first[:, None])).max(axis=2)
    i, j = np.unravel_index(sizes.argmax(), sizes.shape)
    found = minimize(
        lambda t: -multiplier(A, [(0, t[0]), (1, t[1])]),
        [grids[0][i], grids[1][j]],
        method="Nelder-Mead",
        bounds=list(zip(low, high, strict=True)),
    )
    return max(float(sizes.max()), -float(found.fun))


def critical(growth, stable: float, unstable: float) -> float:
    """Where the multiplier `growth` of a parameter passes 1."""
    return float(brentq(lambda p: math.log(growth(p)), stable, unstable, xtol=1e-6))
