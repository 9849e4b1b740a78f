"""Newton's method on the determinant of a small matrix function.

    d ln det Δ = tr(Δ⁻¹ dΔ) = Σ_k (uₖᴴ dΔ vₖ)/σₖ

with the singular value decomposition of Δ, rows and columns scaled alike first: left as they are,
large entries would hide the digits of small ones.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from deadtime.spectrum.ideal import IdealLoop

_STEPS = 40
_CONVERGED = 1e-6  # relative: of a multiple root half of the digits are lost


class Decomposed(NamedTuple):
    """Scaled Δ = U diag(σ) Vᴴ at points, and other matrices scaled like it."""

    left: np.ndarray
    values: np.ndarray
    right: np.ndarray
    others: tuple[np.ndarray, ...]

    def slope(self, k: int) -> Complex[np.ndarray, " point"]:
        """tr(Δ⁻¹ dΔ), dΔ the k-th of the others."""
        along = np.einsum("pik,pij,pkj->pk", self.left.conj(), self.others[k], self.right.conj())
        return (along / np.maximum(self.values, 1e-300)).sum(axis=1)


def decomposed(Delta: np.ndarray, *others: np.ndarray) -> Decomposed:
    """Δ (points, k, k), and others, scaled and decomposed."""
    for axis in (2, 1):
        size = np.abs(Delta).max(axis=axis, keepdims=True)
        size[size == 0.0] = 1.0
        Delta, others = Delta / size, tuple(other / size for other in others)
    return Decomposed(*np.linalg.svd(Delta), others)


def newton(
    loop: IdealLoop, starts: Complex[np.ndarray, " root"]
) -> tuple[Complex[np.ndarray, " root"], Float[np.ndarray, " root"]]:
    """Roots of det Δ from every start, s ← s − 1/tr(Δ⁻¹Δ'), and σ_min/σ_max of Δ there.

    Infinite where it does not converge within 1/T of its start.
    """
    unit = 1.0 / loop.longest
    best, s, real = starts.copy(), starts.copy(), np.imag(starts) == 0.0
    residuals, last = np.full((2, starts.size), np.inf)
    for _ in range(_STEPS if s.size else 0):
        now = decomposed(*loop.matrix(s))
        residual, step = now.values[:, -1] / now.values[:, 0], 1.0 / now.slope(0)
        better = residual < residuals
        best[better], residuals[better] = s[better], residual[better]
        last[better] = np.abs(step[better]) / (np.abs(s[better]) + unit)
        s = np.where(real, np.real(s) - np.real(step), s - step)
        lost = ~(np.abs(s - starts) <= unit)
        s[lost], step[lost] = best[lost], 0.0
        if (np.abs(step) <= 1e-15 * (np.abs(s) + unit)).all():
            break
    residuals[~(last <= _CONVERGED)] = np.inf
    return best, residuals


def errors(loop: IdealLoop, roots: Complex[np.ndarray, " root"]) -> Float[np.ndarray, " root"]:
    """How far round-off δ in Δ moves each root, |u|ᵀ δ |v| / |uᴴ Δ' v|, to first order."""
    if roots.size == 0:
        return np.empty(0)
    round_off = np.finfo(float).eps * loop.magnitude(roots)
    now = decomposed(*loop.matrix(roots), round_off)
    prime, round_off = now.others
    u, v = now.left[:, :, -1], now.right[:, -1].conj()
    change = np.einsum("pi,pij,pj->p", np.abs(u), round_off, np.abs(v))
    slope = np.abs(np.einsum("pi,pij,pj->p", u.conj(), prime, v))
    return change / np.maximum(slope, 1e-300)
