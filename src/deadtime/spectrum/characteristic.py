"""The spectrum of the ideal loop with one mode held: its characteristic roots.

    dx/dt = A x(t) + Σ_j b_j u_j(t − D_j),    u(t) = F x(t) + ∫ w(τ) u(t − τ) dτ,    det Δ(s) = 0

(`deadtime.spectrum.ideal` has w and Δ). Its spectrum is of this kind:

- The loop is retarded, never neutral, whatever delays plant and law have. The input obeys a
  Volterra equation of the second kind whose kernel w is smooth on each of the law's windows
  [α, β] and has no atoms: u itself is not fed back at any time. Differentiated, it gives du/dt in
  terms of x(t), u(t − D_j), u(t − α), u(t − β) and an integral of u, with no derivative of the
  past (and m roots at 0 that the loop does not have).
- So W(s) = O(1/|s|) to the right of any line, det Δ(s) = sⁿ (1 + O(1/|s|)), and only finitely
  many roots lie there; the others form chains that go left like −ln|s|/D. A small error of a
  delay does not shift infinitely many roots across the axis, but it may shift many: where the
  loop's gain at the end of a window, C e^{S(β−α)} R, is large, those with |s| up to twice its size.
- At least one root exists: det Δ is entire, of exponential type, and ~ sⁿ to the right. Without
  any root it would be e^{a + bs}; with finitely many it is a polynomial of degree n. The growth
  rate of the ideal loop is therefore never −∞, as that of a digital loop can be.
- Under the exact law of a plant's own mode and delays the spectrum is the n eigenvalues of A + BK,
  no more. Along a motion of the loop the prediction is true, x̂(t + θ) = x(t + θ): up to the
  shortest delay all inputs are in flight, and between two delays those that are not are K_j x̂,
  which is what the law, true so far, will send. So U_j = K_j e^{sD_j} X, of which K_j X arrives,
  and (sI − A − BK) X = 0; and every such X is a motion. With finitely many roots det Δ is a
  polynomial of degree n, so det Δ(s) = det(sI − A − BK), multiple roots by continuity in K. For
  one delay, one window [0, D] of S = A, R = B and C = K, e^{−sD} cancels:

      W(s) = K (sI − A)⁻¹ B − e^{−sD} F (sI − A)⁻¹ B.

Newton's method on det Δ, s ← s − 1/tr(Δ⁻¹Δ'), starts at eigenvalues of the generator on polynomials
and converges to round-off. The argument principle then counts the roots to the right of a line just
left of the last one found. If the numbers agree, no root is missing; if not, the degree goes up.
This is numerical evidence in double precision, not a proof.

References
----------
Michiels and Niculescu, Stability, Control, and Computation for Time-Delay Systems, SIAM 2014,
chapters 1 and 2. Breda, Maset and Vermiglio, Stability of Linear Delay Differential Equations,
Springer 2015. Mondié and Michiels, IEEE Trans. Automatic Control 48 (2003), on integrals that are
replaced by sums: there the loop does become neutral.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float

from deadtime.base.checks import count as checked_count
from deadtime.base.frozen import Frozen
from deadtime.feedback import Law
from deadtime.numerics.small_matrices import decompose, inverses
from deadtime.plant import SwitchedSystem
from deadtime.spectrum.held_mode_checks import check_mode
from deadtime.spectrum.ideal import IdealLoop, weights

_STEPS, _CIRCLE = 40, 8  # of Newton's method; points on a circle around a root
_CONVERGED = 1e-6  # relative: a double root has half of the digits only


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
    """The distance by which round-off δ in Δ may move each root.

    To first order it is |u|ᵀ δ |v| / |uᴴ Δ' v|, plus the last step of Newton's method. Roots close
    to each other move farther, a double one by √δ: the result is the radius of a circle on which
    ρ(|Δ⁻¹| δ) < 1, so that no change of Δ by δ moves a root across it. The radius grows from the
    first-order value until that holds.
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


MOST_POINTS = 400_000
_CHUNK = 20_000  # points whose matrices are in memory at a time


