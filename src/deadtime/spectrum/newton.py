"""Newton's method on the determinant of a small matrix function.

    d ln det Δ = tr(Δ⁻¹ dΔ) = Σ_k (uₖᴴ dΔ vₖ)/σₖ

with the singular value decomposition of Δ, rows and columns scaled alike first: left as they are,
large entries would hide the digits of small ones.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from deadtime.numerics.small_matrices import inverses
from deadtime.spectrum.ideal import IdealLoop

_STEPS, _CIRCLE = 40, 8
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


def decompose(Delta: np.ndarray, *others: np.ndarray) -> Decomposed:
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

    Infinite where it does not converge within `loop.unit` of its start.
    """
    unit = loop.unit
    best, s, real = starts.copy(), starts.copy(), np.imag(starts) == 0.0
    residuals, last = np.full((2, starts.size), np.inf)
    for _ in range(_STEPS if s.size else 0):
        now = decompose(*loop.matrix(s))
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
    """How far round-off δ in Δ may move each root.

    To first order that is |u|ᵀ δ |v| / |uᴴ Δ' v|, and with it goes what is left to the root of this
    Δ, a step of Newton's method. Roots close to each other move farther, a double one as √δ and not
    as δ over a slope of 0: the answer is the radius of a circle on which ρ(|Δ⁻¹| δ) < 1, so that no
    change of Δ by δ takes a root across it, found from a smaller one outwards.
    """
    if roots.size == 0:
        return np.empty(0)
    epsilon = np.finfo(float).eps
    now = decompose(*loop.matrix(roots), epsilon * loop.magnitude(roots))
    prime, round_off = now.others
    u, v = now.left[:, :, -1], now.right[:, -1].conj()
    change = np.einsum("pi,pij,pj->p", np.abs(u), round_off, np.abs(v))
    slope = np.abs(np.einsum("pi,pij,pj->p", u.conj(), prime, v))
    left = 1.0 / np.maximum(np.abs(now.slope(0)), 1e-300)
    first = np.minimum(change / np.maximum(slope, 1e-300), math.sqrt(epsilon) * loop.unit)
    radius = np.minimum(1.25 * (first + left), loop.unit)
    circle = np.exp(2j * np.pi * (np.arange(_CIRCLE) + 0.5) / _CIRCLE)
    grown = np.arange(roots.size)
    while grown.size:
        points = (roots[grown, None] + radius[grown, None] * circle).ravel()
        moved = np.abs(inverses(loop.matrix(points)[0])) @ (epsilon * loop.magnitude(points))
        across = np.abs(np.linalg.eigvals(moved)).max(axis=1).reshape(-1, _CIRCLE).max(axis=1)
        grown = grown[(across >= 1.0) & (radius[grown] < loop.unit)]
        radius[grown] *= 1.5
    return radius
