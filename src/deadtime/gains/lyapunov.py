"""Common Lyapunov functions xᵀPx of the delay-free loops A_i + B_i K_i, and gains found with them.

    (A_i + B_i K_i)ᵀ P + P (A_i + B_i K_i) ≤ −Q  for every mode i,   P = Pᵀ > 0, Q = Qᵀ > 0

Every P returned by this module is checked in its inequality: Q is recomputed from the eigenvalues
and lowered by a bound on their rounding errors, so the inequality holds for the matrices as stored.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import positive
from deadtime.base.errors import ArgumentError, InfeasibleError
from deadtime.base.frozen import Frozen
from deadtime.gains.state_feedback import check_gains, rightmost_eigenvalue
from deadtime.numerics.lmi import (
    Limit,
    Program,
    Verdict,
    answers_of,
    attempts,
    balanced_units,
    require_answer,
    symmetric_basis,
    symmetric_value,
)
from deadtime.plant import SwitchedSystem
from deadtime.plant.weight import weight_matrix

# A P of norm 1 with an eigenvalue below this is not known to be definite.
SMALLEST = 1e-13


@dataclass(frozen=True, eq=False)
class CommonLyapunov(Frozen):
    """One quadratic Lyapunov function for all modes (immutable).

    Attributes
    ----------
    P : (n, n) array
        Symmetric, positive definite.
    Q : (n, n) array
        Symmetric, positive definite, 1/s times the unit of P.

    References
    ----------
    arXiv 2503.08446, inequality (4).
    """

    P: Float[np.ndarray, "n n"]
    Q: Float[np.ndarray, "n n"]


def common_lyapunov(plant: SwitchedSystem, gains: ArrayLike) -> CommonLyapunov:
    r"""The common Lyapunov matrix of all modes, of norm 1, with the best decay.

    Solves: maximise :math:`q` subject to :math:`(A_i + B_i K_i)^T P + P (A_i + B_i K_i) \preceq -q
    I`, :math:`0 \preceq P \preceq I`. Among all pairs of (4) it has the largest
    :math:`\lambda_{\min}(Q)/|P|`, the ratio on which the paper's :math:`\varepsilon^*` depends.

    Parameters
    ----------
    plant : SwitchedSystem
        The plant; its delay plays no part.
    gains : array_like, shape (modes, m, n)
        :math:`K_i` of :math:`u = +K_i x`, every :math:`A_i + B_i K_i` Hurwitz.

    Returns
    -------
    CommonLyapunov
        `.P` with spectral norm 1 and `.Q` = q I, checked in the inequality. If the units of the
        states differ so much that no solver finds the largest q, any common P.

    Raises
    ------
    ArgumentError
        If the gains do not fit the plant or leave a mode unstable.
    InfeasibleError
        If no common P exists, with the solver's verdict.
    SolverError
        If no solver works, so that nothing is known.

    References
    ----------
    arXiv 2503.08446, inequality (4). S. Boyd et al., Linear Matrix Inequalities in System and
    Control Theory, SIAM 1994, section 5.1.

    Examples
    --------
    >>> import deadtime as dt
    >>> from deadtime.gains.lyapunov import common_lyapunov
    >>> problem = dt.problems.paper()
    >>> lyapunov = common_lyapunov(problem.plant, problem.gains)
    >>> lyapunov.Q.round(4).tolist()
    [[0.0582, 0.0], [0.0, 0.0582]]
    """
    K = hurwitz_gains(plant, gains)
    H = closed_loops(plant, K)
    verdicts: list[Verdict] = []
    t = balanced_units(H)
    as_given = np.ones_like(t)
    # The last problem gives the verdict: it has no solution when no common P exists.
    for program, units in ((_largest(H), as_given), (_any(H / t[:, None] * t), t)):
        verdicts.clear()
        for verdict in attempts(program):
            answer = symmetric_value(verdict.x, plant.states)
            if answer is not None:
                answer = answer / np.outer(units, units)
            found = put_back(plant, K, answer)
            if found is not None:
                return found
            missed = "" if answer is None else ", but it fails when put back"
            verdicts.append(verdict._replace(status=verdict.status + missed))
            if verdict.infeasible:
                break
    require_answer(verdicts)
    raise InfeasibleError(
        "no common P: no P > 0, Q > 0 found with (A_i + B_i K_i)ᵀP + P(A_i + B_i K_i) ≤ −Q for "
        f"all {plant.modes} modes at once ({answers_of(verdicts)}): choose gains and P together "
        "(stabilize), or rescale states whose units differ by many powers of ten."
    )


def hurwitz_gains(plant: SwitchedSystem, gains: ArrayLike) -> Float[np.ndarray, "mode m n"]:
    """`gains` as a (modes, m, n) array with every A_i + B_i K_i Hurwitz."""
    K = check_gains(plant, gains, allow_unstable=True)
    rightmost = [
        rightmost_eigenvalue(f"gains[{i}]", f"mode {i}", plant.A[i], plant.B[i], K[i])
        for i in range(plant.modes)
    ]
    worst = int(np.argmax(rightmost))
    if rightmost[worst] >= 0.0:
        raise ArgumentError(
            f"gains[{worst}] leaves A + B K of mode {worst} unstable (rightmost eigenvalue at "
            f"{rightmost[worst]:+.4g} 1/s), so no P exists: the sign is u = +K x; `place`, `lqr` "
            "or `stabilize` give gains that fit the plant."
        )
    return K


def decaying_lyapunov(
    plant: SwitchedSystem, gains: Float[np.ndarray, "mode m n"], decay_rate: float
) -> CommonLyapunov | None:
    """The best conditioned common P with (…)ᵀP + P(…) ≤ −2·decay_rate·P; None if none is found."""
    H, n = closed_loops(plant, gains), plant.states
    rate = 2.0 * decay_rate
    scale = np.linalg.norm(H, 2, axis=(1, 2)).max()
    E, bound, none = _unknowns(n)
    limits = [Limit(np.concatenate((E, none)), -np.eye(n))]
    limits += [Limit(np.concatenate((-E, bound)), np.zeros((n, n)))]
    for h in H:
        flow = (h.T @ E + E @ h + rate * E) / scale
        limits.append(Limit(np.concatenate((-flow, none)), np.zeros((n, n))))
    # One tolerance only: callers have other candidates for P.
    verdict = next(attempts(_least(limits)))
    return put_back(plant, gains, symmetric_value(verdict.x, n))


def check_lyapunov(
    plant: SwitchedSystem, gains: Float[np.ndarray, "mode m n"], lyapunov: object
) -> CommonLyapunov:
    """A user's P and Q, checked in the inequality; Q is lowered by a bound on rounding errors.

    `lyapunov` is a CommonLyapunov or a pair (P, Q), each a matrix, its diagonal or a number
    that multiplies the identity.
    """
    if isinstance(lyapunov, CommonLyapunov):
        lyapunov = (lyapunov.P, lyapunov.Q)
    if not isinstance(lyapunov, (tuple, list)) or len(lyapunov) != 2:
        raise ArgumentError(
            "lyapunov must be what common_lyapunov returns, or a pair (P, Q), "
            f"got {type(lyapunov).__name__}."
        )
    P = weight_matrix("lyapunov: P", lyapunov[0], plant.states, "n", strict=True)
    Q = weight_matrix("lyapunov: Q", lyapunov[1], plant.states, "n", strict=True)
    H = closed_loops(plant, gains)
    floor = _rounding(plant, gains, P)
    rest = [float(np.linalg.eigvalsh(-(h.T @ P + P @ h) - Q)[0]) - floor for h in H]
    worst = int(np.argmin(rest))
    # A Q from a Lyapunov equation meets the inequality up to rounding, which is accepted.
    excess = max(0.0, -rest[worst])
    if excess > 1e-8 * np.linalg.norm(Q, 2) + 2.0 * floor:
        raise ArgumentError(
            f"lyapunov: P and Q do not satisfy (A + B K)ᵀP + P(A + B K) ≤ −Q in mode {worst}: "
            f"the left side plus Q has an eigenvalue {excess:.4g} > 0: lower Q, or leave "
            "`lyapunov` out and let common_lyapunov find the pair."
        )
    Q = Q - excess * np.eye(plant.states)
    if np.linalg.eigvalsh(Q)[0] <= 0.0:
        raise ArgumentError(
            "lyapunov: Q is positive definite only up to rounding errors of the inequality "
            f"({excess:.1e}): give a better conditioned pair."
        )
    return CommonLyapunov(P, Q)


def closed_loops(
    plant: SwitchedSystem, gains: Float[np.ndarray, "mode m n"]
) -> Float[np.ndarray, "mode n n"]:
    """A_i + B_i K_i."""
    return plant.A + plant.B @ gains


def put_back(
    plant: SwitchedSystem, gains: Float[np.ndarray, "mode m n"], P: np.ndarray | None
) -> CommonLyapunov | None:
    """P scaled to norm 1 and its Q = q I, or None if P is no common Lyapunov matrix."""
    if P is None:
        return None
    largest = float(np.abs(np.linalg.eigvalsh(P)).max())
    if not 0.0 < largest < np.inf:
        return None
    P = P / largest
    floor = _rounding(plant, gains, P)
    if np.linalg.eigvalsh(P)[0] <= SMALLEST:
        return None
    # Q is recomputed: a solver meets its inequality only up to a tolerance.
    q = min(np.linalg.eigvalsh(-(h.T @ P + P @ h))[0] for h in closed_loops(plant, gains)) - floor
    return CommonLyapunov(P, q * np.eye(plant.states)) if q > 0.0 else None


def growth_in_norm(
    plant: SwitchedSystem, gains: Float[np.ndarray, "mode m n"], P: Float[np.ndarray, "n n"]
) -> float:
    """h with d/dt |x|_P ≤ h |x|_P along every delay-free loop, |x|_P² = xᵀPx, in 1/s.

    −h is the largest ω with (A_i + B_i K_i)ᵀP + P(A_i + B_i K_i) ≤ −2ωP for all i, less a
    bound on rounding errors.
    """
    L = np.linalg.cholesky(P)
    inverse = np.linalg.inv(L)
    worst = -np.inf
    for A, B, K in zip(plant.A, plant.B, gains, strict=True):
        G = L.T @ (A + B @ K) @ inverse.T
        worst = max(worst, float(np.linalg.eigvalsh((G + G.T) / 2.0)[-1]))
    condition = float(np.linalg.norm(L, 2) * np.linalg.norm(inverse, 2))
    return worst + _unit(plant) * condition * _size(plant, gains)


def _unknowns(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The coefficient matrices of the entries of P, of a bound, and of a bound that is absent."""
    return symmetric_basis(n), np.eye(n)[None], np.zeros((1, n, n))


