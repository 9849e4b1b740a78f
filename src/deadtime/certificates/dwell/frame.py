"""Units of ξ in which a Lyapunov function is about I, and the functionals that it is made of."""

from __future__ import annotations

import numpy as np

from deadtime.certificates.dwell.leaps import Node
from deadtime.certificates.dwell.lyapunov_shape import future_sums
from deadtime.certificates.proof.evidence import Setting

WHOLE, WHOLE_REMEMBERED = 12, 20  # order up to which H is all of ξ; with what a law remembers in it
MOST = 12  # functionals, above it
CARRIED = 1e-9  # of the strongest: functionals that the loop does not carry on
TURNS = 40  # of the power iteration


def whole(setting: Setting) -> int:
    """The order up to which V along stretches is any matrix.

    What a law remembers is read at once, so all of it counts; a delay line is soon emptied.
    """
    return WHOLE_REMEMBERED if setting.memory else WHOLE


def balancing_units(loops: list[np.ndarray]) -> np.ndarray:
    """Units (d,) in which rows and columns of the loops are about equally large."""
    from scipy.linalg import matrix_balance

    total = np.sum([np.abs(M) for M in loops], axis=0)
    _, (scale, _) = matrix_balance(total, permute=False, separate=True)
    return 1.0 / scale


def metric(lasting: list[np.ndarray], leaps: list[tuple[Node, Node, np.ndarray]]) -> np.ndarray:
    """T with |T ξ|² what ξ adds up to: in constant modes, or over leaps where no mode may last."""
    eye = np.eye(len(leaps[0][2]))
    sums = [future_sums(M, eye) for M in lasting]
    total = [part for part in sums if part is not None]
    if not total:
        total = [_over_leaps([M for _, _, M in leaps], eye)]
    return np.linalg.cholesky(np.mean(total, axis=0)).T


def _over_leaps(leaps: list[np.ndarray], eye: np.ndarray) -> np.ndarray:
    """Σ_k 𝒯^k(I) γ^k, 𝒯 the mean of MᵀXM over the leaps, with γ such that it converges."""

    def mean(X: np.ndarray) -> np.ndarray:
        return np.mean([M.T @ X @ M for M in leaps], axis=0)

    X, growth = eye, 1.0
    for _ in range(TURNS):
        X = mean(X)
        growth = max(float(np.trace(X)), 1e-300)
        X = X / growth
    weight, total, term = 0.9 / max(growth, 0.9), eye, eye
    for _ in range(TURNS):
        term = weight * mean(term)
        total = total + term
    return total


def functionals(
    switching: list[tuple[Node, Node, np.ndarray]], d: int, most: int = WHOLE
) -> np.ndarray:
    """H (s, d), orthonormal: all of ξ up to an order, or the leading functionals of two leaps."""
    if d <= most:
        return np.eye(d)
    once: dict[Node, np.ndarray] = {}
    twice = np.zeros((d, d))
    for here, _, M in switching:
        once[here] = once.get(here, np.zeros((d, d))) + M.T @ M
    for _, there, M in switching:
        twice += M.T @ once.get(there, np.zeros((d, d))) @ M
    values, vectors = np.linalg.eigh(twice)
    keep = values > CARRIED * values[-1]
    return vectors[:, keep][:, -MOST:].T