def count_right_of(loop: IdealLoop, line: float) -> int | None:
    """Roots with Re s > `line`; None on a line too close to a root or too long to be followed.

    With n poles p to the left of the line Re s = c, f(s) = det Δ(s)/(s − p)ⁿ has no pole on it or
    to its right, tends to 1 there, and is real on the real axis. So the number of roots to the
    right is the change of f's argument along the upper half of the line, in half turns:

        count = (arg f(c) − arg f(c + i∞))/π.

    The argument is followed over points so close that |f'/f| times their distance is below 1, up to
    the radius beyond which Y(s) = W(s) + F (sI − A)⁻¹ B diag(e^{−sD_j}) has |Y| < 1: there I − Y(s)
    has only eigenvalues of positive real part, and the rest up to infinity is the sum of their
    arguments.
    """
    radius = loop.radius(line)
    spacing = 1.0 / (float(loop.delays.max()) + loop.lead + 1.0 / radius)
    if not radius / spacing < MOST_POINTS:
        return None
    pole = line - loop.unit
    points = np.linspace(0.0, radius, int(radius / spacing) + 2)
    sign, rate = _values(loop, line + 1j * points, pole)
    while True:
        gap = np.diff(points)
        coarse = np.flatnonzero(~(np.maximum(rate[1:], rate[:-1]) * gap <= 1.0))
        if coarse.size == 0:
            break
        if points.size > MOST_POINTS or gap.min() < 1e-13 * (1.0 + abs(line)):
            return None
        middles = points[coarse] + gap[coarse] / 2.0
        more = _values(loop, line + 1j * middles, pole)
        both = zip((points, sign, rate), (middles, *more), strict=True)
        points, sign, rate = (np.insert(old, coarse + 1, new) for old, new in both)
    turn = float(np.angle(sign[1:] / sign[:-1]).sum())
    # Half: by symmetry only the upper half of the line is followed.
    half_turns = -(turn - _rest(loop, line + 1j * radius, pole)) / np.pi
    nearest = round(half_turns)
    return nearest if abs(half_turns - nearest) < 1e-3 else None


def _values(
    loop: IdealLoop, s: Complex[np.ndarray, " point"], pole: float
) -> tuple[Complex[np.ndarray, " point"], Float[np.ndarray, " point"]]:
    """f/|f| and |f'/f|."""
    n = loop.A.shape[0]
    sign, rate = np.empty(s.size, complex), np.empty(s.size)
    for start in range(0, s.size, _CHUNK):
        part = slice(start, start + _CHUNK)
        Delta, prime = loop.matrix(s[part])
        phase = np.linalg.slogdet(Delta)[0]
        lost = phase == 0.0  # exactly singular: a root on the line
        Delta[lost] = np.eye(Delta.shape[1])
        away = s[part] - pole
        sign[part] = np.where(lost, 1.0, phase) * (np.abs(away) / away) ** n
        slope = np.trace(np.linalg.solve(Delta, prime), axis1=1, axis2=2) - n / away
        rate[part] = np.where(lost, np.inf, np.abs(slope))
    return sign, rate


def _rest(loop: IdealLoop, end: complex, pole: float) -> float:
    """arg f at the end of the line, followed back from its limit 0 at infinity."""
    n = loop.A.shape[0]
    W = loop.memory(np.array([end]))[0][0]
    free = np.linalg.solve(end * np.eye(n) - loop.A, loop.B * np.exp(-end * loop.delays))
    fed = np.linalg.eigvals(np.eye(W.shape[0]) - W - loop.F @ free)
    open_loop = (end - np.linalg.eigvals(loop.A)) / (end - pole)
    return float(np.angle(fed).sum() + np.angle(open_loop).sum())


_CENTRE = 1.618  # of the plant's rate: an unlikely place for a root


def approximate_roots(loop: IdealLoop, degree: int) -> Complex[np.ndarray, " order"]:
    """Eigenvalues of the generator on polynomials of a degree, at most n + m·degree of them.

    The state of the loop is x(t) and u on [t − T, t], T the longest delay of plant and law.
    Shifting it in time is a semigroup with the generator

        (x, u) ↦ (A x + Σ_j b_j u_j(−D_j), du/dθ)    where    u(0) = F x + ∫ w(τ) u(−τ) dτ.

    A polynomial through u at Chebyshev points turns it into a matrix whose eigenvalues tend to the
    roots, faster than any power of the degree since eigenfunctions are exponentials: a degree a
    little above |s| T/2 resolves a root s. The other eigenvalues mean nothing, so all are polished
    and counted. One polynomial serves unequal delays, too: eigenfunctions are smooth at every −D_j
    and at the ends of the law's windows.

    The generator has entries of degree²/T, which may be larger than the plant's rates by any power
    of ten. So its inverse about a point σ of the plant's size is taken: roots of that size are its
    large eigenvalues 1/(s − σ), and keep their digits.
    """
    G, E = generator(loop, degree)
    centre = _CENTRE * loop.rate
    inverse = np.linalg.eigvals(np.linalg.solve(G - centre * np.diag(E), np.diag(E)))
    return centre + 1.0 / inverse[inverse != 0.0].astype(complex)