def _least(limits: list[Limit], sign: float = 1.0) -> Program:
    """Minimise the last unknown, or its negative."""
    return Program(np.append(np.zeros(len(limits[0].M) - 1), sign), limits)


def _largest(H: np.ndarray) -> Program:
    """Maximise q: Hᵀ P + P H ≤ −q I, 0 ≤ P ≤ I. Always solvable, with q = 0 if there is no P."""
    n = H.shape[-1]
    (E, q, none), zero = _unknowns(n), np.zeros((n, n))
    H = H / np.linalg.norm(H, 2, axis=(1, 2)).max()
    limits = [Limit(np.concatenate((-E, none)), np.eye(n)), Limit(np.concatenate((E, none)), zero)]
    limits += [Limit(np.concatenate((-(h.T @ E + E @ h), -q)), zero) for h in H]
    return _least(limits, -1.0)


def _any(H: np.ndarray) -> Program:
    """Minimise |P|: Hᵀ P + P H ≤ −I. Infeasible if and only if there is no common P."""
    n = H.shape[-1]
    (E, bound, none), zero = _unknowns(n), np.zeros((n, n))
    H = H / np.linalg.norm(H, 2, axis=(1, 2)).max()
    limits = [Limit(np.concatenate((-E, bound)), zero), Limit(np.concatenate((E, none)), zero)]
    limits += [Limit(np.concatenate((-(h.T @ E + E @ h), none)), -np.eye(n)) for h in H]
    return _least(limits)


