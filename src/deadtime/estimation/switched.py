"""One quadratic function that decays in every mode of x_{k+1} = E_i x_k."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from deadtime.numerics.lmi import (
    Limit,
    Program,
    attempts,
    balanced_units,
    symmetric_basis,
    symmetric_value,
)

_NARROW = 1e-3  # of the bracket at which bisection stops


def common_rate(E: Float[np.ndarray, "mode n n"]) -> float:
    """The smallest r found with one P > 0 and E_iᵀ P E_i ≤ e^{2r} P for all i.

    Bisection over r between the largest spectral radius and the largest norm (P = I in balanced
    units); every P is put back.
    """
    units = balanced_units(E)
    E = E / units[:, None] * units
    radius = float(np.abs(np.linalg.eigvals(E)).max())
    best = float(np.linalg.norm(E, 2, axis=(1, 2)).max())  # of P = I
    low = max(radius, 1e-12 * best)
    if best == 0.0:
        return -np.inf
    while best > low * (1.0 + _NARROW):
        middle = float(np.sqrt(low * best))
        found = min((_contraction(E, P) for P in _candidates(E, middle)), default=np.inf)
        best, low = (found, low) if found < middle * (1.0 + _NARROW / 2.0) else (best, middle)
    return float(np.log(best))


def _candidates(E: np.ndarray, rate: float) -> list[np.ndarray]:
    """P from one attempt at E_iᵀ P E_i ≤ rate² P."""
    n = E.shape[-1]
    basis = symmetric_basis(n)
    limits = [Limit(basis, -np.eye(n))]
    limits += [Limit(basis - M.T @ basis @ M, np.zeros((n, n))) for M in E / rate]
    verdict = next(attempts(Program(np.trace(basis, axis1=1, axis2=2), limits)))
    value = symmetric_value(verdict.x, n)
    return [] if value is None else [value]


def _contraction(E: np.ndarray, P: np.ndarray) -> float:
    """max_i |E_i| in the norm of P."""
    values = np.linalg.eigvalsh(P)
    if values[0] <= 1e-12 * values[-1]:
        return np.inf
    L = np.linalg.cholesky(P)
    inverse = np.linalg.inv(L)
    return max(float(np.linalg.norm(L.T @ M @ inverse.T, 2)) for M in E)
