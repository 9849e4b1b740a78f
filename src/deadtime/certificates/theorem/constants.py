"""The constants of arXiv 2503.08446 as its text prints them, and corrected.

    δ₁ = ε e^{M_A D}(M_K (D/τ_d + 2) D e^{εD} + 1)                                        (47)
    δ₂ = ε e^{M_A D}(M_K [e^{εD} D M_B (1 + e^{M_A D}(D/τ_d + 1)) + 1] + M_B)             (54)
    ν₁ = 2 max{2M_K² D e^{2M_H D}, 1 + 2M_K² D² e^{2M_H D} M_B²},  ν₂ with M_A for M_H    (60), (61)
    b = 2(M_B|P|)²/λ_min(Q)                                                               (67)
    κ = max{λ_max(P), b e^D}/min{λ_min(P), b}                                             (74)

There are two errors in these constants: ε*, (62), drops the + 1 of (71), and ρ, (75). See
docs/errata.md. Norms are spectral.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from deadtime.gains import CommonLyapunov
from deadtime.gains.lyapunov import closed_loops
from deadtime.numerics.logarithms import exp, log, log_inverse, log_one_plus, log_sum
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
    """The constants of a proof by V = XᵀPX + b∫e^{c(θ+D−t)}|W|², for one delay.

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

    def log_rho(self, x: float) -> float:
        """ρ = √(2(1+ν₁)(1+ν₂)κ)."""
        norms = log_one_plus(self.log_nu1) + log_one_plus(self.log_nu2)
        return 0.5 * (math.log(2.0) + norms + self.log_kappa)


@dataclass(frozen=True, eq=False)
class PaperConstants(FunctionalConstants):
    """The printed or the corrected constants, of the sizes M of (33).

    Attributes
    ----------
    corrected : bool
        Whether ε* and ρ are corrected.
    """

    M_A: float
    M_B: float
    M_K: float
    delay: float
    dwell_time: float
    corrected: bool

    def log_delta1(self, x: float) -> float:
        D = self.delay
        switches = log(self.M_K) + self._log_intervals(2.0) + log(D)
        return x + self.M_A * D + log_one_plus(switches + exp(x) * D)

    def log_delta2(self, x: float) -> float:
        D = self.delay
        inner = log_one_plus(self.M_A * D + self._log_intervals(1.0))
        first = log(D * self.M_B) + exp(x) * D + inner
        outer = np.logaddexp(log(self.M_K) + log_one_plus(first), log(self.M_B))
        return x + self.M_A * D + float(outer)

    def _log_intervals(self, more: float) -> float:
        """log(D/τ_d + more), by logarithms since D/τ_d may overflow."""
        return log_sum((log(self.delay) - log(self.dwell_time), log(more)))

    def decay(self, x: float) -> float:
        """μ of (73); positive exactly when both lines of (71) hold."""
        q = float(np.linalg.eigvalsh(self.lyapunov.Q)[0])
        largest = float(np.linalg.eigvalsh(self.lyapunov.P)[-1])
        forcing = math.log(2.0) + self.delay + 2.0 * self.log_lambda(x)
        log_D_nu1 = log(self.delay) + self.log_nu1
        window = 1.0 - exp(forcing + log_D_nu1)
        share = exp(forcing + math.log(2.0 / q) + self.log_b + log_one_plus(log_D_nu1))
        return min(window, 0.5 * q * (1.0 - share) / largest)

    def log_rho(self, x: float) -> float:
        """Printed: √(2ν₁ν₂/κ), an erratum."""
        if self.corrected:
            return super().log_rho(x)
        return 0.5 * (math.log(2.0) + self.log_nu1 + self.log_nu2 - self.log_kappa)


def paper_constants(
    plant: SwitchedSystem,
    gains: Gains,
    dwell_time: float,
    lyapunov: CommonLyapunov,
    corrected: bool,
) -> PaperConstants:
    """The constants, printed or corrected."""
    D, M_H = plant.delay, largest_norm(closed_loops(plant, gains))
    M_A, M_B, M_K = (largest_norm(each) for each in (plant.A, plant.B, gains))
    eigenvalues = np.linalg.eigvalsh(lyapunov.P)
    smallest, largest = log(float(eigenvalues[0])), log(float(eigenvalues[-1]))
    log_q = log(float(np.linalg.eigvalsh(lyapunov.Q)[0]))
    log_b = math.log(2.0) + 2.0 * (log(M_B) + largest) - log_q

    def log_nu(M: float) -> float:
        """log ν of (60) and (61): e^{M τ} bounds the transition matrices."""
        state = math.log(2.0) + 2.0 * log(M_K) + log(D) + 2.0 * M * D
        return math.log(2.0) + max(state, log_one_plus(state + log(D) + 2.0 * log(M_B)))

    log_nu1 = log_nu(M_H)
    # λ(ε) must stay below both of these: the two lines of (71).
    log_D_nu1 = log(D) + log_nu1
    allowed = -0.5 * (math.log(2.0) + D + log_D_nu1)
    second = log_one_plus(log_D_nu1) if corrected else log_D_nu1
    forcing = log_q - math.log(2.0) - log(M_B) - largest
    allowed = min(allowed, forcing - 0.5 * (math.log(2.0) + D + second))
    found = PaperConstants(
        lyapunov=lyapunov,
        log_epsilon_star=math.nan,  # below: it is the inverse of λ, which needs the sizes
        weight=1.0,
        log_nu1=log_nu1,
        log_nu2=log_nu(M_A),
        log_kappa=max(largest, log_b + D) - min(smallest, log_b),
        log_b=log_b,
        M_A=M_A,
        M_B=M_B,
        M_K=M_K,
        delay=D,
        dwell_time=dwell_time,
        corrected=corrected,
    )
    return replace(found, log_epsilon_star=log_inverse(found.log_lambda, allowed))