def _unit(plant: SwitchedSystem) -> float:
    """A generous bound of the relative rounding error of eigenvalues of a three-matrix product."""
    return 16.0 * (plant.states + plant.inputs) ** 2 * float(np.finfo(float).eps)


def _size(plant: SwitchedSystem, gains: np.ndarray) -> float:
    """Bound of |A| + |B||K|, the size of what is rounded in A + B K."""
    spectral = [np.linalg.norm(M, 2, axis=(1, 2)) for M in (plant.A, plant.B, gains)]
    return float((spectral[0] + spectral[1] * spectral[2]).max())


def _rounding(plant: SwitchedSystem, gains: np.ndarray, P: np.ndarray) -> float:
    return 2.0 * _unit(plant) * _size(plant, gains) * float(np.linalg.norm(P, 2))


@dataclass(frozen=True, eq=False)
class JointDesign(Frozen):
    """Gains with the Lyapunov matrix that they share (immutable).

    Attributes
    ----------
    gains : (modes, m, n) array
        K_i of u = +K_i x.
    P : (n, n) array
        Common to all modes, of spectral norm 1: (A_i + B_i K_i)ᵀP + P(A_i + B_i K_i) ≤ −2αP.
    decay_rate : float
        α recomputed from `gains` and `P`, 1/s; at least what was asked for.
    """

    gains: Float[np.ndarray, "mode m n"]
    P: Float[np.ndarray, "n n"]
    decay_rate: float