def generator(
    loop: IdealLoop, degree: int
) -> tuple[Float[np.ndarray, "order order"], Float[np.ndarray, " order"]]:
    """G and the diagonal of E: the generator is E⁻¹G on (x, u(θ_1), …, u(θ_degree)).

    u(0) is eliminated with the law's equation.
    """
    n, m = loop.B.shape
    longest = loop.longest
    nodes, derivative, barycentric = _chebyshev(degree)
    tau, taps = weights(loop.windows, loop.near + 2.0 * degree / longest)
    delays, effects = zip(*loop.pipes, strict=True)
    at = _interpolation(nodes, barycentric, 1.0 - 2.0 * np.append(tau, delays) / longest)
    window = np.tensordot(taps, at[: tau.size], ([0], [0])).transpose(2, 0, 1)  # by node (m, m)
    now = np.zeros((m, n + m * degree))
    now[:, :n] = loop.F
    now[:, n:] = window[1:].transpose(1, 0, 2).reshape(m, m * degree)
    now = np.linalg.solve(np.eye(m) - window[0], now)
    G = np.zeros((n + m * degree, n + m * degree))
    for row, B in zip(at[tau.size :], effects, strict=True):
        G[:n] += row[0] * (B @ now)
        G[:n, n:] += np.kron(row[1:], B)
    G[:n, :n] += loop.A
    slope = derivative[1:]
    G[n:] = np.kron(slope[:, :1], now)
    G[n:, n:] += np.kron(slope[:, 1:], np.eye(m))
    return G, np.repeat((1.0, 0.5 * longest), (n, m * degree))


