"""Switched observers at a period, and their gains: by pole placement, or the steady Kalman filter.

At every sample it corrects its prediction by the measurement and predicts the next sample,

    x̂_k = x̄_k + L_i (y_k − C_i x̄_k),                     i = σ(t_k) the sampled mode,
    x̄_{k+1} = Φ_i x̂_k + (the inputs in flight),

with the inputs as they reach the plant, u_{k−N} for φ and u_{k−N+1} for h − φ: a held input is
predicted exactly, whatever the delay. The law reads x̂_k, which includes y_k (the *filter* form).
Where the model is the plant and switches fall on samples the errors obey

    x_{k+1} − x̄_{k+1} = Φ_i (I − L_i C_i) (x_k − x̄_k),

for every law and every state: a switched linear system, in which the mode of a period selects the
matrix. After a switch between samples the rest of the period is
predicted with the mode of its start, an error in proportion to the state, which then decays.

An observer of *one model* has the same matrices in all modes, the mean's or those of one mode, and
so does not read the mode. The plant then differs from the model, and the error obeys

    x_{k+1} − x̄_{k+1} = Φ (I − L C) (x_k − x̄_k) + (Φ_i − Φ) x_k + (likewise for the inputs),

so that it decays only with the state and the inputs, and there is no separation; use
`growth_rate` and `certify` for the whole loop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import (
    as_floats,
    index,
    instance,
    positive,
    read_only,
    real_array,
    require_shape,
)
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.gains.pole_placement import place_pair, pole_lists, reachable, unseen_pole
from deadtime.numerics.covariance import noise_covariance
from deadtime.plant import SwitchedSystem
from deadtime.plant.discretisation import finite_discretisation, quotient, quotient_poles
from deadtime.plant.weight import weight_matrix

Model = str | int  # "modes", "mean", or the number of a mode


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Observer(Frozen):
    r"""A switched observer with a gain per mode (immutable).

    Parameters
    ----------
    plant : SwitchedSystem
        The model, its delay included.
    C : array_like, shape (p, n) or (modes, p, n)
        What is measured, :math:`y = C_\sigma x`; one matrix for all modes or one per mode.
    gain : array_like, shape (n, p) or (modes, n, p)
        :math:`L_i` of the correction (see the module); `luenberger` and `kalman` design it.
    step : float
        Sampling period h, in seconds.
    allow_unstable : bool
        Accept gains with which the error of a mode does not decay.

    Attributes
    ----------
    covariance : (modes, n, n) or None
        Of :math:`x - \hat x_k`, after the correction, in the steady state of a mode; of a Kalman
        filter.
    prior : (modes, n, n) or None
        Of :math:`x - \bar x_k`, before the correction.

    Raises
    ------
    ArgumentError
        If a shape is wrong, or the error of a mode does not decay.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.problems.paper().plant
    >>> observer = dt.luenberger(plant, [[1.0, 0.0]], poles=[-4.0, -5.0], step=0.1)
    >>> observer, observer.rates.round(6)
    (Observer(modes=2, states=2, outputs=1, step=0.1), array([-4., -4.]))
    """

    plant: SwitchedSystem
    C: Float[np.ndarray, "mode p n"]
    gain: Float[np.ndarray, "mode n p"]
    step: float
    covariance: Float[np.ndarray, "mode n n"] | None
    prior: Float[np.ndarray, "mode n n"] | None

    def __init__(
        self,
        plant: SwitchedSystem,
        C: ArrayLike,
        gain: ArrayLike,
        step: float,
        *,
        allow_unstable: bool = False,
    ) -> None:
        instance("plant", plant, SwitchedSystem)
        C = output_matrices(C, plant)
        gain = per_mode("gain", gain, plant.modes, (plant.states, C.shape[1]), "(n, p)")
        vars(self).update(
            plant=plant, C=C, gain=gain, step=positive("step", step), covariance=None, prior=None
        )
        worst = int(np.argmax(self.rates))
        if self.rates[worst] >= 0.0 and not allow_unstable:
            raise ArgumentError(
                f"gain[{worst}] leaves the estimation error of mode {worst} growing at "
                f"{self.rates[worst]:+.4g} 1/s: `luenberger` and `kalman` give gains that do not; "
                "allow_unstable = True accepts it."
            )

    @property
    def outputs(self) -> int:
        """Number of outputs, p."""
        return self.C.shape[1]

    @cached_property
    def reads_mode(self) -> bool:
        """Whether its estimate depends on the mode: False with one mode or one model for all."""
        plant = self.plant
        parts = (plant.A, plant.B, plant.delays, self.C, self.gain)
        return any(bool((part != part[:1]).any()) for part in parts)

    @cached_property
    def error_matrices(self) -> Float[np.ndarray, "mode n n"]:
        """Φ_i (I − L_i C_i): x_{k+1} − x̄_{k+1} from x_k − x̄_k over a period in mode i."""
        n = self.plant.states
        pairs = zip(self.plant.A, self.plant.B, strict=True)
        Phi = np.stack([finite_discretisation(A, B, self.step)[0] for A, B in pairs])
        return read_only(Phi @ (np.eye(n) - self.gain @ self.C))

    @cached_property
    def rates(self) -> Float[np.ndarray, " mode"]:
        """The growth rate of the error in each mode held, 1/s; negative for decay.

        If the model is right, the loop of plant, law and observer grows at the larger of this rate
        and the `growth_rate` of the law on the true state (separation). With one model for all
        modes that holds in the mode of the model alone.
        """
        radius = np.abs(np.linalg.eigvals(self.error_matrices)).max(axis=1)
        with np.errstate(divide="ignore"):  # −∞ of an error that is 0 after some periods
            return read_only(np.log(radius) / self.step)

    def __repr__(self) -> str:
        return (
            f"Observer(modes={self.plant.modes}, states={self.plant.states}, "
            f"outputs={self.outputs}, step={self.step:g})"
        )


def model_of(
    plant: SwitchedSystem, C: Float[np.ndarray, "mode p n"], model: Model
) -> tuple[SwitchedSystem, Float[np.ndarray, "model p n"]]:
    """The model of an observer, and its C: all modes, or one model for all."""
    if model == "modes":
        return plant, C
    if (C[:1] != C).any():
        raise ArgumentError(
            f"model = {model!r} needs one C for all modes: an observer that reads no mode cannot "
            "tell by which of several its outputs were measured."
        )
    if model == "mean":
        return plant.mean(), C[:1]
    if isinstance(model, str):
        raise ArgumentError(
            f'model must be "modes", "mean" or the number of a mode, got {model!r}.'
        )
    return plant.only([index("model", model, plant.modes)]), C[:1]


def in_all_modes(
    one: SwitchedSystem, modes: int, *parts: Float[np.ndarray, "model ..."]
) -> tuple[SwitchedSystem, *tuple[np.ndarray, ...]]:
    """A model and the gains designed for it, repeated for every mode if it has only one."""
    if one.modes == modes:
        return one, *parts
    whole = [np.tile(a, (modes,) + (1,) * (a.ndim - 1)) for a in (one.A, one.B, one.delays, *parts)]
    return one.like(*whole[:3]), *whole[3:]


def output_matrices(C: ArrayLike, plant: SwitchedSystem) -> Float[np.ndarray, "mode p n"]:
    """C as one (p, n) matrix per mode."""
    ndim = as_floats("C", C, "shape (p, n) or (modes, p, n)").ndim
    form = "(modes, p, n)" if ndim == 3 else "(p, n)"
    array = real_array("C", C, form, 3 if ndim == 3 else 2)
    if array.shape[-1] != plant.states:
        raise ArgumentError(
            f"C must have n = {plant.states} columns, shape (p, n) or (modes, p, n), got "
            f"{array.shape}."
        )
    return per_mode("C", array, plant.modes, array.shape[-2:], "(p, n)")


def per_mode(
    name: str, value: ArrayLike, modes: int, shape: tuple[int, ...], form: str
) -> Float[np.ndarray, "mode rows columns"]:
    """One matrix for all modes, or one per mode, as the latter (read-only)."""
    given = as_floats(name, value, f"shape {form}")
    if given.ndim == 3:
        array = real_array(name, given, f"(modes, {form[1:]}", 3)
        return require_shape(name, array, (modes, *shape), f"(modes, {form[1:]}")
    array = require_shape(name, real_array(name, given, form, 2), shape, form)
    return read_only(np.tile(array, (modes, 1, 1)))


_NEWTON = 3  # steps, each doubling the digits: from four to all of a double


def luenberger(
    plant: SwitchedSystem,
    C: ArrayLike,
    poles: ArrayLike | Sequence[ArrayLike],
    step: float,
    *,
    model: Model = "modes",
) -> Observer:
    r"""An observer with prescribed poles of the error in every mode.

    The gain :math:`L_i` gives the error matrix :math:`\Phi_i (I - L_i C_i)` the eigenvalues
    :math:`e^{p h}`: with :math:`M = \Phi_i L_i` it is :math:`\Phi_i - M C_i`, the transpose of a
    state feedback.

    Parameters
    ----------
    plant : SwitchedSystem
        The model; every mode must be observable.
    C : array_like, shape (p, n) or (modes, p, n)
        What is measured, :math:`y = C_\sigma x`.
    poles : array_like, shape (n,) or (modes, n)
        Poles of the error for all modes, or one list per mode, in 1/s.
    step : float
        Sampling period h, in seconds.
    model : "modes", "mean" or int
        The model that predicts: the measured mode; or, so that no mode is measured, the mean of all
        modes or the mode of this number.

    Returns
    -------
    Observer
        With the gains :math:`L_i`.

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
    plant, C = model_of(plant, output_matrices(C, plant), model)
    wanted = pole_lists(poles, plant.modes, plant.states)
    slowest = float(np.real(wanted).max())
    if slowest >= 0.0:
        raise ArgumentError(f"poles must have negative real parts, got {slowest:g}.")
    gain = []
    for i, (A, B) in enumerate(zip(plant.A, plant.B, strict=True)):
        if (rank := reachable(A.T, C[i].T)) < len(A):
            raise ArgumentError(
                f"mode {i} is not observable: {_rank_of(len(A), rank)}: no gain can move all poles "
                "of its error; measure more, or use `kalman` if what is hidden decays."
            )
        placed = quotient_poles(wanted[i], step, i)
        # With a short step Φ and all e^{ph} are next to 1: (Φ − I)/h and (e^{ph} − 1)/h are not.
        slope = quotient(A, B, step)[0]
        if reachable(slope.T, C[i].T) < len(A):
            raise ArgumentError(
                f"mode {i} is not observable when sampled every {step:g} s: eigenvalues whose "
                f"imaginary parts differ by a multiple of 2π/h = {2.0 * np.pi / step:.4g} 1/s "
                "look alike; change the step a little."
            )
        M = -step * place_pair(slope.T, C[i].T, placed, i, "C", wanted[i]).T
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
    r"""The steady-state Kalman filter of every mode.

    .. math::

        \dot x = A_\sigma x + B_\sigma u(t - D) + w, \quad y_k = C_\sigma x(t_k) + v_k,

    with :math:`w` continuous white noise of intensity :math:`W`,
    :math:`E\,w(t) w(s)^T = W \delta(t - s)`, and :math:`v_k` white with covariance :math:`R`. Over
    a period :math:`w` leaves the covariance :math:`Q_d = \int_0^h e^{A s} W e^{A^T s} \, ds`, and
    with the steady state :math:`P` of

    .. math::

        P = \Phi (I - L C) P \Phi^T + Q_d, \quad L = P C^T (C P C^T + R)^{-1},

    `observer.prior` is :math:`P`, the covariance of :math:`x - \bar x` before a correction, and
    `observer.covariance` :math:`(I - L C) P`, that of :math:`x - \hat x` after it. In a mode
    that lasts, no other observer has a smaller one. Just after a switch it is not optimal: the
    optimal filter updates its covariance at every sample.

    Parameters
    ----------
    plant : SwitchedSystem
        The model; what a mode hides from C must decay.
    C : array_like, shape (p, n) or (modes, p, n)
        What is measured.
    process : array_like, shape (n, n), (n,) or a number
        W, symmetric, positive semidefinite; its diagonal; or a number times the identity. It must
        reach every state that does not decay.
    measurement : array_like, shape (p, p), (p,) or a number
        R, likewise, positive definite: variances, not standard deviations.
    step : float
        Sampling period h, in seconds.
    model : "modes", "mean" or int
        As for `luenberger`. With one model the covariances hold if the plant is that model.

    Returns
    -------
    Observer
        With the gains :math:`L_i`, and `prior` and `covariance` as above.

    Raises
    ------
    ArgumentError
        If a shape is wrong, a covariance is not definite, a mode has no stabilising gain, or one
        model is to have a C per mode.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[0.0]]], [[[1.0]]], delay=0.3)
    >>> observer = dt.kalman(plant, [[1.0]], process=1.0, measurement=1.0, step=1.0)
    >>> observer.gain.round(4).item()      # 1 over the golden ratio
    0.618
    """
    instance("plant", plant, SwitchedSystem)
    modes, step = plant.modes, positive("step", step)
    plant, C = model_of(plant, output_matrices(C, plant), model)
    W = weight_matrix("process", process, plant.states, "n")
    R = weight_matrix("measurement", measurement, C.shape[1], "p", strict=True)
    each = [_filter(plant.A[i], C[i], W, R, step, i) for i in range(plant.modes)]
    designed = (np.stack(arrays) for arrays in zip(*each, strict=True))
    plant, C, gain, prior, covariance = in_all_modes(plant, modes, C, *designed)
    observer = Observer(plant, C, gain, step)
    vars(observer).update(prior=read_only(prior), covariance=read_only(covariance))
    return observer


