"""Score tests: does a direction that a model lacks explain some of its residuals?

At the maximum of a likelihood the residuals r are white with unit variance and orthogonal to the
slopes D by the unknowns. A model with one more unknown ε predicts r = ε d more. With u the part of
d that is orthogonal to D, over its length, 2 log L rises by (uᵀ r)², which is χ² of one degree of
freedom if ε = 0: Rao's test, which needs no other fit.

**A path of directions** u(τ), one for each value of a parameter that has no meaning where ε = 0,
such as the time of a step. Its largest uᵀ r exceeds c by chance with a probability of at most

    P ≤ Q(c) + (ℓ/2π) exp(−c²/2),    ℓ: the length of the path on the unit sphere

(Hotelling's tube; Davies, Biometrika 74(1), 1987), of both signs twice that, and at most the sum of
Q(c) over the directions that were tried.

**A random walk** of a coefficient c is a sum of slow cosines with independent coefficients of
variance 1/(jπ)² (its Karhunen–Loève series, less its mean). The locally best invariant test is
Σ_j (d_jᵀ r)²/(jπ)² (Nabeya and Tanaka, Annals of Statistics 16(1), 1988), a quadratic form of
normal variables, whose tail follows from its saddle point (Kuonen, Biometrika 86(4), 1999).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

_SINGULAR = 1e-7  # of the largest singular value of scaled columns: a direction is none of its own
_NOTHING = 1e-5  # of a direction's length: what is left of one that the unknowns explain


class Score(NamedTuple):
    """The result of a test.

    log_chance : the logarithm of the probability of more, if the model lacks nothing
    rise : of 2 log L, less twice the number of coefficients (Akaike)
    directions : (data, some), those that explain the residuals
    place, size : of the best direction of a path, and its coefficient
    """

    log_chance: float
    rise: float
    directions: Float[np.ndarray, "datum some"]
    place: int = 0
    size: float = 0.0


class Regression(NamedTuple):
    """Residuals, and an orthonormal basis of the directions that the unknowns explain."""

    basis: Float[np.ndarray, "datum rank"]
    residuals: Float[np.ndarray, " datum"]

    @classmethod
    def of(cls, r: Float[np.ndarray, " datum"], D: Float[np.ndarray, "datum size"]) -> Regression:
        basis = basis_of(D)
        return cls(basis, r - basis @ (basis.T @ r))

    def beside(self, d: Float[np.ndarray, "datum some"]) -> Regression:
        """The regression with the coefficients of some more directions among its unknowns."""
        more = basis_of(self.across(d))
        left = self.residuals - more @ (more.T @ self.residuals)
        return Regression(np.hstack((self.basis, more)), left)

    def across(self, d: Float[np.ndarray, "datum some"]) -> Float[np.ndarray, "datum some"]:
        """The parts of directions that are orthogonal to the basis; 0 where nothing is left."""
        own = d - self.basis @ (self.basis.T @ d)
        own -= self.basis @ (self.basis.T @ own)
        left = np.linalg.norm(own, axis=0) > _NOTHING * np.linalg.norm(d, axis=0)
        return np.where(left, own, 0.0)


def basis_of(D: Float[np.ndarray, "datum size"]) -> Float[np.ndarray, "datum rank"]:
    """An orthonormal basis of the columns' space, whatever their units are."""
    size = np.linalg.norm(D, axis=0)
    U, s, _ = np.linalg.svd(D[:, size > 0.0] / size[size > 0.0], full_matrices=False)
    return U[:, s > _SINGULAR * s.max(initial=0.0)]


def best_of_path(
    fit: Regression,
    d: Float[np.ndarray, "datum many"],
    one_sided: bool = False,
    least: float = 0.0,
) -> Score | None:
    """The direction of a path that explains most; None if there is none.

    one_sided : whether coefficients are known to be positive
    least : the length of directions below which they are left out: with a coefficient of 1, that
        many standard errors

    Examples
    --------
    >>> fit = Regression.of(np.array([0.0, 0.0, 5.0, 0.0]), np.eye(4)[:, :1])
    >>> score = best_of_path(fit, np.eye(4))
    >>> score.place, score.rise, round(float(np.exp(score.log_chance)) * 1e6, 2)
    (2, 23.0, 1.72)
    """
    from scipy.stats import norm

    own = fit.across(d)
    length = np.linalg.norm(own, axis=0)
    tried = np.flatnonzero(length > least)
    if not tried.size:
        return None
    u = own[:, tried] / length[tried]
    z = fit.residuals @ u
    z = z if one_sided else np.abs(z)
    best = int(z.argmax())
    c = float(z[best])
    turn = (u[:, 1:] * u[:, :-1]).sum(axis=0)
    turn = turn if one_sided else np.abs(turn)
    path = float(np.arccos(np.clip(turn, -1.0, 1.0)).sum())
    tail = float(norm.logsf(c))
    tube = np.logaddexp(tail, np.log(max(path, 1e-300) / (2.0 * np.pi)) - 0.5 * c * abs(c))
    log_chance = min(0.0, tail + np.log(tried.size), float(tube)) + np.log(2.0 - one_sided)
    at = int(tried[best])
    size = float(fit.residuals @ u[:, best] / length[at])
    return Score(min(0.0, log_chance), c * c - 2.0, d[:, [at]], at, size)


def together(fit: Regression, d: Float[np.ndarray, "datum some"]) -> Score | None:
    """The test of several coefficients together, by χ²; None if there are none."""
    from scipy.stats import chi2

    own = fit.across(d)
    if not own.any():
        return None
    explained = basis_of(own).T @ fit.residuals
    total = float(explained @ explained)
    return Score(float(chi2.logsf(total, explained.size)), total - 2.0 * explained.size, d)


def random_walk(fit: Regression, d: Float[np.ndarray, "datum cosine"]) -> Score | None:
    """The test of a coefficient that walks at random, d by its cosines; None if there is none."""
    own = fit.across(d) / (np.pi * np.arange(1, d.shape[1] + 1))
    if not own.any():
        return None
    weights = np.linalg.eigvalsh(own.T @ own)
    total = float(np.square(fit.residuals @ own).sum())
    log_chance = log_tail(total, weights[weights > 1e-12 * weights.max()])
    among = together(fit, d)
    assert among is not None
    return among._replace(log_chance=log_chance)


def log_tail(q: float, weights: Float[np.ndarray, " some"]) -> float:
    """log P(Σ λ_i χ²₁ > q) by the saddle point of Lugannani and Rice.

    Examples
    --------
    >>> cosines = np.pi * np.arange(1, 100)    # Cramér and von Mises's test: 1.168 at 1/1000
    >>> round(float(np.exp(log_tail(1.168, cosines**-2.0))), 5)
    0.00106
    """
    from scipy.optimize import brentq
    from scipy.stats import norm

    if q <= 1.05 * weights.sum():  # near the mean the formula is singular, and nothing is found
        return float(np.log(0.5))
    end = 0.5 / weights.max()

    def slope(t: float) -> float:
        return float((weights / (1.0 - 2.0 * weights * t)).sum()) - q

    t = float(brentq(slope, 0.0, end * (1.0 - 1e-15), xtol=1e-15 * end))  # pyright: ignore[reportArgumentType]
    left = 1.0 - 2.0 * weights * t
    w = np.sqrt(2.0 * (t * q + 0.5 * np.log(left).sum()))
    v = t * np.sqrt(2.0 * np.square(weights / left).sum())
    return float(norm.logsf(w + np.log(v / w) / w))
