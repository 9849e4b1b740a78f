"""Initial states and stationary noise, as causes of a loop's inputs.

Every input of a linear loop is linear in the initial state, u = rᵀx(0), so the largest |u| over a
set, and the distribution of u for a normal x(0), are closed forms:

    |x(0)| ≤ ρ                          ρ |r|
    |x_i(0)| ≤ b_i                      Σ_i |r_i| b_i
    x(0) ~ N(0, X)                      u ~ N(0, rᵀ X r)

Under noise the inputs of a loop that decays have a stationary distribution. With one mode held,
white process noise w, E[w(t) w(s)ᵀ] = W δ(t − s), and measurement noise v_k ~ N(0, V), the lifted
state z = (x_k, u_{k−1}, …, u_{k−W}) follows

    z_{k+1} = L z_k + E w_k + b v_k,    E = (I, 0),    b = (Γ₀F, F, 0),    w_k ~ N(0, Q_h),

Q_h = ∫₀^h e^{As} W e^{Aᵀs} ds and Γ₀ the effect of an input within its own period. The stationary
covariance of z solves the discrete Lyapunov equation

    P = L P Lᵀ + E Q_h Eᵀ + b V bᵀ,

and Var u is the block of P for u_{k−1}. By the series P = Σ_i Lⁱ (E Q_h Eᵀ + b V bᵀ) Lᵀⁱ it is

    Var u = Σ_i M_i Q_h M_iᵀ + Σ_i H_i V H_iᵀ,

with M_i the response of u_i to an initial state and H_i its response to an error of the first
sample, H_0 = F: 2 n runs replace an equation of order n + W m. At any instant u_j ~ N(0, σ_j²) and
P(|u_j| ≤ c) = erf(c/(√2 σ_j)).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import positive, read_only, real_array, share
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.plant import SwitchedSystem
from deadtime.plant.weight import intensity_part, weight_part

Kind = Literal["ball", "box", "normal"]


@dataclass(frozen=True, eq=False)
class InitialStates(Frozen):
    """Initial states of a loop (immutable): a ball, box or normal distribution.

    Made by `ball`, `box` and `normal`.

    Attributes
    ----------
    kind : "ball", "box" or "normal"
    size : (), (n,) or (n, n)
        The radius; the half widths; the covariance of a normal distribution.
    probability : float
        The probability with which an input stays below its level; 1 for a set.

    Examples
    --------
    >>> InitialStates.box([0.1, 2.0]).text
    'every |x(0)| ≤ (0.1, 2)'
    """

    kind: Kind
    size: Float[np.ndarray, ...]
    probability: float = 1.0

    @staticmethod
    def ball(radius: float = 1.0) -> InitialStates:
        r""":math:`|x(0)| \le` radius, for states with one unit.

        Raises
        ------
        ArgumentError
            If the radius is not positive.
        """
        size = np.array(positive("radius", radius, "in the states' unit"))
        return InitialStates("ball", read_only(size).reshape(()))

    @staticmethod
    def box(half_widths: ArrayLike) -> InitialStates:
        r""":math:`|x_i(0)| \le` ``half_widths[i]``, each in the unit of its state.

        Raises
        ------
        ArgumentError
            If one is negative, or all are 0.
        """
        size = real_array("half_widths", half_widths, "(n,)", 1)
        if (size < 0.0).any() or not size.any():
            raise ArgumentError(
                f"half_widths must be 0 or more and not all 0, got {size.tolist()}."
            )
        return InitialStates("box", read_only(size))

    @staticmethod
    def normal(covariance: ArrayLike, probability: float = 0.99) -> InitialStates:
        """x(0) ~ N(0, covariance): inputs stay below their level with a probability.

        Parameters
        ----------
        covariance : array_like, shape (n, n) or (n,)
            A matrix, or its diagonal: the squares of the standard deviations.
        probability : float
            Above 0, below 1; for each input alone, over the whole run.

        Raises
        ------
        ArgumentError
            If the covariance is not symmetric and positive semidefinite, or is 0, or the
            probability is out of range.
        """
        part = share("probability", probability)
        return InitialStates("normal", _semidefinite("covariance", covariance), part)

    def require_plant(self, plant: SwitchedSystem) -> None:
        """Refuse a plant with another number of states."""
        if self.size.ndim and len(self.size) != plant.states:
            raise ArgumentError(
                f"initial must be of n = {plant.states} states, got a {self.kind} of "
                f"{len(self.size)}."
            )

    @property
    def text(self) -> str:
        """For sentences: "abs(u) stays below 25 for …"."""
        if self.kind == "ball":
            return f"every |x(0)| ≤ {self.size.item():g}"
        if self.kind == "box":
            widths = ", ".join(f"{width:g}" for width in self.size)
            return f"every |x(0)| ≤ ({widths})"
        return f"x(0) ~ N(0, X) with a probability of {self.probability:g} at least"


def _semidefinite(name: str, value: ArrayLike) -> Float[np.ndarray, "n n"]:
    part = weight_part(name, value, "n")
    if part.ndim == 0:  # how many states there are is not known here
        raise ArgumentError(f"{name} must have shape (n, n) or (n,), got the number {part:g}.")
    if not part.any():
        raise ArgumentError(f"{name} must not be 0: nothing would move.")
    return part


@dataclass(frozen=True, eq=False, init=False)
class StationaryNoise(Frozen):
    r"""Stationary process and measurement noise of a loop (immutable).

    Parameters
    ----------
    process : array_like, shape (modes, n, n), (n, n), (n,) or ()
        :math:`W`, the intensity of white noise on :math:`\dot x`, in units of :math:`x^2` per
        second: a matrix for every mode or for all, its diagonal, or a number times the identity.
    measurement : array_like, shape (n, n), (n,) or ()
        V, the covariance of the measurement noise of x, likewise.
    probability : float
        The probability with which :math:`|u_j|` stays below its level at any one instant, above 0
        and below 1: the share of the time.

    Raises
    ------
    ArgumentError
        If a matrix is not symmetric and positive semidefinite, both are 0, or the probability is
        out of range.

    Examples
    --------
    >>> StationaryNoise(0.1, [0.01, 0.0], probability=0.95).text
    'stationary noise, 95 % of the time'
    """

    kind: ClassVar[str] = "noise"

    process: Float[np.ndarray, ...]
    measurement: Float[np.ndarray, ...]
    probability: float

    def __init__(
        self, process: ArrayLike = 0.0, measurement: ArrayLike = 0.0, probability: float = 0.99
    ) -> None:
        part = share("probability", probability)
        parts = {
            "process": intensity_part("process", process),
            "measurement": weight_part("measurement", measurement, "n"),
        }
        if not any(one.any() for one in parts.values()):
            raise ArgumentError("process and measurement must not both be 0: nothing would move.")
        vars(self).update(parts, probability=part)

    def require_plant(self, plant: SwitchedSystem) -> None:
        """Refuse a plant with another number of states, or of modes where each has its W."""
        for name in ("process", "measurement"):
            one = getattr(self, name)
            if one.ndim and one.shape[-1] != plant.states:
                raise ArgumentError(
                    f"{name} must be of n = {plant.states} states, got a matrix of {one.shape[-1]}."
                )
        if self.process.ndim == 3 and len(self.process) != plant.modes:
            raise ArgumentError(
                f"process must be one matrix or one for each of {plant.modes} modes, got "
                f"{len(self.process)}."
            )

    def matrices(
        self, states: int, mode: int
    ) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "n n"]]:
        """W of a mode and V, as (n, n) matrices."""
        W = self.process[mode] if self.process.ndim == 3 else self.process
        each = W, self.measurement
        W, V = (one if one.ndim else one * np.eye(states) for one in each)
        return W, V

    @property
    def text(self) -> str:
        """For sentences: "abs(u) stays below 25 for …"."""
        return f"stationary noise, {100.0 * self.probability:g} % of the time"


def level_of(deviation: Float[np.ndarray, " m"], probability: float) -> Float[np.ndarray, " m"]:
    """c with P(|u| ≤ c) as given, of u ~ N(0, deviation²).

    Examples
    --------
    >>> level_of(np.array([1.0]), 0.95).round(4)
    array([1.96])
    """
    from scipy.special import erfinv

    return deviation * (math.sqrt(2.0) * float(erfinv(probability)))  # P(|u| ≤ c) = erf(c/(σ√2))
