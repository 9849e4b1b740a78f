"""Observer gains: by pole placement, and the steady state of the Kalman filter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import instance, positive
from deadtime.base.errors import ArgumentError
from deadtime.estimation.observer import (
    Model,
    Observer,
    believed_plant,
    in_all_modes,
    output_matrices,
)
from deadtime.gains.pole_placement import place_pair, pole_lists, reachable, unseen_pole
from deadtime.numerics.covariance import noise_covariance
from deadtime.plant import SwitchedSystem
from deadtime.plant.sampling import finite_discretisation, quotient, quotient_poles
from deadtime.plant.weight import weight_matrix

_NEWTON = 3  # steps: from four digits to all


def luenberger(
    plant: SwitchedSystem,
    C: ArrayLike,
    poles: ArrayLike | Sequence[ArrayLike],
    step: float,
    *,
    model: Model = "modes",
) -> Observer:
    """An observer whose error decays as poles say, in every mode.

    The gain L_i gives the error matrix Φ_i (I − L_i C_i) the eigenvalues e^{ph}: with M = Φ_i L_i
    it is Φ_i − M C_i, the transpose of a state feedback.

    Parameters
    ----------
    plant : SwitchedSystem
        The model; every mode must be observable.
    C : array_like, shape (p, n) or (modes, p, n)
        What is measured, y = C_σ x.
    poles : array_like, shape (n,) or (modes, n)
        Poles of the error for all modes, or one list per mode, in 1/s.
    step : float
        Sampling period h, in seconds.
    model : "modes", "mean" or int
        What it predicts with: each mode in its turn, so that it must be told the mode; or, so that
        it needs none, the mean of all modes, or the mode of this number.

    Raises
    ------
    ArgumentError
        If a mode is not observable, or not at this period; the poles cannot be placed or do not
        decay; or one model is to have a C per mode.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[1.0]]], [[[1.0]]], delay=0.3)
    >>> observer = dt.luenberger(plant, [[1.0]], poles=[-2.0], step=0.1)
    >>> observer.gain.round(4)      # e^{0.1} (1 − L) = e^{−0.2}
    array([[[0.2592]]])

    With the mean as its model it reads no mode:

    >>> problem = dt.problems.paper()
    >>> one = dt.luenberger(problem.plant, [[1.0, 0.0]], [-4, -5], step=0.02, model="mean")
    >>> law = dt.AveragedPredictor(problem.plant, problem.gains)
    >>> dt.Controller(dt.OutputFeedback(law, one), step=0.02).update([1.0]).shape
    (1,)
    """
    instance("plant", plant, SwitchedSystem)
    modes, step = plant.modes, positive("step", step)
    plant, C = believed_plant(plant, output_matrices(C, plant), model)
    wanted = pole_lists(poles, plant.modes, plant.states)
    slowest = float(np.real(wanted).max())
    if slowest >= 0.0:
        raise ArgumentError(f"poles must have negative real parts, got {slowest:g}.")
    gain = []
    for i, (A, B) in enumerate(zip(plant.A, plant.B, strict=True)):
        _require_observable(A, C[i], i)
        asked = quotient_poles(wanted[i], step, i)
        slope = quotient(A, B, step)[0]
        if reachable(slope.T, C[i].T) < len(A):
            raise ArgumentError(
                f"mode {i} is not observable when sampled every {step:g} s: eigenvalues whose "
                f"imaginary parts differ by a multiple of 2π/h = {2.0 * np.pi / step:.4g} 1/s "
                "look alike; change the step a little."
            )
        M = -step * place_pair(slope.T, C[i].T, asked, i, "C", wanted[i]).T
        gain.append(np.linalg.solve(finite_discretisation(A, B, step)[0], M))
    plant, C, stacked = in_all_modes(plant, modes, C, np.stack(gain))
    return Observer(plant, C, stacked, step)


def kalman(
    plant: SwitchedSystem,
    C: ArrayLike,
    process: ArrayLike,
    measurement: ArrayLike,
    step: float,
    *,
    model: Model = "modes",
) -> Observer:
    """The steady-state Kalman filter of every mode.

        dx/dt = A_σ x + B_σ u(t − D) + w,    y_k = C_σ x(t_k) + v_k,

    w continuous white noise of intensity W, E w(t) w(s)ᵀ = W δ(t − s), and v_k white with
    covariance R. Over a period w leaves the covariance Q_d = ∫₀^h e^{As} W e^{Aᵀs} ds, and with
    the steady state P of

        P = Φ (I − L C) P Φᵀ + Q_d,    L = P Cᵀ (C P Cᵀ + R)⁻¹,

    `observer.prior` is P, the covariance of x − x̄ before a correction, and
    `observer.covariance` (I − L C) P, that of x − x̂ after it. In a mode that lasts no other
    observer has a smaller one. Just after a switch it is not optimal: the filter that is would
    carry its covariance along.

    Parameters
    ----------
    plant : SwitchedSystem
        The model; what a mode hides from C must decay.
    C : array_like, shape (p, n) or (modes, p, n)
        What is measured.
    process : array_like, shape (n, n)
        W, symmetric, positive semidefinite; it must reach every state that does not decay.
    measurement : array_like, shape (p, p)
        R, symmetric, positive definite.
    step : float
        Sampling period h, in seconds.
    model : "modes", "mean" or int
        As of `luenberger`. Of one model the covariances are those where the plant is it.

    Raises
    ------
    ArgumentError
        If a shape is wrong, a covariance is not definite, a mode has no stabilising gain, or one
        model is to have a C per mode.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[0.0]]], [[[1.0]]], delay=0.3)
    >>> observer = dt.kalman(plant, [[1.0]], process=[[1.0]], measurement=[[1.0]], step=1.0)
    >>> observer.gain.round(4).item()      # 1 over the golden ratio
    0.618
    """
    instance("plant", plant, SwitchedSystem)
    modes, step = plant.modes, positive("step", step)
    plant, C = believed_plant(plant, output_matrices(C, plant), model)
    W = weight_matrix("process", process, plant.states, "n", strict=False)
    R = weight_matrix("measurement", measurement, C.shape[1], "p", strict=True)
    found = [_filter(plant.A[i], C[i], W, R, step, i) for i in range(plant.modes)]
    designed = (np.stack(arrays) for arrays in zip(*found, strict=True))
    plant, C, gain, prior, covariance = in_all_modes(plant, modes, C, *designed)
    observer = Observer(plant, C, gain, step)
    prior.flags.writeable = covariance.flags.writeable = False
    vars(observer).update(prior=prior, covariance=covariance)
    return observer


def _filter(
    A: Float[np.ndarray, "n n"],
    C: Float[np.ndarray, "p n"],
    W: Float[np.ndarray, "n n"],
    R: Float[np.ndarray, "p p"],
    step: float,
    i: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """L, the covariance before a correction and after it; the Riccati equation put back.

    The residual is weighed by the standard deviations √P_jj, so that units of states do not matter.
    """
    require_detectable(A, C, i)
    identity = np.eye(len(A))
    Phi, noise = finite_discretisation(A, identity, step)[0], noise_covariance(A, W, step)
    try:
        P = _steady_state(Phi, C, noise, R)
    except ValueError:  # LinAlgError among them
        P = np.full_like(A, np.nan)
    if not np.isfinite(P).all():
        raise _no_filter(i)
    L = _gain_of(P, C, R)
    rest = identity - L @ C
    after = rest @ P @ rest.T + L @ R @ L.T
    unit = np.sqrt(np.maximum(np.diag(P), 0.0))
    wrong = np.abs(Phi @ after @ Phi.T + noise - P) > 1e-8 * np.outer(unit, unit)
    if wrong.any() or np.abs(np.linalg.eigvals(Phi @ rest)).max() >= 1.0 - 1e-9:
        raise _no_filter(i)
    return L, P, (after + after.T) / 2.0


def _steady_state(Phi: np.ndarray, C: np.ndarray, Q: np.ndarray, R: np.ndarray) -> np.ndarray:
    """P, by an eigenvalue method and Newton's, in units in which no number is far from others.

    Outputs are taken in units of their noise, and states in one unit s in which Q and Cᵀ R⁻¹ C are
    equally large, so that an intensity far below the noise of the sensors is not lost in round-off.
    The eigenvalue method still loses digits where states differ in size. A step of Newton's
    (Hewer, IEEE Trans. Automat. Control 16(4), 1971), a Lyapunov equation of the stable matrix
    Φ (I − L C), doubles them; there states are in units of their standard deviations √P_jj.
    """
    from scipy.linalg import solve_discrete_are, solve_discrete_lyapunov

    C = np.linalg.solve(np.linalg.cholesky(R), C)
    R = np.eye(len(C))
    process, sensed = np.trace(Q), np.sum(C**2)
    s = (process / sensed) ** 0.25 if process > 0.0 < sensed else 1.0
    P = s**2 * solve_discrete_are(Phi.T, s * C.T, Q / s**2, R)
    for _ in range(_NEWTON):
        L = _gain_of(P, C, R)
        loop = Phi - Phi @ L @ C
        if np.abs(np.linalg.eigvals(loop)).max() >= 1.0:
            break
        unit = np.sqrt(np.where(np.diag(P) > 0.0, np.diag(P), 1.0))
        added = (Phi @ L @ L.T @ Phi.T + Q) / np.outer(unit, unit)
        P = solve_discrete_lyapunov(loop / unit[:, None] * unit, added) * np.outer(unit, unit)
    return (P + P.T) / 2.0


def _gain_of(P: np.ndarray, C: np.ndarray, R: np.ndarray) -> np.ndarray:
    return np.linalg.solve(C @ P @ C.T + R, C @ P).T


def _no_filter(i: int) -> ArgumentError:
    return ArgumentError(
        f"mode {i} has no stabilising Kalman gain: `process` must reach every state that does "
        "not decay by itself (a constant disturbance needs some noise to drift)."
    )


def _rank_of(n: int, rank: int) -> str:
    powers = "; ".join(["C", "CA", *(f"CA^{k}" for k in range(2, n))][:n])
    return f"rank [{powers}] = {rank} < {n}"


def _require_observable(A: np.ndarray, C: np.ndarray, i: int) -> None:
    """Refuse a mode whose observability matrix lacks rank."""
    rank = reachable(A.T, C.T)
    if rank < len(A):
        raise ArgumentError(
            f"mode {i} is not observable: {_rank_of(len(A), rank)}: no gain can move all poles of "
            "its error; measure more, or use `kalman` if what is hidden decays."
        )


def require_detectable(A: np.ndarray, C: np.ndarray, i: int) -> None:
    """Refuse a mode that hides from C what does not decay."""
    value = unseen_pole(A, C)
    if value is not None:
        raise ArgumentError(
            f"mode {i} is not observable: {_rank_of(len(A), reachable(A.T, C.T))}, and what C does "
            f"not see (eigenvalue {value:.4g} 1/s) does not decay: measure more."
        )
