"""How far stationary noise spreads the inputs of a loop that decays.

With one mode held, under white noise w of the plant, E[w(t) w(s)ᵀ] = W δ(t − s), and noise
v_k ~ N(0, V) of every sample, the lifted state z = (x_k, u_{k−1}, …, u_{k−W}) follows

    z_{k+1} = L z_k + E w_k + b v_k,    E = (I, 0),    b = (Γ₀F, F, 0),    w_k ~ N(0, Q_h),

Q_h = ∫₀^h e^{As} W e^{Aᵀs} ds and Γ₀ what an input does within its own period. Its stationary
covariance solves the discrete Lyapunov equation

    P = L P Lᵀ + E Q_h Eᵀ + b V bᵀ,

and Var u is the block of P that belongs to u_{k−1}. Only that is wanted, and of the series
P = Σ_i Lⁱ (E Q_h Eᵀ + b V bᵀ) Lᵀⁱ it is

    Var u = Σ_i M_i Q_h M_iᵀ + Σ_i H_i V H_iᵀ,

M_i the response of u_i to a state at the start, H_i that to an error of the first sample, H_0 = F:
n + n runs in place of an equation of order n + W m. At any instant u_j ~ N(0, σ_j²), and
P(|u_j| ≤ c) = erf(c/(√2 σ_j)).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import as_floats, read_only, real_array, share
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.plant import SwitchedSystem
from deadtime.plant.weight import weight_part


@dataclass(frozen=True, eq=False, init=False)
class StationaryNoise(Frozen):
    """Stationary noise, as what moves the inputs of a loop (immutable).

    Parameters
    ----------
    process : array_like, shape (modes, n, n), (n, n), (n,) or ()
        W, the intensity of white noise on dx/dt, in units of x² per second: a matrix for every mode
        or for all, its diagonal, or a number times the identity.
    measurement : array_like, shape (n, n), (n,) or ()
        V, the covariance of the error of every sample of x, likewise.
    probability : float
        With which |u_j| is to stay below its level at any one instant, above 0 and below 1: the
        share of the time.

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
            "process": _process(process),
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
        """W of a mode and V of a plant with so many states."""
        W = self.process[mode] if self.process.ndim == 3 else self.process
        each = W, self.measurement
        W, V = (one if one.ndim else one * np.eye(states) for one in each)
        return W, V

    @property
    def text(self) -> str:
        """For sentences: "|u| stays below 25 for …"."""
        return f"stationary noise, {100.0 * self.probability:g} % of the time"


def level_of(deviation: Float[np.ndarray, " m"], probability: float) -> Float[np.ndarray, " m"]:
    """c with P(|u| ≤ c) as given, of u ~ N(0, deviation²).

    Examples
    --------
    >>> level_of(np.array([1.0]), 0.95).round(4)
    array([1.96])
    """
    from scipy.special import erfinv

    return deviation * (math.sqrt(2.0) * float(erfinv(probability)))


def _process(value: ArrayLike) -> Float[np.ndarray, ...]:
    """W as `weight_part` has it, or one matrix for every mode."""
    if as_floats("process", value, "of shape (modes, n, n), (n, n), (n,) or ()").ndim != 3:
        return weight_part("process", value, "n")
    given = real_array("process", value, "(modes, n, n)", 3)
    each = [weight_part(f"process[{mode}]", W, "n") for mode, W in enumerate(given)]
    return read_only(np.stack(each))
