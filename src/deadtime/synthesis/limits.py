"""The limits of the delay margin of any linear controller, mode by mode.

The loop at the plant's input has the complementary sensitivity T(s) = e^{−sD} T̃(s), T̃ stable. An
unstable part of the plant (A₊, B₊) fixes T̃ there; a true delay D + δ turns I into
I + (e^{−sδ} − 1) T. docs/theory/delay-margin.md derives, for all |δ| < Δ:

Reached by some linear controller (small gain), with the outer W of |W(jω)| = max |e^{−jωδ} − 1|:

    X₂ ≤ X₁,    A₊X₁ + X₁A₊ᵀ = B₊B₊ᵀ,    A₊X₂ + X₂A₊ᵀ = C Cᵀ,    C = W(A₊) e^{A₊D} B₊

No linear, time-invariant, continuous controller reaches Δ, for one input, if the same inequality
with C = O(A₊)⁻¹ tan(½ asin(A₊Δ)) e^{A₊(D−Δ)} B₊ fails, or A₊Δ has an eigenvalue on [1, ∞); for
several inputs, if |tan(½ asin(pΔ)) e^{p(D−Δ)}| ≤ |O(p)| fails for an eigenvalue p. Here O is outer
with |O(jω)| = tan(π/4 + ¼ atan(ωΔ)).

If delays differ between inputs, a controller may delay the early ones. So a margin reached with the
longest delay for all inputs is reached; and one that is not reached with the shortest for all is
not reached, since with the shortest delays a controller could add the differences itself.

C = f(A₊) B₊ in each case, so X₂ = f(A₊) X₁ f(A₊)ᵀ: in coordinates in which X₁ = I the inequality is
‖f(A₊)‖ ≤ 1. Those of `_balance` need no X₁, which is singular to machine precision where poles
nearly coincide.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Complex, Float

from deadtime.base.checks import index, instance
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.gains.pole_placement import reachable
from deadtime.plant import SwitchedSystem

_POINTS = 12  # Gauss nodes of a panel
_SMALL = 1e-14  # |q| below which W = q and O = 1 to round-off


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


SLOW = 1e-6  # of 1/D: slower poles are ignored, with an error of that order
_LEAST = -700.0  # log of the smallest relative error, 1e-304
_LOST = 1e-9  # relative error of a direction of B₊ that is refused


@dataclass(frozen=True, eq=False)
class DelayLimit(Frozen):
    """Limits of the delay margin of one mode, whatever the controller (immutable).

    Relative to the delay; to the shortest of several, as `DelayMargin.relative`.

    Attributes
    ----------
    reached : float
        Some linear controller keeps the mode stable for all errors of the true delay below this,
        even if they differ between inputs (small gain: sufficient). ∞: for every error below 100 %.
    most : float
        No linear time-invariant controller does so for errors up to a larger value, common to all
        inputs (necessary).
    poles : (unstable poles,) complex
        The poles that set the limits, 1/s.
    """

    reached: float
    most: float
    poles: Complex[np.ndarray, " pole"]


def delay_limit(plant: SwitchedSystem, mode: int = 0) -> DelayLimit:
    """The limits of the relative delay margin of one mode for any linear controller.

    Parameters
    ----------
    plant : SwitchedSystem
        Its decaying poles need not be controllable.
    mode : int
        The mode.

    Returns
    -------
    DelayLimit
        To about 1e-9 relative. Without unstable poles `most` is ∞. Poles within 1e-6/D of the
        imaginary axis count as on it, and do not limit `most`. Below 1e-304 `reached` is 0 and
        `most` is 1e-304.

    Raises
    ------
    ArgumentError
        If an input is malformed; no input reaches a pole that is unstable or on the axis; or the
        poles of several inputs nearly coincide, so that rounding decides which input is whose.

    Notes
    -----
    Nothing is claimed between the two. They are farther apart if the delays of the mode's inputs
    differ: `reached` is that of its longest delay for all inputs, `most` that of its shortest. They
    hold for continuous controllers, the limit of digital ones for short periods. `most` does not
    cover time-varying controllers.

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
    delays, unit = plant.delays[mode], plant.shortest_delay
    shortest, longest = float(delays.min()), float(delays.max())
    slow = SLOW / longest
    _require_stabilisable(plant.A[mode], plant.B[mode], slow, mode)
    A, B = _unstable(plant.A[mode], plant.B[mode], slow)
    on_axis = _on_axis(plant.A[mode], longest, unit)
    if A.size == 0:
        return DelayLimit(on_axis, math.inf, np.empty(0, complex))
    A = _balance(A, B, mode)
    possible = _apart if B.shape[1] > 1 else _together
    # By small gain some linear controller has ‖W T‖ ≤ 1 where the logarithm is ≤ 0.
    reached = min(
        on_axis, _largest(lambda e: _log_norm(delay_weight(A * (e * unit)), A, longest), 0.0)
    )
    most = _largest(lambda error: possible(A, shortest, error * unit), math.exp(_LEAST))
    return DelayLimit(reached, most, np.sort_complex(np.diag(A)))


