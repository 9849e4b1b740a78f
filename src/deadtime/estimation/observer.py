"""A switched observer at a period: the state of the plant from outputs and past inputs.

At every sample it corrects what it predicted by what is measured, and predicts the next sample,

    x̂_k = x̄_k + L_i (y_k − C_i x̄_k),                     i = σ(t_k) the sampled mode,
    x̄_{k+1} = Φ_i x̂_k + (the inputs on their way),

with the inputs as they reach the plant, u_{k−N} for φ and u_{k−N+1} for h − φ: a held input is
predicted exactly, whatever the delay. The law is given x̂_k, which knows y_k (the *filter* form).
Where the model is the plant and switches fall on samples the errors obey

    x_{k+1} − x̄_{k+1} = Φ_i (I − L_i C_i) (x_k − x̄_k),

whatever the law does and whatever the state: a switched linear system of its own, in which the
mode of a period chooses the matrix. After a switch between samples the rest of the period is
predicted with the mode of its start, an error in proportion to the state, which then decays.

An observer of *one model* has the same matrices in all modes, the mean's or those of one mode, and
so reads no mode. The plant then differs from its model, and the errors do not obey the equation:

    x_{k+1} − x̄_{k+1} = Φ (I − L C) (x_k − x̄_k) + (Φ_i − Φ) x_k + (what inputs do otherwise),

so that the error decays with the state and the inputs, and no separation holds; what the whole loop
does, `growth_rate` and `certify` say.
"""

from __future__ import annotations

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
from deadtime.plant import SwitchedSystem
from deadtime.plant.sampling import finite_discretisation

Model = str | int  # "modes", "mean", or the number of a mode


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Observer(Frozen):
    """A switched observer with a gain per mode (immutable).

    Parameters
    ----------
    plant : SwitchedSystem
        The model, its delay included.
    C : array_like, shape (p, n) or (modes, p, n)
        What is measured, y = C_σ x; one matrix for all modes or one per mode.
    gain : array_like, shape (n, p) or (modes, n, p)
        L_i of the correction (see the module); `luenberger` and `kalman` design it.
    step : float
        Sampling period h, in seconds.
    allow_unstable : bool
        Accept gains with which the error of a mode does not decay.

    Attributes
    ----------
    covariance : (modes, n, n) or None
        Of x − x̂_k, after the correction, in the steady state of a mode; of a Kalman filter.
    prior : (modes, n, n) or None
        Of x − x̄_k, before the correction.

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
        """Whether what it does depends on the mode: not of one mode, nor of one model."""
        plant = self.plant
        parts = (plant.A, plant.B, plant.delays, self.C, self.gain)
        return any(bool((part != part[:1]).any()) for part in parts)

    @cached_property
    def error_matrices(self) -> Float[np.ndarray, "mode n n"]:
        """Φ_i (I − L_i C_i), what a period in mode i does to x − x̄."""
        n = self.plant.states
        pairs = zip(self.plant.A, self.plant.B, strict=True)
        Phi = np.stack([finite_discretisation(A, B, self.step)[0] for A, B in pairs])
        return read_only(Phi @ (np.eye(n) - self.gain @ self.C))

    @cached_property
    def rates(self) -> Float[np.ndarray, " mode"]:
        """How fast the error grows with each mode held, 1/s; negative for decay.

        In such a mode the loop of plant, law and observer grows at the larger of this and of what
        `growth_rate` says of the law on the true state (separation), the model being right; of one
        model it is in the mode of that alone.
        """
        radius = np.abs(np.linalg.eigvals(self.error_matrices)).max(axis=1)
        with np.errstate(divide="ignore"):
            return read_only(np.log(radius) / self.step)

    @cached_property
    def switched_rate(self) -> float:
        """A bound on how fast the error grows under any switching at samples, 1/s.

        Gains that are good in every mode prove nothing about switching between them. From one
        P > 0 with E_iᵀ P E_i ≤ e^{2rh} P for the error matrix E_i of every mode. Negative: the
        error decays whatever the switching, no dwell time asked (in floating point; no interval
        arithmetic). Positive: nothing is proved, nor refuted.
        """
        from deadtime.estimation.switched import common_rate

        return common_rate(self.error_matrices) / self.step

    def __repr__(self) -> str:
        return (
            f"Observer(modes={self.plant.modes}, states={self.plant.states}, "
            f"outputs={self.outputs}, step={self.step:g})"
        )


def believed_plant(
    plant: SwitchedSystem, C: Float[np.ndarray, "mode p n"], model: Model
) -> tuple[SwitchedSystem, Float[np.ndarray, "believed p n"]]:
    """What an observer predicts with, and its C: all modes, or one that stands for all."""
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
    i = index("model", model, plant.modes)
    return plant.like(plant.A[i : i + 1], plant.B[i : i + 1], plant.delays[i : i + 1]), C[:1]


def in_all_modes(
    one: SwitchedSystem, modes: int, *parts: Float[np.ndarray, "believed ..."]
) -> tuple[SwitchedSystem, *tuple[np.ndarray, ...]]:
    """A model and what was designed for it, repeated in every mode where it has but one."""
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
    whole = np.tile(array, (modes, 1, 1))
    whole.flags.writeable = False
    return whole
