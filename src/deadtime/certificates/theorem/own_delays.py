"""The theorem with a delay per input, the same in all modes, proved in docs/theory/constants.md.

The inputs are sorted into groups of equal delay, d_1 < … < d_g. With the mismatch of group q as
it arrives, y_q(s) = W_q(s − d_q), the state moves as X' = (A_σ + B_σ K_σ) X + B_σ y, and along the
averaged law, x and y at s − r in the integrals,

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

from deadtime.base.errors import SolverError
from deadtime.certificates.theorem.constants import Constants, Gains, largest_norm
from deadtime.certificates.theorem.sharp import (
    Norm,
    euclidean,
    logarithmic_norm,
    others_share,
    pairs_of,
    weighted_norm,
)
from deadtime.gains import CommonLyapunov
from deadtime.numerics.logarithms import log, log_integral, log_sum
from deadtime.plant import SwitchedSystem

_HALVINGS = 60  # of the interval in which the rate ξ lies


@dataclass(frozen=True)
class Groups:
    """The inputs by their delays, and the sizes in which they enter.

    Attributes
    ----------
    delays : (g,)
        d_1 < … < d_g, seconds.
    gain, entry : (g,)
        M_q and B_q: the largest norms of their rows of K_i, and of their columns of B_i.
    M_B, M_K : float
        Of all inputs.
    growth : float
        a: |e^{F τ}| ≤ e^{aτ}, also for products, F any mode's A_i with the feedback of those that
        arrive before the last, 1/s.
    log_share : float
        log s, s = l/(l + 1).
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
        """log (I − G)⁻¹v at the rate ξ: what the groups before have made is added, in order."""
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
        """log of what |x|_S brings about in each group, m without β/(ω − ξ) and |y|."""
        a, result = self.growth + rate, []
        for d, gain in zip(self.delays, self.gain, strict=True):
            terms = [
                log(gain * (norm.euclid + norm.gain)) + log_integral(a, d),
                log(norm.euclid),
            ]
            if d > self.delays[0]:
                late = log_integral(a, d - self.delays[0])
                terms.append(log(gain * self.M_B * norm.euclid) + late)
            result.append(log_sum(terms))
        return result

    def from_mismatch(self, rate: float) -> list[float]:
        """log of what |y| brings about in each group by itself."""
        a = self.growth + rate
        return [
            log(gain) + log_integral(a, d) for d, gain in zip(self.delays, self.gain, strict=True)
        ]


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
        # What X(0), or U₀, brings about in |x|_S by itself, and in each group.
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
    after = log(norm.entry / (-norm.growth - rate))
    m = [
        log_sum((after + of_state, of_mismatch))
        for of_state, of_mismatch in zip(
            groups.from_state(norm, rate), groups.from_mismatch(rate), strict=True
        )
    ]
    return -(groups.log_share + _length(groups.through(m, rate)))


def _length(logs: Sequence[float]) -> float:
    """log of the Euclidean norm."""
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
