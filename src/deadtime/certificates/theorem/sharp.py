"""Sharper constants for the same theorem, proved in docs/theory/constants.md.

Differences of exponentials by Duhamel's formula; the mismatch W bounded along the closed loop,
which decays, instead of through the inputs; sums over modes that leave out the true one;
weights and Young's inequality at their optimum. Nothing depends on the dwell time.

With |x|_S² = xᵀSx, S = P or S = I: |Φ_H(τ)|_S ≤ e^{hτ}, |e^{A_iτ}| ≤ e^{aτ}, and

    |W(t)| ≤ ε(c₁|X(t)|_S + ∫₀^D k(r)|W(t−r)| dr)
    1/ε*² = min over c > 0 and S of e^{cD}(c₁² γ² + ∫₀^D k(r)² e^{−c(D−r)} dr / c)
    μ = min(ω, c)(1 − (ε/ε*)²)

With a delay per input, the same in all modes, the inputs are sorted into groups of equal delay,
d_1 < … < d_g. With the mismatch of group q as it arrives, y_q(s) = W_q(s − d_q), the state moves
as X' = (A_σ + B_σ K_σ) X + B_σ y, and along the averaged law, x and y at s − r in the integrals,

    |y_q(s)| ≤ ε s {M_q ∫ e^{ar} [(η + κ_K + M_B η 1{r ≤ d_q − d_1}) |x|_S + |y|] dr + η |X(s)|_S}
               + Σ_{p<q} M_q B_p ∫₀^{d_q−d_p} e^{ar} |y_p| dr,         the first one over [0, d_q].

In the norms of L² with the weight e^{2ξs}, |X|_S ≤ … + β/(ω − ξ) |y|, so that these inequalities
are Y ≤ J + ε s m |Y| + G Y, G strictly lower triangular: 1/ε*(ξ) = s |(I − G)⁻¹ m|.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deadtime.base.errors import InfeasibleError, SolverError
from deadtime.certificates.theorem.constants import (
    Constants,
    FunctionalConstants,
    Gains,
    largest_norm,
)
from deadtime.gains import CommonLyapunov, common_lyapunov
from deadtime.gains.lyapunov import closed_loops, decaying_lyapunov, growth_in_norm
from deadtime.numerics.logarithms import log, log_integral, log_one_plus, log_sum
from deadtime.plant import SwitchedSystem

# A sum of exponentials, each term as (log of its coefficient, exponent).
Terms = tuple[tuple[float, float], ...]

# Decay rates tried for P, as fractions of the slowest mode's own.
FRACTIONS = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.97)
_HALVINGS = 60  # bisections of the interval of the rate ξ


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


@dataclass(frozen=True)
class Norm:
    """The norm |x|_S along the delay-free loops, and the constants of V in it.

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
    """S = P, the norm in which all delay-free loops decay; None if rounding hides the decay."""
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
    """log(1 − 1/ℓ): in the mean over ℓ modes of |R_i − R_σ| the term i = σ is zero."""
    return log(1.0 - 1.0 / plant.modes)


def _best_weight(plant: SwitchedSystem, gains: Gains, norm: Norm) -> tuple[float, float]:
    """(c, log 1/ε*²), c by a coarse search, since every c > 0 gives a valid bound."""
    if plant.modes == 1:  # W = 0 and every weight will do
        return norm.omega, -math.inf
    D = plant.delay
    log_c1, kernel = closed_loop_mismatch(plant, gains, norm)

    def objective(c: float) -> float:
        square = log_sum(
            k + m - c * D + log_integral(x + y + c, D) for k, x in kernel for m, y in kernel
        )
        return c * D + log_sum((2.0 * log_c1 + norm.log_gamma2, square - math.log(c)))

    # A grid that narrows around the best point: the objective may be flat or have kinks.
    c, width = 1.0 / D, 5.0
    for _ in range(4):
        c = min((c * math.exp(width * i / 20.0) for i in range(-20, 21)), key=objective)
        width /= 8.0
    return c, objective(c)


@dataclass(frozen=True)
class Groups:
    """Inputs grouped by their delays, and the norms of their gains and columns.

    Attributes
    ----------
    delays : (g,)
        d_1 < … < d_g, seconds.
    gain, entry : (g,)
        M_q and B_q: the largest norms of a group's rows of K_i, and of its columns of B_i.
    M_B, M_K : float
        The same for all inputs together.
    growth : float
        a: |e^{F τ}| ≤ e^{aτ}, also for products, where F is any mode's A_i with the feedback of the
        groups before some group, 1/s.
    log_share : float
        log s, s = 1 − 1/ℓ for ℓ modes.
    """

    delays: tuple[float, ...]
    gain: tuple[float, ...]
    entry: tuple[float, ...]
    M_B: float
    M_K: float
    growth: float
    log_share: float

    @classmethod
    def of(cls, plant: SwitchedSystem, gains: Gains) -> Groups:
        """The groups of a plant whose modes have the same delays."""
        delays, group = np.unique(plant.delays[0], return_inverse=True)
        own = [group == q for q in range(delays.size)]
        arrived = [group < q for q in range(delays.size)]
        loops = [plant.A + plant.B[:, :, k] @ gains[:, k] for k in arrived]
        return cls(
            tuple(delays.tolist()),
            tuple(largest_norm(gains[:, k]) for k in own),
            tuple(largest_norm(plant.B[:, :, k]) for k in own),
            largest_norm(plant.B),
            largest_norm(gains),
            max(logarithmic_norm(loop) for loop in loops),
            others_share(plant),
        )

    def through(self, log_v: Sequence[float], rate: float) -> list[float]:
        """log (I − G)⁻¹v at the rate ξ by forward substitution, G strictly lower triangular."""
        result: list[float] = []
        for q, (d, gain) in enumerate(zip(self.delays, self.gain, strict=True)):
            before = [
                log(gain * self.entry[p])
                + log_integral(self.growth + rate, d - self.delays[p])
                + result[p]
                for p in range(q)
            ]
            result.append(log_sum((log_v[q], *before)))
        return result

    def from_state(self, norm: Norm, rate: float) -> list[float]:
        """log of the coefficient of |x|_S in each group: m without β/(ω − ξ) and |y|."""
        a, result = self.growth + rate, []
        for d, gain in zip(self.delays, self.gain, strict=True):
            terms = [log(gain * (norm.euclid + norm.gain)) + log_integral(a, d), log(norm.euclid)]
            if d > self.delays[0]:
                late = log_integral(a, d - self.delays[0])
                terms.append(log(gain * self.M_B * norm.euclid) + late)
            result.append(log_sum(terms))
        return result