def stabilize(plant: SwitchedSystem, decay_rate: float) -> JointDesign:
    r"""Gains for every mode and one P for all of them, with a decay rate under any switching.

    .. math::

        A_i X + B_i Y_i + (\cdot)^T + 2 \alpha X \preceq 0,
        \quad X \succ 0,
        \quad K_i = Y_i X^{-1},
        \quad P = X^{-1}

    For the plant without its delay :math:`\sqrt{x^T P x}` then decays like :math:`e^{-\alpha t}`
    under any switching. The solution minimises
    :math:`\max_i |K_i X^{1/2}|^2 + \text{cond}\, X`, in units of :math:`|A|` and :math:`|B|`, with
    :math:`X \succeq I`: the first term bounds the gains, the second the condition of :math:`P`.
    Both enter the bounds on the distance of the modes, and tend to infinity without this objective.

    Parameters
    ----------
    plant : SwitchedSystem
        The plant; its delay plays no part.
    decay_rate : float
        :math:`\alpha > 0`, in 1/s.

    Returns
    -------
    JointDesign
        `.gains`, `.P` and the recomputed `.decay_rate`, at least :math:`\alpha`.

    Raises
    ------
    ArgumentError
        If the decay rate is not positive.
    InfeasibleError
        If no such gains were found, with the solver's verdicts.
    SolverError
        If the solver does not work, so that nothing is known.

    References
    ----------
    S. Boyd et al., Linear Matrix Inequalities in System and Control Theory, SIAM 1994,
    section 7.2.

    Examples
    --------
    >>> import deadtime as dt
    >>> from deadtime.gains.lyapunov import stabilize
    >>> design = stabilize(dt.problems.paper().plant, decay_rate=0.5)
    >>> design.gains.shape, design.decay_rate >= 0.5
    ((2, 1, 2), True)
    """
    rate = positive("decay_rate", decay_rate, "1/s")
    t = balanced_units(plant.A)
    verdicts: list[Verdict] = []
    for units in (np.ones_like(t), t):
        # A solver meets an inequality up to its tolerance only, so the rate is raised step by step.
        for margin in (1e-6, 1e-4, 1e-2):
            program, scale = _joint_program(plant, units, rate * (1.0 + margin))
            for verdict in attempts(program):
                design = _put_back(plant, units, verdict.x, scale)
                if design is not None and design.decay_rate >= rate:
                    return design
                missed = "" if verdict.x is None else ", but its answer misses the rate"
                verdicts.append(verdict._replace(status=verdict.status + missed))
                if verdict.infeasible:
                    break
    require_answer(verdicts)
    raise InfeasibleError(
        f"no gains with a common P and a decay rate of {rate:g} 1/s found for all {plant.modes} "
        f"modes at once ({answers_of(verdicts)}): lower `decay_rate` (every mode must be "
        "stabilisable with it), or rescale states whose units differ by many powers of ten."
    )


