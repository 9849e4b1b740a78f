"""Gains for every mode, in the paper's sign u = +K x: design and checks of arguments.

python-control's and SciPy's own functions give u = −K x; here A_i + B_i K_i has the poles.

With a step the gains are designed for the loop at that period. A predictor law holds u_k = K P_k,
P_k = x(t_k + D); over [t_k + D, t_{k+1} + D) only u_k acts on the plant, so

    P_{k+1} = (Φ + Γ K) P_k,    Φ = e^{Ah},  Γ = ∫₀^h e^{As} ds B:

without a delay. The poles are e^{ph}, and the cost from time D on is a sum over periods.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import positive, read_only, real_array, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.gains.pole_placement import place_pair, pole_lists, reachable, require_controllable
from deadtime.plant import SwitchedSystem
from deadtime.plant.discretisation import finite_discretisation, quotient, quotient_poles
from deadtime.plant.weight import weight_matrix


def check_gains(
    plant: SwitchedSystem, gains: object, allow_unstable: bool
) -> Float[np.ndarray, "mode m n"]:
    """`gains` as a (modes, m, n) array; without `allow_unstable` every A_i + B_i K_i is Hurwitz."""
    K = real_array("gains", gains, "(modes, m, n)", 3)  # pyright: ignore[reportArgumentType]
    if K.shape[0] != plant.modes:
        raise ArgumentError(
            f"gains must hold one (m, n) matrix per mode, {plant.modes}, got {K.shape[0]}: "
            "they may be the gains of another plant."
        )
    for i in range(plant.modes):
        require_shape(f"gains[{i}]", K[i], (plant.inputs, plant.states), "(m, n)")
        require_hurwitz(f"gains[{i}]", f"mode {i}", plant.A[i], plant.B[i], K[i], allow_unstable)
    return K


def require_hurwitz(
    name: str, place: str, A: np.ndarray, B: np.ndarray, K: np.ndarray, allow_unstable: bool
) -> None:
    """Refuse a gain that leaves A + B K unstable, unless that is allowed."""
    rightmost = rightmost_eigenvalue(name, place, A, B, K)
    if rightmost >= 0.0 and not allow_unstable:
        constant = ~(A.any(axis=1) | B.any(axis=1))
        moving = (A + B @ K)[np.ix_(~constant, ~constant)]
        if constant.any() and np.linalg.eigvals(moving).real.max(initial=-1.0) < 0.0:
            which = ", ".join(f"x[{j}]" for j in np.flatnonzero(constant))
            raise ArgumentError(
                f"{name} cannot make A + B K of {place} decay: {which} never moves (its rows of A "
                "and B are 0), as the disturbance and the reference in `Servo.plant`. The rest "
                "decays: allow_unstable = True accepts it."
            )
        raise ArgumentError(
            f"{name} leaves A + B K of {place} unstable (rightmost eigenvalue at "
            f"{rightmost:+.4g} 1/s): the sign is u = +K x, and gains belong to one plant; "
            "allow_unstable = True accepts it, as gains designed for a long step may need, and so "
            "may loops that are stable only with their delay."
        )


def rightmost_eigenvalue(
    name: str, place: str, A: np.ndarray, B: np.ndarray, K: np.ndarray
) -> float:
    """The largest real part of an eigenvalue of A + B K, 1/s; an error if A + B K overflows."""
    with np.errstate(over="ignore", invalid="ignore"):
        loop = A + B @ K
    if not np.isfinite(loop).all():
        raise ArgumentError(
            f"{name} must keep A + B K of {place} below 1.8e308, got entries up to "
            f"{np.abs(K).max():.3g}: measure states or inputs in other units."
        )
    return float(np.linalg.eigvals(loop).real.max())


def place(
    plant: SwitchedSystem,
    poles: ArrayLike | Sequence[ArrayLike],
    step: float | None = None,
    allow_unstable: bool = False,
) -> Float[np.ndarray, "mode m n"]:
    r"""Gains that place the poles of :math:`A_i + B_i K_i`, or of the loop run at a period.

    Parameters
    ----------
    plant : SwitchedSystem
        The plant; every mode must be controllable.
    poles : array_like, shape (n,) or (modes, n)
        Poles for all modes, or one list per mode, in 1/s; complex ones with their conjugates.
    step : float, optional
        Sampling period h, in seconds: :math:`\Phi_i + \Gamma_i K_i` then has the poles
        :math:`e^{p h}` (see the module), and the exact predictor of a mode, run at this period,
        decays as the poles say. Such gains need not make :math:`A_i + B_i K_i` Hurwitz where h is
        long.
    allow_unstable : bool
        Accept poles that do not decay.

    Returns
    -------
    (modes, m, n) array
        K of u = +K x. With several inputs the gains are chosen for robustness (SciPy's
        `place_poles`).

    Raises
    ------
    ArgumentError
        If a mode is not controllable, or not when sampled; a pole does not decay, is repeated
        more often than the rank of B, lacks its conjugate or oscillates faster than the samples;
        or the placement fails its own check.

    Examples
    --------
    >>> import deadtime as dt
    >>> dt.place(dt.problems.paper().plant, [-1, -2]).round(4)
    array([[[-12.    ,  -6.    ]],
    <BLANKLINE>
           [[-12.6961,  -6.3725]]])
    >>> plant = dt.problems.paper().plant
    >>> law = dt.SingleModePredictor(plant, dt.place(plant, [-1, -2], step=0.2), mode=0)
    >>> round(dt.growth_rate(plant, law, mode=0, step=0.2), 6)
    -1.0
    """
    wanted = pole_lists(poles, plant.modes, plant.states)
    for i, row in enumerate(wanted):
        if (fastest := row[np.argmax(row.real)]).real >= 0.0 and not allow_unstable:
            hint = f"; write {_text_of(-fastest)} for one that does" if fastest.real else ""
            raise ArgumentError(
                f"poles of mode {i} must have negative real parts, got {_text_of(fastest)}: a loop "
                f"with this pole does not decay{hint}."
            )
    step = None if step is None else positive("step", step)
    return np.stack([_place_mode(plant, i, wanted[i], step) for i in range(plant.modes)])


def _text_of(pole: complex) -> str:
    """A pole as text, a real one without its imaginary part."""
    return f"{pole.real:g}" if pole.imag == 0.0 else f"{pole:g}"


def _place_mode(plant: SwitchedSystem, i: int, poles: np.ndarray, step: float | None) -> np.ndarray:
    A, B = plant.A[i], plant.B[i]
    require_controllable(A, B, i)
    if step is None:
        return place_pair(A, B, poles, i)
    wanted = quotient_poles(poles, step, i)
    A, B = quotient(A, B, step)
    if reachable(A, B) < len(A):
        raise ArgumentError(
            f"mode {i} is not controllable when sampled every {step:g} s: eigenvalues whose "
            f"imaginary parts differ by a multiple of 2π/h = {2.0 * np.pi / step:.4g} 1/s look "
            "alike; change the step a little."
        )
    return place_pair(A, B, wanted, i, given=poles)


def lqr(
    plant: SwitchedSystem, Q: ArrayLike, R: ArrayLike, step: float | None = None
) -> Float[np.ndarray, "mode m n"]:
    """Gains that minimise a quadratic cost in each mode, without delay and switching.

    Parameters
    ----------
    plant : SwitchedSystem
        The plant.
    Q : array_like, shape (n, n), (n,) or a number
        State weight, positive semidefinite: a matrix, its diagonal, or a number times the identity.
    R : array_like, shape (m, m), (m,) or a number
        Input weight, likewise, positive definite.
    step : float, optional
        Sampling period h, in seconds: the same integral is minimised over inputs that are held,
        exact between samples, too (C. Van Loan 1978). For an exact predictor it is the cost from
        time D on. Such gains need not make :math:`A_i + B_i K_i` Hurwitz if h is long.

    Returns
    -------
    (modes, m, n) array
        K of u = +K x.

    Raises
    ------
    ArgumentError
        If a weight is not symmetric or not definite, or a mode has no stabilising solution.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[0.0]], [[1.0]]], [[[1.0]], [[1.0]]], delay=1.0)
    >>> dt.lqr(plant, Q=1.0, R=1.0).ravel().round(4)      # −1 and −(1 + √2)
    array([-1.    , -2.4142])
    >>> dt.lqr(plant, Q=[[1.0]], R=[[1.0]], step=0.1).ravel().round(4)
    array([-0.952 , -2.2544])
    """
    Q = weight_matrix("Q", Q, plant.states, "n")
    R = weight_matrix("R", R, plant.inputs, "m", strict=True)
    if step is None:
        return np.stack([_lqr_mode(plant, i, Q, R) for i in range(plant.modes)])
    step = positive("step", step)
    return np.stack([_sampled_lqr_mode(plant, i, Q, R, step) for i in range(plant.modes)])


def _lqr_mode(plant: SwitchedSystem, i: int, Q: np.ndarray, R: np.ndarray) -> np.ndarray:
    from scipy.linalg import solve_continuous_are

    A, B = plant.A[i], plant.B[i]
    try:
        X = solve_continuous_are(A, B, Q, R)
    except ValueError:  # LinAlgError among them
        X = np.full_like(A, np.nan)
    with np.errstate(over="ignore", invalid="ignore"):
        K = -np.linalg.solve(R, B.T @ X)
        loop = A + B @ K
        residual = np.linalg.norm(A.T @ X + X @ A + X @ B @ K + Q)
        size = np.linalg.norm(Q) + 2.0 * np.linalg.norm(A) * np.linalg.norm(X)
    # SciPy may return a solution of no use without an error, where Q hides an unstable state.
    stable = np.isfinite(loop).all() and np.linalg.eigvals(loop).real.max() < 0.0
    if not stable or not residual <= 1e-8 * size < np.inf:
        raise _no_gain(i)
    return K


def _sampled_lqr_mode(
    plant: SwitchedSystem, i: int, Q: np.ndarray, R: np.ndarray, step: float
) -> np.ndarray:
    """The solution of the discrete Riccati equation with a cross term, checked by its residual."""
    from scipy.linalg import solve_discrete_are

    from deadtime.numerics.exponential import gramian

    A, B = plant.A[i], plant.B[i]
    n = A.shape[0]
    Phi, Gamma = finite_discretisation(A, B, step)
    M = gramian(A, B, step, read_only(Q))
    M[n:, n:] += step * R
    try:
        X = solve_discrete_are(Phi, Gamma, M[:n, :n], M[n:, n:], s=M[:n, n:])
    except ValueError:  # LinAlgError among them
        X = np.full_like(A, np.nan)
    L = np.hstack((Phi, Gamma))
    W = M + L.T @ X @ L
    if not np.isfinite(W).all():
        raise _no_gain(i)
    K = -np.linalg.solve(W[n:, n:], W[n:, :n])
    residual = np.linalg.norm(W[:n, :n] + W[:n, n:] @ K - X)
    stable = np.abs(np.linalg.eigvals(Phi + Gamma @ K)).max() < 1.0
    if not stable or residual > 1e-8 * np.linalg.norm(W[:n, :n]):
        raise _no_gain(i)
    return K


def _no_gain(i: int) -> ArgumentError:
    return ArgumentError(
        f"mode {i} has no stabilising LQR gain: it must be stabilisable, and Q must weigh "
        "its unstable and undamped states."
    )
