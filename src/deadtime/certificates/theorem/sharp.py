"""Sharper constants for the same theorem, proved in docs/theory/constants.md.

Differences of exponentials by Duhamel's formula; the mismatch W bounded along the closed loop,
which decays, instead of through the inputs; sums over modes that leave out the true one;
weights and Young's inequality at their optimum. Nothing depends on the dwell time.

With |x|_S² = xᵀSx, S = P or S = I: |Φ_H(τ)|_S ≤ e^{hτ}, |e^{A_iτ}| ≤ e^{aτ}, and

    |W(t)| ≤ ε(c₁|X(t)|_S + ∫₀^D k(r)|W(t−r)| dr)
    1/ε*² = min over c > 0 and S of e^{cD}(c₁² γ² + ∫₀^D k(r)² e^{−c(D−r)} dr / c)
    μ = min(ω, c)(1 − (ε/ε*)²)
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from deadtime.base.errors import InfeasibleError, SolverError
from deadtime.certificates.theorem.constants import FunctionalConstants, Gains, largest_norm
from deadtime.gains import CommonLyapunov, common_lyapunov
from deadtime.gains.lyapunov import closed_loops, decaying_lyapunov, growth_in_norm
from deadtime.numerics.logarithms import log, log_integral, log_one_plus, log_sum
from deadtime.plant import SwitchedSystem

# A sum of exponentials, each term as (log of its coefficient, exponent).
Terms = tuple[tuple[float, float], ...]

# Decay rates tried for P, as fractions of the slowest mode's own.
FRACTIONS = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.97)


@dataclass(frozen=True, eq=False)
class SharpConstants(FunctionalConstants):
    """The sharp constants.

    Attributes
    ----------
    log_slope1, log_slope2 : float
        log δ₁/ε and log δ₂/ε: both are linear in ε.
    rate : float
        The smaller of ω and c: what μ tends to as ε → 0, 1/s.
    """

    log_slope1: float
    log_slope2: float
    rate: float

    def log_delta1(self, x: float) -> float:
        return x + self.log_slope1

    def log_delta2(self, x: float) -> float:
        return x + self.log_slope2

    def decay(self, x: float) -> float:
        ratio = math.exp(2.0 * (x - self.log_epsilon_star)) if x > -math.inf else 0.0
        return self.rate * (1.0 - ratio)

    def log_rho(self, x: float) -> float:
        norms = log_one_plus(self.log_nu1) + log_one_plus(self.log_nu2)
        return 0.5 * (math.log(2.0) + norms + self.log_kappa)


@dataclass(frozen=True)
class Norm:
    """One of the two routes: |x|_S along the delay-free loops, and how V uses it.

    Attributes
    ----------
    growth : float
        h: |Φ_H(τ)|_S ≤ e^{hτ}, 1/s.
    euclid, entry, gain : float
        max |x|/|x|_S, max_i |B_i|_S, max_i max |K_i x|/|x|_S.
    from_euclid : float
        max |x|_S/|x|.
    log_gamma2, log_b : float
        V̇ ≤ −(b/γ²)|X|_S² + b e^{cD}|W|² − bc∫…: γ² and b.
    omega : float
        The part of μ that belongs to X, 1/s.
    """

    growth: float
    euclid: float
    entry: float
    gain: float
    from_euclid: float
    log_gamma2: float
    log_b: float
    omega: float


def euclidean(plant: SwitchedSystem, gains: Gains, lyapunov: CommonLyapunov) -> Norm:
    """S = I: the logarithmic norm of A_i + B_i K_i, and Q of the inequality."""
    P, Q = lyapunov.P, lyapunov.Q
    q, largest = float(np.linalg.eigvalsh(Q)[0]), float(np.linalg.eigvalsh(P)[-1])
    coupling = largest_norm(P @ plant.B)
    return Norm(
        growth=logarithmic_norm(closed_loops(plant, gains)),
        euclid=1.0,
        entry=largest_norm(plant.B),
        gain=largest_norm(gains),
        from_euclid=1.0,
        log_gamma2=2.0 * (math.log(2.0) + log(coupling) - log(q)),
        log_b=math.log(2.0) + 2.0 * log(coupling) - log(q),
        omega=0.5 * q / largest,
    )


def weighted_norm(plant: SwitchedSystem, gains: Gains, lyapunov: CommonLyapunov) -> Norm | None:
    """S = P: the norm in which all delay-free loops decay; None if rounding hides the decay."""
    P = lyapunov.P
    omega = -growth_in_norm(plant, gains, P)
    if omega <= 0.0:
        return None
    eigenvalues = np.linalg.eigvalsh(P)
    L = np.linalg.cholesky(P)
    entry = largest_norm(L.T @ plant.B)
    return Norm(
        growth=-omega,
        euclid=float(eigenvalues[0]) ** -0.5,
        entry=entry,
        gain=largest_norm(gains @ np.linalg.inv(L).T),
        from_euclid=float(eigenvalues[-1]) ** 0.5,
        log_gamma2=2.0 * (log(entry) - log(omega)),
        log_b=2.0 * log(entry) - log(omega),
        omega=omega,
    )


def logarithmic_norm(matrices: np.ndarray) -> float:
    """max_i λ_max((M_i + M_iᵀ)/2): |e^{M τ}| ≤ e^{that τ}, also for products over the modes."""
    symmetric = (matrices + matrices.transpose(0, 2, 1)) / 2.0
    return float(np.linalg.eigvalsh(symmetric)[:, -1].max())


def sharp_constants(
    plant: SwitchedSystem, gains: Gains, lyapunov: CommonLyapunov | None
) -> SharpConstants:
    """The constants with the largest ε*, over P (unless given), S and the weight."""
    pairs = pairs_of(plant, gains) if lyapunov is None else [lyapunov]
    routes = [
        (pair, norm)
        for pair in pairs
        for norm in (euclidean(plant, gains, pair), weighted_norm(plant, gains, pair))
        if norm is not None
    ]
    attempts = [_constants(plant, gains, pair, norm) for pair, norm in routes]
    return max(attempts, key=lambda constants: constants.log_epsilon_star)


def pairs_of(plant: SwitchedSystem, gains: Gains) -> list[CommonLyapunov]:
    """The P of largest λ_min(Q)/|P|, and the best conditioned P for a range of decay rates."""
    slowest = float(-np.linalg.eigvals(closed_loops(plant, gains)).real.max())
    others = (decaying_lyapunov(plant, gains, share * slowest) for share in FRACTIONS)
    pairs = [pair for pair in others if pair is not None]
    try:
        return [common_lyapunov(plant, gains), *pairs]
    except (InfeasibleError, SolverError):
        if not pairs:
            raise
        return pairs


def _constants(
    plant: SwitchedSystem, gains: Gains, lyapunov: CommonLyapunov, norm: Norm
) -> SharpConstants:
    D = plant.delay
    M_B, M_K = largest_norm(plant.B), largest_norm(gains)
    share, a = others_share(plant), logarithmic_norm(plant.A)
    weight, log_inverse_square = _best_weight(plant, gains, norm)
    eigenvalues = np.linalg.eigvalsh(lyapunov.P)
    smallest, largest = log(float(eigenvalues[0])), log(float(eigenvalues[-1]))
    upper = max(largest, norm.log_b + weight * D)
    return SharpConstants(
        lyapunov=lyapunov,
        weight=weight,
        log_epsilon_star=-0.5 * log_inverse_square,
        log_nu1=min(
            _log_nu(other.gain, other.entry, other.from_euclid, other.growth, D)
            for other in (weighted_norm(plant, gains, lyapunov), euclidean(plant, gains, lyapunov))
            if other is not None
        ),
        log_nu2=_log_nu(M_K, M_B, 1.0, a, D),
        log_kappa=upper - min(smallest, norm.log_b),
        log_b=norm.log_b,
        log_slope1=share + a * D + log_one_plus(log(M_K * D)),
        log_slope2=share + max(a, 0.0) * D + log(M_K * (M_B * D + 1.0) + M_B),
        rate=min(norm.omega, weight),
    )


def _log_nu(gain: float, entry: float, start: float, growth: float, D: float) -> float:
    """log of (1 + gain·entry·∫e^{growth τ})² + gain²·start²·∫e^{2 growth τ}, over [0, D]."""
    through = log_one_plus(log(gain) + log(entry) + log_integral(growth, D))
    state = log(gain) + log(start)
    return log_sum((2.0 * through, 2.0 * state + log_integral(2.0 * growth, D)))


def closed_loop_mismatch(plant: SwitchedSystem, gains: Gains, norm: Norm) -> tuple[float, Terms]:
    """c₁ and k of |W(t)| ≤ ε(c₁|X(t)|_S + ∫₀^D k(r)|W(t − r)| dr).

    Returns log c₁, and k(r) = Σ e^{coefficient + exponent·r} as (coefficient, exponent) pairs.
    """
    D, h, a = plant.delay, norm.growth, logarithmic_norm(plant.A)
    share, log_M_K, top = others_share(plant), log(largest_norm(gains)), max(a, h)
    # ∫₀^r e^{a(r−τ) + hτ} dτ ≤ e^{top r} min(r, 1/|a − h|)
    spread = min(D, 1.0 / abs(a - h)) if a != h else D
    pull = log_M_K + log(norm.euclid + norm.gain) + log(spread)
    log_c1 = share + log_sum((pull + top * D, log(norm.euclid) + h * D))
    kernel = (
        (share + log(norm.entry) + pull, top),
        (share + log(norm.entry) + log(norm.euclid), h),
        (share + log_M_K, a),
    )
    return log_c1, kernel


def others_share(plant: SwitchedSystem) -> float:
    """log of l/(l + 1): of the mean over modes of |R_i − R_σ|, the term i = σ is zero."""
    return log(1.0 - 1.0 / plant.modes)


def _best_weight(plant: SwitchedSystem, gains: Gains, norm: Norm) -> tuple[float, float]:
    """(c, log 1/ε*²), c by search: every c > 0 gives a valid bound, so a near optimum will do."""
    if plant.modes == 1:  # W = 0 and every weight will do
        return norm.omega, -math.inf
    D = plant.delay
    log_c1, kernel = closed_loop_mismatch(plant, gains, norm)

    def objective(c: float) -> float:
        square = log_sum(
            k + m - c * D + log_integral(x + y + c, D) for k, x in kernel for m, y in kernel
        )
        return c * D + log_sum((2.0 * log_c1 + norm.log_gamma2, square - math.log(c)))

    c, width = 1.0 / D, 5.0
    for _ in range(4):
        c = min((c * math.exp(width * i / 20.0) for i in range(-20, 21)), key=objective)
        width /= 8.0
    return c, objective(c)
