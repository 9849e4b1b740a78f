"""Outer functions of given moduli, at a matrix: what weighs a controller in `delay_limit`."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

_POINTS = 12
_SMALL = 1e-14  # |q|: below, W is q and O is 1


def half_angle(v: np.ndarray) -> np.ndarray:
    """tan(½ asin v) = v (1 + √(1 + v) √(1 − v))⁻¹ of a matrix: no digits are lost for small v."""
    from scipy.linalg import sqrtm

    one = np.eye(v.shape[0])
    plus, minus = (np.asarray(sqrtm(one + sign * v)) for sign in (1.0, -1.0))
    return np.linalg.solve(one + plus @ minus, v)


def delay_weight(q: np.ndarray) -> np.ndarray:
    """W at q = pΔ: outer with |W(jx)| = 2 sin(x/2) for x < π and 2 beyond.

    W = q W₁, and log W₁(q) = (2/π) ∫₀^∞ ℓ(x) q/(q² + x²) dx with ℓ = log(2 sin(x/2)/x), log(2/x).

    Examples
    --------
    >>> delay_weight(np.array([[0.1]])).round(4)     # close to q itself while that is small
    array([[0.0963]])
    """
    if np.abs(q).max() < _SMALL:
        return q
    x, weights = _nodes(q)
    level = np.log(np.where(x < np.pi, np.sinc(np.minimum(x, np.pi) / (2.0 * np.pi)), 2.0 / x))
    return q @ outer(level, x, weights, q)


def half_angle_weight(q: np.ndarray) -> np.ndarray:
    """O at q = pΔ: outer with |O(jx)| = tan(π/4 + ¼ atan x).

    Examples
    --------
    >>> [half_angle_weight(np.array([[q]])).item().__round__(4) for q in (1e-9, 1e9)]
    [1.0, 2.4142]
    """
    if np.abs(q).max() < _SMALL:
        return np.eye(len(q))
    x, weights = _nodes(q)
    return outer(np.log(np.tan(0.25 * np.pi + 0.25 * np.arctan(x))), x, weights, q)


def outer(levels: np.ndarray, x: np.ndarray, weights: np.ndarray, q: np.ndarray) -> np.ndarray:
    """exp((2/π) Σ w ℓ q (q² + x²)⁻¹): the outer function of log modulus ℓ(x) = ℓ(−x), at q."""
    from scipy.linalg import expm

    square = q @ q
    one = np.eye(q.shape[0])
    inverse = np.linalg.inv(square + (x**2)[:, None, None] * one)
    return expm((2.0 / np.pi) * q @ np.einsum("k,kij->ij", weights * levels, inverse))


def _nodes(q: np.ndarray) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Gauss nodes and weights on (0, ∞): panels that double away from 0 and from every |Im q|.

    The kernel has poles at a distance Re q from |Im q|, and the modulus of W a kink at π.
    """
    values = np.linalg.eigvals(q)
    re, im, size = np.real(values), np.abs(np.imag(values)), np.abs(values)
    low, high = 1e-3 * min(float(size.min()), 1.0), 1e7 * max(float(size.max()), 4.0)
    ends = [low * 2.0 ** np.arange(math.ceil(math.log2(high / low)) + 1), [0.0, np.pi]]
    for at, width in zip(im, re, strict=True):
        away = 0.5 * width * 2.0 ** np.arange(max(1, math.ceil(math.log2(high / width)) + 1))
        ends += [at + away, at - away, [at]]
    ends = np.unique(np.concatenate(ends))
    ends = ends[(ends >= 0.0) & (ends <= high)]
    y, weights = np.polynomial.legendre.leggauss(_POINTS)
    y, weights = 0.5 * (1.0 + y), 0.5 * weights
    length = np.diff(ends)[:, None]
    x, w = ends[:-1, None] + length * y, length * weights
    # Beyond the last end: x = end/t², where the logarithm at t = 0 is mild.
    t, last = y**2, ends[-1]
    tail = 2.0 * y * weights * last / t**2
    return np.concatenate((x.ravel(), last / t)), np.concatenate((w.ravel(), tail))
