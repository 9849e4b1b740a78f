"""Gains and one common Lyapunov function found together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import positive
from deadtime.base.errors import InfeasibleError
from deadtime.base.frozen import Frozen
from deadtime.gains.lyapunov import SMALLEST, growth_in_norm
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
    """Gains for every mode and one P for all of them, with a decay rate under any switching.

        A_i X + B_i Y_i + (·)ᵀ + 2αX ≤ 0,   X > 0,   K_i = Y_i X⁻¹,   P = X⁻¹

    For the plant without its delay √(xᵀPx) then decays like e^{−αt}, however it switches. Of all
    solutions the one is taken that minimises max_i |K_i X^{1/2}|² + cond X, in units of |A| and
    |B|, with X ≥ I: the first term bounds the gains, the second the condition of P. Both
    enter the bounds on the allowed distance of the modes, and left free both tend to infinity.

    Parameters
    ----------
    plant : SwitchedSystem
        The plant; its delay plays no part.
    decay_rate : float
        α > 0, in 1/s.

    Returns
    -------
    JointDesign
        `.gains`, `.P` and the recomputed `.decay_rate` ≥ α.

    Raises
    ------
    ArgumentError
        If the decay rate is not positive.
    InfeasibleError
        If no such gains were found, with the solver's verdicts.
    SolverError
        If the solver does not work: then nothing is known.

    References
    ----------
    S. Boyd et al., Linear Matrix Inequalities in System and Control Theory, SIAM 1994,
    section 7.2.

    Examples
    --------
    >>> import deadtime as dt
    >>> from deadtime.gains.stabilization import stabilize
    >>> design = stabilize(dt.problems.paper().plant, decay_rate=0.5)
    >>> design.gains.shape, design.decay_rate >= 0.5
    ((2, 1, 2), True)
    """
    rate = positive("decay_rate", decay_rate, "1/s")
    t = balanced_units(plant.A)
    verdicts: list[Verdict] = []
    for units in (np.ones_like(t), t):
        # A solver meets an inequality up to its tolerance: ask for a little more, then for more.
        for margin in (1e-6, 1e-4, 1e-2):
            program, scale = _joint_program(plant, units, rate * (1.0 + margin))
            for verdict in attempts(program):
                design = _put_back(plant, units, verdict.x, scale)
                if design is not None and design.decay_rate >= rate:
                    return design
                missed = "" if verdict.x is None else ", but its answer misses the rate"
                verdicts.append(verdict._replace(said=verdict.said + missed))
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
    gains.flags.writeable = P.flags.writeable = False
    return JointDesign(gains, P, -growth_in_norm(plant, gains, P))
