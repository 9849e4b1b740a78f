"""Sampling: exact discretisation of a mode, and the windows of delayed inputs.

With the input held for h seconds,

    x(t + h) = Φ x(t) + Γ u,    Φ = I + A W,  Γ = W B,  W = ∫₀^h e^{As} ds.

Poles are placed and ranks computed with the difference quotient
(x(t + h) − x(t))/h = (W/h)(A x + B u) instead. It tends to (A, B) as h → 0, where Φ → I and Γ → 0,
and has no cancellation. Where Φ + ΓK has the eigenvalues z, it has (z − 1)/h.

Sampling instants are t_k = k h. An input u_k, held on [t_k, t_{k+1}), reaches the plant D
later, so with

    N = ⌈D/h⌉,    φ = D − (N − 1) h ∈ (0, h],

u_{k−N} acts during the first φ of step k and u_{k−N+1} during the remaining h − φ. A ratio such as
D/h within 1e-9 of an integer *is* that integer. Signals are right-continuous: a switch at t_k takes
effect at t_k.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import positive, read_only
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.plant.switched_system import SwitchedSystem, require_exponential


def finite_discretisation(
    A: np.ndarray, B: np.ndarray, step: float
) -> tuple[np.ndarray, np.ndarray]:
    """Φ and Γ of one mode over a step; an ArgumentError where they overflow."""
    from deadtime.numerics.exponential import discretise

    Phi, Gamma = discretise(read_only(A), read_only(B), step)
    if not (np.isfinite(Phi).all() and np.isfinite(Gamma).all()):
        raise ArgumentError(
            f"step = {step:g} s is too long: within it the plant grows beyond what floats hold."
        )
    return Phi, Gamma


def quotient(A: np.ndarray, B: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """((Φ − I)/h, Γ/h)."""
    mean = finite_discretisation(A, np.eye(A.shape[0]), step)[1] / step
    return mean @ A, mean @ B


def quotient_poles(poles: np.ndarray, step: float, i: int) -> np.ndarray:
    """(e^{ph} − 1)/h for poles p in 1/s, whose frequency must be below that of Nyquist."""
    frequency = np.abs(np.imag(poles))
    if (frequency >= np.pi * (1.0 - 1e-9) / step).any():
        worst = poles[np.argmax(frequency)]
        raise ArgumentError(
            f"poles of mode {i}: {worst:g} oscillates faster than a period of {step:g} s shows: "
            f"|Im p| must be below π/h = {np.pi / step:.4g} 1/s; shorten the step."
        )
    with np.errstate(over="ignore", invalid="ignore"):  # a step too long is refused elsewhere
        return np.expm1(poles * step) / step


TOLERANCE = 1e-9
_NO_OVERFLOW = 600.0  # |A|·step up to which e^(A·step) cannot overflow
MOST_PERIODS = 1_000_000  # of delay: more is a mistake of units


def snap(ratio: float) -> float:
    """The ratio, rounded to an integer if it is within 1e-9 of one."""
    if math.isinf(ratio):
        return ratio
    nearest = math.floor(ratio + 0.5)
    return float(nearest) if abs(ratio - nearest) <= TOLERANCE else ratio


def snap_all(ratio: np.ndarray) -> np.ndarray:
    """`snap`, entry by entry."""
    nearest = np.rint(ratio)
    return np.where(np.abs(ratio - nearest) <= TOLERANCE, nearest, ratio)


@dataclass(frozen=True)
class Window:
    """The inputs in flight under one delay.

    Attributes
    ----------
    step : float
        Sampling period h, seconds.
    count : int
        N = ⌈D/h⌉, the number of past inputs that still act after t_k.
    phase : float
        φ = D − (N − 1) h ∈ (0, h], seconds.

    Examples
    --------
    >>> Window.of(delay=0.07, step=0.01)       # naive floats give ⌈7.000000000000001⌉ = 8
    Window(step=0.01, count=7, phase=0.01)
    """

    step: float
    count: int
    phase: float

    @classmethod
    def of(cls, delay: float, step: float, name: str = "delay") -> Window:
        """The window of a delay at a sampling period, both in seconds; `name` is for messages."""
        ratio = snap(delay / step)
        if ratio > MOST_PERIODS:
            raise ArgumentError(
                f"{name} / step = {ratio:.3g} periods, at most {MOST_PERIODS:.0e} are possible: "
                "are both in seconds? Lengthen the step."
            )
        count = max(1, math.ceil(ratio))
        phase = step if ratio == count else delay - (count - 1) * step
        return cls(step, count, phase)

    @property
    def delay(self) -> float:
        """The delay (N − 1) h + φ, in seconds."""
        return (self.count - 1) * self.step + self.phase


def require_step(plant: SwitchedSystem, step: float) -> float:
    """The period, seconds, after a check that no mode overflows over it."""
    step = positive("step", step)
    if require_exponential("step", plant.A, step) > _NO_OVERFLOW:
        for A, B in zip(plant.A, plant.B, strict=True):
            finite_discretisation(A, B, step)
    return step


def windows_of(plant: SwitchedSystem, step: float) -> list[list[Window]]:
    """The windows of a plant's delays at a period, by mode and input.

    Fractions φ within 1e-9 h of each other become the least of them, so that no piece of a period
    is shorter than that.
    """
    windows: dict[float, Window] = {}
    for (i, j), delay in np.ndenumerate(plant.delays):
        name = "delay" if plant.has_one_delay else f"delay of input {j} in mode {i}"
        windows[delay.item()] = windows.get(delay.item()) or Window.of(delay.item(), step, name)
    # In ascending order each φ joins the group of the one before, if it is that close.
    phase = -step
    for delay, window in sorted(windows.items(), key=lambda item: item[1].phase):
        if window.phase - phase > TOLERANCE * step:
            phase = window.phase
        windows[delay] = Window(step, window.count, phase)
    return [[windows[delay] for delay in row] for row in plant.delays.tolist()]


@dataclass(frozen=True, eq=False)
class Cuts(Frozen):
    """The switches of a signal by sampling period.

    Attributes
    ----------
    step : (switches,) int
        Index k of the period in which the switch occurs.
    offset : (switches,) float
        Time since t_k, in [0, h); exactly 0 or a φ for a switch at a sample or an arrival.
    mode : (switches + 1,) int
        The initial mode, then the mode after each switch.
    """

    step: Int[np.ndarray, " switch"]
    offset: Float[np.ndarray, " switch"]
    mode: Int[np.ndarray, " switch+1"]