def _chebyshev(degree: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points cos(jπ/degree), the matrix that differentiates there, barycentric weights."""
    angle = np.arange(degree + 1) * (np.pi / degree)
    nodes = np.cos(angle)
    barycentric = (-1.0) ** np.arange(degree + 1)
    barycentric[[0, -1]] /= 2.0
    # x_i − x_j = −2 sin((a_i + a_j)/2) sin((a_i − a_j)/2) keeps its digits where points crowd.
    half = angle / 2.0
    apart = -2.0 * np.sin(half[:, None] + half) * np.sin(half[:, None] - half)
    np.fill_diagonal(apart, 1.0)
    derivative = barycentric / barycentric[:, None] / apart
    np.fill_diagonal(derivative, 0.0)
    np.fill_diagonal(derivative, -derivative.sum(axis=1))
    return nodes, derivative, barycentric


def _interpolation(nodes: np.ndarray, barycentric: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Rows that evaluate the polynomial through values at the nodes."""
    apart = at[:, None] - nodes
    hit = np.abs(apart) < 1e-15
    ratio = barycentric / np.where(hit, 1.0, apart)
    rows = ratio / ratio.sum(axis=1, keepdims=True)
    return np.where(hit.any(axis=1, keepdims=True), hit, rows).astype(float)


_FIRST, _FACTOR, _MOST_ORDER = 24, 1.5, 600
_CLOSE = 0.1  # of the loop's unit: the largest distance of a polished root from its eigenvalue
_APART = 1e-10  # relative: the least distance of two roots with a line between them


@dataclass(frozen=True, eq=False)
class CharacteristicRoots(Frozen):
    """The rightmost characteristic roots of a loop (immutable).

    Attributes
    ----------
    roots : (roots,) complex
        In 1/s, rightmost first, conjugates next to each other, multiple ones repeated.
    residuals : (roots,)
        The smallest singular value of Δ there over the largest, rows and columns scaled alike.
    errors : (roots,)
        The estimated effect of round-off in Δ on each root, 1/s. Large gains over the delay cost
        digits: about :math:`|e^{A D}|^2` times round-off with an exact law.
    line : float
        The roots to the right of Re s = `line` were counted, 1/s.
    complete : bool
        Whether their number is that of `roots`: there are no others right of the line. Numerical
        evidence, by the argument principle in double precision.
    """

    roots: Complex[np.ndarray, " root"]
    residuals: Float[np.ndarray, " root"]
    errors: Float[np.ndarray, " root"]
    line: float
    complete: bool


def characteristic_roots(
    plant: SwitchedSystem, law: Law, mode: int, count: int = 6
) -> CharacteristicRoots:
    """The rightmost characteristic roots of the ideal loop under a constant switching signal.

    Parameters
    ----------
    plant : SwitchedSystem
        The true plant. The law has a model of its own, `law.plant`, which may differ.
    law : Law
        A law with a closed form in continuous time. If it depends on the age of the mode, the mode
        has been held throughout; for an oracle no switch follows.
    mode : int
        The mode.
    count : int
        The least number of roots. Conjugate pairs and roots too close to be separated are not
        split; fewer are returned if there are no more.

    Returns
    -------
    CharacteristicRoots
        `.roots`, `.residuals`, `.errors`, `.line`, `.complete`.

    Raises
    ------
    ArgumentError
        If the law and the plant do not belong together, the law has no closed form in continuous
        time, or it assumes a signal of its own that switches.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> law = dt.SingleModePredictor(problem.plant, problem.gains, mode=0)
    >>> found = dt.characteristic_roots(problem.plant, law, mode=0)
    >>> found.roots.real.round(9), found.complete      # the poles that were placed, and no others
    (array([-1., -2.]), True)
    >>> wrong = dt.SwitchedSystem(problem.plant.A, problem.plant.B, delay=1.02)
    >>> dt.characteristic_roots(wrong, law, mode=0, count=2).roots.round(3)
    array([0.35+18.861j, 0.35-18.861j])
    """
    mode = check_mode(plant, law, mode)
    return rightmost(IdealLoop.of(plant, law, mode), checked_count("count", count))


def rightmost(loop: IdealLoop, wanted: int) -> CharacteristicRoots:
    """At least `wanted` of the rightmost roots of a loop, or all if there are fewer."""
    n, m = loop.B.shape
    degree, before = _FIRST, -1
    while True:
        upper, residuals = _polish(loop, approximate_roots(loop, degree), wanted)
        count, line = _leading_count(upper, wanted, loop.unit)
        upper, residuals = upper[:count], residuals[:count]
        repeat = np.where(np.imag(upper) == 0.0, 1, 2)
        roots = np.repeat(upper, repeat)
        second = np.cumsum(repeat)[repeat == 2] - 1
        roots[second] = roots[second].conj()
        # Fewer than wanted may be all: accepted if a higher degree shows no more.
        enough = roots.size >= wanted or roots.size == before > 0
        complete = enough and count_right_of(loop, line) == roots.size
        degree, before = int(_FACTOR * degree), roots.size
        if complete or n + m * degree > _MOST_ORDER:
            residuals = np.repeat(residuals, repeat)
            return CharacteristicRoots(roots, residuals, errors(loop, roots), line, complete)


def _polish(
    loop: IdealLoop, seeds: Complex[np.ndarray, " order"], wanted: int
) -> tuple[Complex[np.ndarray, " root"], Float[np.ndarray, " root"]]:
    """Roots in the upper half plane close to an eigenvalue, rightmost first, and residuals."""
    unit = loop.unit
    seeds = seeds[(np.imag(seeds) >= 0.0) & (np.real(seeds) >= _round_off(loop))]
    seeds = seeds[np.argsort(-np.real(seeds), kind="stable")][: 2 * wanted + 12]
    roots, residuals = newton(loop, seeds)
    moved = np.abs(roots - seeds)
    kept: list[int] = []
    for i in np.argsort(moved):
        # Two distant eigenvalues cannot both approximate one root: the nearer one has come first.
        twice = any(
            abs(roots[i] - roots[k]) <= 1e-8 * (abs(roots[k]) + unit)
            and abs(seeds[i] - seeds[k]) > 1e-3 * unit
            for k in kept
        )
        if moved[i] <= _CLOSE * unit and residuals[i] < np.inf and not twice:
            kept.append(int(i))
    kept.sort(key=lambda i: -roots[i].real)
    return roots[kept], residuals[kept]


def _round_off(loop: IdealLoop) -> float:
    """The line left of which e^{−sD} amplifies round-off so much that spurious roots appear."""
    gain = np.linalg.norm(loop.F) * np.linalg.norm(loop.B)
    gain += sum(np.linalg.norm(w.ending) * np.linalg.norm(w.R) for w in loop.windows)
    allowed = 1e-4 / (np.finfo(float).eps * (1.0 + loop.longest * gain))
    return -math.log(max(float(allowed), 1e2)) / loop.longest


def _leading_count(
    upper: Complex[np.ndarray, " root"], wanted: int, unit: float
) -> tuple[int, float]:
    """How many of `upper` make `wanted` roots, with conjugates; a line left of the last of them."""
    line, have = -np.inf, 0
    for i, root in enumerate(upper):
        have += 1 if root.imag == 0.0 else 2
        gap = root.real - upper[i + 1].real if i + 1 < upper.size else np.inf
        line = float(root.real - min(gap, unit) / 2.0)
        if have >= wanted and gap > _APART * (abs(root) + unit):
            return i + 1, line
    return upper.size, line