def _require_stabilisable(A: np.ndarray, B: np.ndarray, slow: float, mode: int) -> None:
    """Refuse an uncontrollable pole that is unstable, or counts as on the axis."""
    kept, input_of = _unstable(A, B, -slow)
    if kept.size and reachable(kept, input_of) < len(kept):
        poles = ", ".join(f"{pole:.4g}" for pole in np.linalg.eigvals(kept))
        raise ArgumentError(
            f"mode {mode} cannot be stabilised: no input reaches all of its poles {poles} 1/s that "
            "do not decay, so no controller has a delay margin."
        )


def _largest(excess: Callable[[float], float], below: float) -> float:
    """The relative error below 1 at which a condition (excess ≤ 0) fails; ∞ if it never does.

    Solved in its logarithm. `below` is the result if that is under _LEAST.
    """
    from scipy.optimize import brentq

    def at(logarithm: float) -> float:
        return min(excess(math.exp(logarithm)), 1e3)

    if at(0.0) <= 0.0:
        return math.inf
    if at(_LEAST) > 0.0:
        return below
    found: Any = brentq(at, _LEAST, 0.0, xtol=1e-14)
    return math.exp(found)


def _on_axis(A: np.ndarray, D: float, unit: float) -> float:
    """The error Δ/unit at which poles ±iω violate the small gain condition: 2 sin(ωΔ/2) = 1."""
    poles = np.linalg.eigvals(A)
    near = np.abs(np.real(poles)) * D <= SLOW
    fastest = float(np.abs(np.imag(poles[near])).max(initial=0.0)) * unit
    limit = math.pi / (3.0 * fastest) if fastest > SLOW else math.inf
    return limit if limit < 1.0 else math.inf


def _unstable(A: np.ndarray, B: np.ndarray, slow: float) -> tuple[np.ndarray, np.ndarray]:
    """A₊ (k, k) and B₊ (k, m): QᵀA = A₊Qᵀ and B₊ = QᵀB for the eigenvalues right of `slow`."""
    from scipy.linalg import schur

    found: Any = schur(A.T, sort=lambda re, im: re > slow)
    triangle, Q, count = found
    return np.ascontiguousarray(triangle[:count, :count].T), Q[:, :count].T @ B


def _together(A: np.ndarray, D: float, Delta: float) -> float:
    """≤ 0 if the condition for one input, on all poles at once, holds; A input-balanced."""
    v = A * Delta
    if np.any(_beyond(np.diag(v))):
        return math.inf
    return _log_norm(np.linalg.solve(half_angle_weight(v), half_angle(v)), A, D - Delta)


def _apart(A: np.ndarray, D: float, Delta: float) -> float:
    """≤ 0 if the condition for several inputs, on each pole separately, holds; A triangular."""
    poles = np.diag(A)
    return max(_together(pole[None, None], D, Delta) for pole in poles)


def _log_norm(weight: np.ndarray, A: np.ndarray, D: float) -> float:
    """log ‖weight · e^{AD}‖ without overflow."""
    from scipy.linalg import expm

    growth = D * float(np.real(np.diag(A)).max())
    norm = np.linalg.norm(weight @ expm(A * D - growth * np.eye(len(A))), 2)
    return float(np.log(norm)) + growth


def _beyond(v: np.ndarray) -> np.ndarray:
    """On [1, ∞), where √(1 − v) is not defined."""
    return (np.abs(np.imag(v)) <= 1e-12 * np.abs(v)) & (np.real(v) >= 1.0)


def _balance(A: np.ndarray, B: np.ndarray, mode: int) -> np.ndarray:
    """(k, k) complex, triangular: A₊ in coordinates in which X₁ = I, without solving for X₁.

    There A + Aᴴ = B Bᴴ, so that entry (i, j > i) is bᵢbⱼᴴ, and |bᵢ|² = 2 Re pᵢ: the poles and the
    directions of the rows of B determine A, with one input the poles alone. A row's direction is
    that of its rest after elimination of the rows below (S. Hammarling 1982): for the last one with
    b and U = [[U₁, v], [0, τ]] from the old coordinates to these, from A U = U (A + …),

        (A₁ + p̄) v = B₁ bᴴ − a τ,    the rest is (A₁, B₁ − v b).
    """
    from scipy.linalg import schur

    found: Any = schur(A, output="complex")
    T, Z = found
    poles, rows = np.diag(T), Z.conj().T @ B
    error = np.abs(Z.T) @ np.linalg.norm(B, axis=1) * np.finfo(float).eps
    b = np.zeros(rows.shape, complex)
    for n in reversed(range(len(T))):
        left = np.linalg.norm(rows[n])
        if B.shape[1] > 1 and error[n] > _LOST * left:
            raise ArgumentError(
                f"mode {mode} has unstable poles too close to each other, or to being "
                f"uncontrollable, for its several inputs: of the input to {poles[n]:.4g} 1/s only "
                f"{left:.1e} is its own; model close poles as one, or leave weak inputs out."
            )
        size = np.sqrt(2.0 * poles[n].real)
        b[n] = size * (rows[n] / left if B.shape[1] > 1 else 1.0)
        side = rows[:n] @ b[n].conj() - T[:n, n] * left / size
        v = np.linalg.solve(T[:n, :n] + poles[n].conj() * np.eye(n), side)
        error = error[:n] + np.finfo(float).eps * np.abs(v) * size
        rows = rows[:n] - v[:, None] * b[n]
    return np.diag(poles) + np.triu(b @ b.conj().T, 1)