def _joint_program(plant: SwitchedSystem, units: np.ndarray, rate: float) -> tuple[Program, float]:
    """The LMI in units of |A| + α, |B| and the states; gains are in units of the last value.

    Minimise g + b subject to I ≤ X ≤ b I, A_i X + B_i Y_i + (…)ᵀ + 2α X ≤ 0 and
    [[X, Y_iᵀ], [Y_i, g I]] ≥ 0; the unknowns are the entries of X and of every Y_i, b and g.
    """
    n, m, modes = plant.states, plant.inputs, plant.modes
    A_units, B_units = plant.A / units[:, None] * units, plant.B / units[:, None]
    speed = float(np.linalg.norm(A_units, 2, axis=(1, 2)).max()) + rate
    size = float(np.linalg.norm(B_units, 2, axis=(1, 2)).max()) or 1.0
    basis, each = symmetric_basis(n), np.eye(m * n).reshape(m * n, m, n)
    unknowns = len(basis) + modes * m * n + 2
    X = slice(0, len(basis))
    identity, zero = np.eye(n), np.zeros((n, n))
    above, below = np.zeros((unknowns, n, n)), np.zeros((unknowns, n, n))
    above[X], below[X], below[-2] = basis, -basis, identity
    limits = [Limit(above, -identity), Limit(below, zero)]
    for i, (A, B) in enumerate(zip(A_units / speed, B_units / size, strict=True)):
        Y = slice(X.stop + i * m * n, X.stop + (i + 1) * m * n)
        flow, block = np.zeros((unknowns, n, n)), np.zeros((unknowns, n + m, n + m))
        flow[X], flow[Y] = A @ basis + rate / speed * basis, B @ each
        block[X, :n, :n], block[Y, n:, :n] = basis, each
        block[Y, :n, n:], block[-1, n:, n:] = each.transpose(0, 2, 1), np.eye(m)
        limits.append(Limit(-(flow + flow.transpose(0, 2, 1)), zero))
        limits.append(Limit(block, np.zeros((n + m, n + m))))
    return Program(np.append(np.zeros(unknowns - 2), [1.0, 1.0]), limits), speed / size


def _put_back(
    plant: SwitchedSystem, units: np.ndarray, x: np.ndarray | None, scale: float
) -> JointDesign | None:
    X = symmetric_value(x, plant.states)
    if x is None or X is None:
        return None
    n, m, modes = plant.states, plant.inputs, plant.modes
    Y = x[n * (n + 1) // 2 : -2].reshape(modes, m, n)
    if np.linalg.eigvalsh(X)[0] <= 0.0:
        return None
    gains = scale * np.stack([np.linalg.solve(X, y.T).T for y in Y]) / units
    P = np.linalg.inv(X) / np.outer(units, units)
    P = (P + P.T) / 2.0
    P /= np.linalg.norm(P, 2)
    if np.linalg.eigvalsh(P)[0] <= SMALLEST:
        return None
    return JointDesign(gains, P, -growth_in_norm(plant, gains, P))
