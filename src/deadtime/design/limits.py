"""How large a delay margin any linear controller could have, mode by mode.

The loop at the plant's input has the complementary sensitivity T(s) = e^{−sD} T̃(s), T̃ stable. An
unstable part of the plant (A₊, B₊) fixes T̃ there; a true delay D + δ turns I into
I + (e^{−sδ} − 1) T. docs/theory/delay-margin.md derives, for all |δ| < Δ:

Reached by some linear controller (small gain), with the outer W of |W(jω)| = max |e^{−jωδ} − 1|:

    X₂ ≤ X₁,    A₊X₁ + X₁A₊ᵀ = B₊B₊ᵀ,    A₊X₂ + X₂A₊ᵀ = C Cᵀ,    C = W(A₊) e^{A₊D} B₊

Reached by none that is linear, time-invariant and continuous: what breaks, for one input, the same
inequality with C = O(A₊)⁻¹ tan(½ asin(A₊Δ)) e^{A₊(D−Δ)} B₊, or A₊Δ having an eigenvalue on [1, ∞);
for several inputs, for an eigenvalue p: |tan(½ asin(pΔ)) e^{p(D−Δ)}| ≤ |O(p)|. Here O is outer with
|O(jω)| = tan(π/4 + ¼ atan(ωΔ)).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Complex, Float

from deadtime.checks import index, instance
from deadtime.gains import require_controllable
from deadtime.plant import SwitchedSystem

SLOW = 1e-6  # of 1/D: poles below are not counted; what they cost is of that order
_POINTS = 12
_LEAST = 1e-15  # relative: a smaller limit is 0


@dataclass(frozen=True, eq=False)
class DelayLimit:
    """What the delay margin of one mode can be at all (immutable).

    Attributes
    ----------
    reached : float
        Some linear controller keeps the mode stable for all true delays that err by less than
        this, relative to the delay (small gain: sufficient). ∞: every delay error below 100 %.
    most : float
        No linear time-invariant controller does for an error larger than this (necessary).
    poles : (unstable poles,) complex
        The poles that set the limits, 1/s.
    """

    reached: float
    most: float
    poles: Complex[np.ndarray, " pole"]


def delay_limit(plant: SwitchedSystem, mode: int = 0) -> DelayLimit:
    """The limits of the relative delay margin of one mode, whatever the linear controller.

    Parameters
    ----------
    plant : SwitchedSystem
        Its unstable poles must be controllable for a limit above 0.
    mode : int
        The mode.

    Returns
    -------
    DelayLimit
        To about 1e-9 relative. Without unstable poles `most` is ∞. Poles within 1e-6/D of the
        imaginary axis count as on it, and do not limit `most`.

    Notes
    -----
    Between the two, nothing is claimed. They are about continuous controllers; a digital loop tends
    to one as its period shortens. Controllers that vary in time are not covered by `most`.

    References
    ----------
    Small gain and Nevanlinna–Pick interpolation: Doyle, Francis and Tannenbaum, Feedback Control
    Theory (1992), chapters 9 and 12. Without a nominal delay `most` is the bound of Middleton and
    Miller, IEEE Trans. Automatic Control 52 (2007), theorem 4: an interval of 2/p.

    Examples
    --------
    >>> import deadtime as dt
    >>> limit = delay_limit(dt.problems.paper().plant, mode=0)
    >>> limit.poles.real, round(limit.reached, 3), round(limit.most, 3)
    (array([1., 2.]), 0.027, 0.073)
    """
    instance("plant", plant, SwitchedSystem)
    mode = index("mode", mode, plant.modes)
    A, B, D = *_unstable(plant.A[mode], plant.B[mode], SLOW / plant.delay), plant.delay
    on_axis = _on_axis(plant.A[mode], D)
    if A.size == 0:
        return DelayLimit(on_axis, math.inf, np.empty(0, complex))
    require_controllable(A, B, mode)
    poles = np.sort_complex(np.linalg.eigvals(A).astype(complex))
    several = B.shape[1] > 1
    possible = _apart if several else _together
    reached = min(on_axis, _largest(lambda error: _small_gain(A, B, D, error * D)))
    most = _largest(lambda error: possible(A, B, D, error * D))
    return DelayLimit(reached, most, poles)


def _largest(slack: Callable[[float], float]) -> float:
    """The relative error below 1 at which a condition (slack ≥ 0) is lost; ∞ for none."""
    from scipy.optimize import brentq

    if slack(1.0) >= 0.0:
        return math.inf
    if slack(_LEAST) < 0.0:
        return 0.0
    found: Any = brentq(slack, _LEAST, 1.0, xtol=1e-15)
    return float(found)


def _on_axis(A: np.ndarray, D: float) -> float:
    """Where poles ±iω on the axis break the small gain: 2 sin(ωΔ/2) = 1."""
    poles = np.linalg.eigvals(A)
    near = np.abs(np.real(poles)) * D <= SLOW
    fastest = float(np.abs(np.imag(poles[near])).max(initial=0.0)) * D
    limit = math.pi / (3.0 * fastest) if fastest > SLOW else math.inf
    return limit if limit < 1.0 else math.inf


def _unstable(A: np.ndarray, B: np.ndarray, slow: float) -> tuple[np.ndarray, np.ndarray]:
    """A₊ (k, k) and B₊ (k, m): QᵀA = A₊Qᵀ and B₊ = QᵀB for the eigenvalues right of `slow`."""
    from scipy.linalg import schur

    found: Any = schur(A.T, sort=lambda re, im: re > slow)
    triangle, Q, count = found
    return np.ascontiguousarray(triangle[:count, :count].T), Q[:, :count].T @ B


def _small_gain(A: np.ndarray, B: np.ndarray, D: float, Delta: float) -> float:
    """≥ 0 where some linear controller has ‖W T‖ ≤ 1."""
    from scipy.linalg import expm

    return _interpolable(A, B, delay_weight(A * Delta) @ expm(A * D) @ B)


def _together(A: np.ndarray, B: np.ndarray, D: float, Delta: float) -> float:
    """≥ 0 where one input could do: all poles at once."""
    from scipy.linalg import expm

    if np.any(_beyond(np.linalg.eigvals(A) * Delta)):
        return -1.0
    free = np.linalg.solve(half_angle_weight(A * Delta), _half_angle(A * Delta))
    return _interpolable(A, B, free @ expm(A * (D - Delta)) @ B)


def _apart(A: np.ndarray, B: np.ndarray, D: float, Delta: float) -> float:
    """≥ 0 where several inputs could do: each pole by itself."""
    poles = np.linalg.eigvals(A).astype(complex)
    if np.any(_beyond(poles * Delta)):
        return -1.0
    free = [
        _half_angle(q) @ np.linalg.inv(half_angle_weight(q)) for q in poles[:, None, None] * Delta
    ]
    return float(1.0 - np.max(np.abs(np.ravel(free) * np.exp(poles * (D - Delta)))))


def _beyond(v: np.ndarray) -> np.ndarray:
    """On [1, ∞), where √(1 − v) is not defined."""
    return (np.abs(np.imag(v)) <= 1e-12 * np.abs(v)) & (np.real(v) >= 1.0)


def _interpolable(A: np.ndarray, B: np.ndarray, C: np.ndarray) -> float:
    """≥ 0 where a function of H∞ norm ≤ 1 takes B to C at A: the Pick matrix X₁ − X₂ ≥ 0."""
    from scipy.linalg import eigh, solve_continuous_lyapunov

    if not np.isfinite(C).all():
        return -1.0
    X1 = solve_continuous_lyapunov(A, B @ B.T)
    X2 = solve_continuous_lyapunov(A, C @ C.T)
    largest = eigh(0.5 * (X2 + X2.T), 0.5 * (X1 + X1.T), eigvals_only=True)[-1]
    return float(1.0 - largest)


def _half_angle(v: np.ndarray) -> np.ndarray:
    """tan(½ asin v) = (√(1 + v) − √(1 − v))/(√(1 + v) + √(1 − v)) of a matrix."""
    from scipy.linalg import sqrtm

    one = np.eye(v.shape[0])
    plus, minus = (np.asarray(sqrtm(one + sign * v)) for sign in (1.0, -1.0))
    result = np.linalg.solve(plus + minus, plus - minus)
    return result if np.iscomplexobj(v) else result.real


def delay_weight(q: np.ndarray) -> np.ndarray:
    """W at q = pΔ: outer with |W(jx)| = 2 sin(x/2) for x < π and 2 beyond.

    W = q W₁, and log W₁(q) = (2/π) ∫₀^∞ ℓ(x) q/(q² + x²) dx with ℓ = log(2 sin(x/2)/x), log(2/x).

    Examples
    --------
    >>> delay_weight(np.array([[0.1]])).round(4)     # close to q itself while that is small
    array([[0.0963]])
    """
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
