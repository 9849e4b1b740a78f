"""The spectrum of the ideal loop with one mode held: its characteristic roots.

    dx/dt = A x(t) + Σ_j b_j u_j(t − D_j),    u(t) = F x(t) + ∫ w(τ) u(t − τ) dτ,    det Δ(s) = 0

(`deadtime.spectrum.ideal` has w and Δ). What kind of spectrum this is:

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

How roots are found: eigenvalues of the generator on polynomials start Newton's method on
det Δ, s ← s − 1/tr(Δ⁻¹Δ'), down to round-off. The argument principle then counts the roots to the
right of a line just left of the last one (`deadtime.spectrum.count`). As each root found is a
root, they are all of them if the numbers agree; if not, the degree goes up. That is numerical
evidence in double precision, not a proof.

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
from deadtime.plant import SwitchedSystem
from deadtime.spectrum.held_mode_arguments import check_mode
from deadtime.spectrum.ideal import IdealLoop
from deadtime.spectrum.newton import errors, newton

_FIRST, _FACTOR, _MOST_ORDER = 24, 1.5, 600
_CLOSE = 0.1  # of the loop's unit: how far a polished root may be from its eigenvalue
_APART = 1e-10  # relative, of roots between which a line can be drawn


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
        By how much round-off in Δ may have moved each root, estimated, 1/s. Large gains over the
        delay cost digits here: about |e^{AD}|² times round-off with an exact law.
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
        The truth. The law has a model of its own, `law.plant`; delays and matrices may differ.
    law : Law
        A law with a closed form in continuous time. One that tells ages apart is taken at a mode
        that has been held throughout; an oracle knows that nothing will switch.
    mode : int
        The mode.
    count : int
        How many roots at least. A conjugate pair is not split; roots too close to each other to
        be told apart are not either; and where there are no more, fewer are returned.

    Returns
    -------
    CharacteristicRoots
        `.roots`, `.residuals`, `.errors`, `.line`, `.complete`.

    Raises
    ------
    ArgumentError
        If the law and the plant do not belong together, the law has no closed form in continuous
        time, or it foresees a signal of its own that switches.

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
    """At least so many of the rightmost roots of a loop, where there are so many."""
    from deadtime.spectrum.chebyshev_roots import approximate_roots
    from deadtime.spectrum.count import count_right_of

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
        # Fewer than wanted may be all there are: if a higher degree shows no more.
        enough = roots.size >= wanted or roots.size == before > 0
        complete = enough and count_right_of(loop, line) == roots.size
        degree, before = int(_FACTOR * degree), roots.size
        if complete or n + m * degree > _MOST_ORDER:
            residuals = np.repeat(residuals, repeat)
            return CharacteristicRoots(roots, residuals, errors(loop, roots), line, complete)


def _polish(
    loop: IdealLoop, seeds: Complex[np.ndarray, " order"], wanted: int
) -> tuple[Complex[np.ndarray, " root"], Float[np.ndarray, " root"]]:
    """Roots in the upper half plane next to an eigenvalue, rightmost first, and residuals."""
    unit = loop.unit
    seeds = seeds[(np.imag(seeds) >= 0.0) & (np.real(seeds) >= _round_off(loop))]
    seeds = seeds[np.argsort(-np.real(seeds), kind="stable")][: 2 * wanted + 12]
    roots, residuals = newton(loop, seeds)
    moved = np.abs(roots - seeds)
    kept: list[int] = []
    for i in np.argsort(moved):
        # Two eigenvalues that do not belong together cannot both stand for one root.
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
    """To the left of this line e^{−sD} enlarges round-off so much that it has roots of its own."""
    gain = np.linalg.norm(loop.F) * np.linalg.norm(loop.B)
    gain += sum(np.linalg.norm(w.ending) * np.linalg.norm(w.R) for w in loop.windows)
    allowed = 1e-4 / (np.finfo(float).eps * (1.0 + loop.longest * gain))
    return -math.log(max(float(allowed), 1e2)) / loop.longest


def _leading_count(
    upper: Complex[np.ndarray, " root"], wanted: int, unit: float
) -> tuple[int, float]:
    """How many make so many, conjugates counted; and a line between the last one and the next."""
    line, have = -np.inf, 0
    for i, root in enumerate(upper):
        have += 1 if root.imag == 0.0 else 2
        gap = root.real - upper[i + 1].real if i + 1 < upper.size else np.inf
        line = float(root.real - min(gap, unit) / 2.0)
        if have >= wanted and gap > _APART * (abs(root) + unit):
            return i + 1, line
    return upper.size, line
