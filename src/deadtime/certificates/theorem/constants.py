"""What every form of the constants provides, and the sizes that all are made of."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deadtime.gains import CommonLyapunov
from deadtime.plant import SwitchedSystem

Gains = Float[np.ndarray, "mode m n"]


def largest_norm(matrices: Float[np.ndarray, "mode rows columns"]) -> float:
    """M_R = max_i |R_i|, equation (33), in the spectral norm."""
    return float(np.linalg.norm(matrices, 2, axis=(1, 2)).max())


def distance(plant: SwitchedSystem, gains: Gains) -> float:
    """ε = max over pairs of modes of |A_i − A_j|, |B_i − B_j|, |K_i − K_j|, equation (5)."""
    return max(
        largest_norm(matrices - matrices[i])
        for matrices in (plant.A, plant.B, gains)
        for i in range(plant.modes)
    )


@dataclass(frozen=True, eq=False)
class Constants(ABC):
    """The constants of one form, as natural logarithms; x stands for log ε.

    Attributes
    ----------
    lyapunov : CommonLyapunov
        P and Q of (4).
    """

    lyapunov: CommonLyapunov
    log_epsilon_star: float

    @abstractmethod
    def log_delta1(self, x: float) -> float:
        """log δ₁(e^x)."""

    @abstractmethod
    def log_delta2(self, x: float) -> float:
        """log δ₂(e^x)."""

    @abstractmethod
    def decay(self, x: float) -> float:
        """μ = 2ξ, for e^x < ε*, 1/s."""

    @abstractmethod
    def log_rho(self, x: float) -> float:
        """log ρ, where there is a μ."""

    def log_lambda(self, x: float) -> float:
        """log max(δ₁, δ₂), equation (55)."""
        return max(self.log_delta1(x), self.log_delta2(x))


@dataclass(frozen=True, eq=False)
class FunctionalConstants(Constants):
    """Those of a proof by V = XᵀPX + b∫e^{c(θ+D−t)}|W|², of one delay.

    Attributes
    ----------
    weight : float
        c, the exponent of the weight, 1/s.
    """

    weight: float
    log_nu1: float
    log_nu2: float
    log_kappa: float
    log_b: float