def _filter(
    A: Float[np.ndarray, "n n"],
    C: Float[np.ndarray, "p n"],
    W: Float[np.ndarray, "n n"],
    R: Float[np.ndarray, "p p"],
    step: float,
    i: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """L, and the covariance before and after a correction, checked in the Riccati equation.

    The residual is scaled by the standard deviations √P_jj, so that units of states do not matter.
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
    # Joseph's form: a sum of positive terms, which round-off cannot make indefinite.
    after = rest @ P @ rest.T + L @ R @ L.T
    unit = np.sqrt(np.maximum(np.diag(P), 0.0))
    wrong = np.abs(Phi @ after @ Phi.T + noise - P) > 1e-8 * np.outer(unit, unit)
    if wrong.any() or np.abs(np.linalg.eigvals(Phi @ rest)).max() >= 1.0 - 1e-9:
        raise _no_filter(i)
    return L, P, (after + after.T) / 2.0


def _steady_state(Phi: np.ndarray, C: np.ndarray, Q: np.ndarray, R: np.ndarray) -> np.ndarray:
    """P, by an eigenvalue method and Newton's, in units of similar size.

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
        if np.abs(np.linalg.eigvals(loop)).max() >= 1.0:  # the caller refuses this P
            break
        unit = np.sqrt(np.where(np.diag(P) > 0.0, np.diag(P), 1.0))  # 1 for a state that is known
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


def require_detectable(A: np.ndarray, C: np.ndarray, i: int) -> None:
    """Refuse a mode that hides from C what does not decay."""
    value = unseen_pole(A, C)
    if value is not None:
        raise ArgumentError(
            f"mode {i} is not observable: {_rank_of(len(A), reachable(A.T, C.T))}, and what C does "
            f"not see (eigenvalue {value:.4g} 1/s) does not decay: measure more."
        )