@dataclass(frozen=True, eq=False)
class OwnDelayConstants(Constants):
    """The constants of several delays.

    Attributes
    ----------
    groups : Groups
    norm : Norm
        |x|_S, in which the delay-free loops decay.
    """

    groups: Groups
    norm: Norm

    def log_delta1(self, x: float) -> float:
        return x + self._log_slope(state=True)

    def log_delta2(self, x: float) -> float:
        return x + self._log_slope(state=False)

    def _log_slope(self, state: bool) -> float:
        """log δ₁/ε or log δ₂/ε, of all groups together."""
        own, squares = self.groups, []
        for d, gain in zip(own.delays, own.gain, strict=True):
            owed = d + (own.M_K + own.M_B) * (d - own.delays[0])
            if state:
                slope = own.growth * d + log(gain * owed + 1.0)
            else:
                size = gain * (own.M_B * owed + 1.0) + own.M_B
                slope = max(own.growth, 0.0) * d + log(size)
            squares.append(2.0 * slope)
        return own.log_share + 0.5 * log_sum(squares)

    def decay(self, x: float) -> float:
        """μ = 2ξ: the rate at which half of what is left of ε* is used, or the norm's own."""
        omega = -self.norm.growth
        used = math.log1p(math.exp(x - self.log_epsilon_star)) - math.log(2.0)
        if x - log_star(self.groups, self.norm, 0.5 * omega) <= used:
            return omega
        low, high = 0.0, 0.5 * omega
        # ε*(ξ) decreases in ξ, so bisection applies.
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            if x - log_star(self.groups, self.norm, middle) <= used:
                low = middle
            else:
                high = middle
        return 2.0 * low

    def log_rho(self, x: float) -> float:
        return max(self._log_envelope(x, state) for state in (True, False))

    def _log_envelope(self, x: float, state: bool) -> float:
        """log of the factor of |X(0)|, or of that of √∫|U₀|²."""
        own, norm, xi = self.groups, self.norm, 0.5 * self.decay(x)
        left, D = -norm.growth - xi, own.delays[-1]
        a, own_x = own.growth + xi, log(norm.from_euclid)
        # The direct contribution of X(0), or of U₀, to |x|_S, and to each group.
        alone = own_x - 0.5 * math.log(2.0 * left) if state else -math.inf
        start = []
        for d, gain, late in zip(own.delays, own.gain, own.from_state(norm, xi), strict=True):
            if state:
                first = log(gain) + 0.5 * log_integral(2.0 * a, d)
            else:
                first = xi * D + log_sum((0.0, log(gain * own.M_B) + log_integral(a, d)))
            start.append(log_sum((first, own.log_share + x + late + alone)))
        ratio = x - log_star(own, norm, xi)
        log_y = _length(own.through(start, xi)) - math.log(-math.expm1(ratio))
        log_x = log_sum((alone, log(norm.entry / left) + log_y))
        now = log_sum(
            (own_x if state else -math.inf, log_y + log(norm.entry) - 0.5 * math.log(2.0 * left))
        )
        sent = log_sum((log_y, log(norm.gain) + 0.5 * math.log(len(own.delays)) + log_x))
        before = -math.inf if state else xi * D
        return log_sum((log(norm.euclid) + now, xi * (D - own.delays[0]) + sent, before))


def log_star(groups: Groups, norm: Norm, rate: float) -> float:
    """log ε*(ξ)."""
    after, a = log(norm.entry / (-norm.growth - rate)), groups.growth + rate
    each = zip(groups.from_state(norm, rate), groups.gain, groups.delays, strict=True)
    # The state is moved by the mismatch, which also enters directly.
    m = [log_sum((after + x, log(gain) + log_integral(a, d))) for x, gain, d in each]
    return -(groups.log_share + _length(groups.through(m, rate)))


def _length(logs: Sequence[float]) -> float:
    return 0.5 * log_sum([2.0 * value for value in logs])


def own_delay_constants(
    plant: SwitchedSystem, gains: Gains, lyapunov: CommonLyapunov | None
) -> OwnDelayConstants:
    """The constants with the largest ε*, over P (unless given) and S."""
    groups = Groups.of(plant, gains)
    found = [
        OwnDelayConstants(pair, log_star(groups, norm, 0.0), groups, norm)
        for pair in (pairs_of(plant, gains) if lyapunov is None else [lyapunov])
        for norm in (weighted_norm(plant, gains, pair), euclidean(plant, gains, pair))
        if norm is not None and norm.growth < 0.0
    ]
    if not found:
        raise SolverError("no norm was found in which rounding leaves a decay of all modes.")
    return max(found, key=lambda constants: constants.log_epsilon_star)
