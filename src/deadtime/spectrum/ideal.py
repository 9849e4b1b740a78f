"""The ideal loop with one mode held, as a characteristic matrix.

A law updated continuously is a sum over branches (`feedback.forecast`). While one mode lasts for
ever each branch stays in one system, and all together are one frozen system (S, R), the
branches' A and B stacked, that starts from L x(t) and is read by K, the branches' gains side by
side:

    u(t) = F x(t) + ∫₀^D̂ w(τ) u(t − τ) dτ,    w(τ) = K e^{Sτ} R,    F = K e^{S D̂} L,
    dx/dt = A x(t) + B u(t − D),

D the plant's delay and D̂ the law's. A motion (x, u) = (X, U) e^{st} solves Δ(s) (X, U) = 0,

    Δ(s) = [[sI − A, −e^{−sD} B], [−F, I − W(s)]],    W(s) = ∫₀^D̂ e^{−sτ} w(τ) dτ,

an entire function of s: where sI − S is singular the integral is not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float

from deadtime.base.errors import ArgumentError
from deadtime.feedback import Forecast, Law
from deadtime.feedback.table import require_finite_gains
from deadtime.plant import SwitchedSystem
from deadtime.switching import SwitchingSignal

# A Gauss panel of so many nodes integrates e^{at} to round-off for |a| · length ≤ _RATE.
_NODES, _RATE = 16, 8.0
_MOST_PANELS = 100_000
_TERMS = 60


@dataclass(frozen=True, eq=False)
class IdealLoop:
    """A plant in one mode under a law updated continuously, in balanced states (immutable).

    Attributes
    ----------
    A : (n, n), B : (n, m), delay : float
        The plant's mode and D, seconds.
    K : (m, q), S : (q, q), R : (q, m), lead : float
        The law and D̂, seconds; 0 for a law that predicts nothing.
    F : (m, n)
        K e^{S D̂} L.
    KE : (m, q)
        K e^{S D̂}.
    tau : (nodes,), taps : (nodes, m, m)
        ∫₀^D̂ e^{−sτ} w(τ) dτ = Σ_j e^{−sτ_j} taps_j to round-off for |s| ≤ `near`.
    near : float
        Twice the largest of the norms of A and S and one over the longer delay, 1/s.
    rate : float
        The largest of the norms of A, S, F B and K R, 1/s: how fast the loop is but for its delay.
    """

    A: Float[np.ndarray, "n n"]
    B: Float[np.ndarray, "n m"]
    delay: float
    K: Float[np.ndarray, "m q"]
    S: Float[np.ndarray, "q q"]
    R: Float[np.ndarray, "q m"]
    lead: float
    F: Float[np.ndarray, "m n"]
    KE: Float[np.ndarray, "m q"]
    tau: Float[np.ndarray, " node"]
    taps: Float[np.ndarray, "node m m"]
    near: float
    rate: float

    @classmethod
    def of(cls, plant: SwitchedSystem, law: Law, mode: int) -> IdealLoop:
        """The loop with one mode held.

        Raises `ArgumentError` if the law has no closed form in continuous time.
        """
        from deadtime.numerics.exponential import balance, discretise

        delay = plant.one_delay("characteristic roots")
        A, B = plant.A[mode], plant.B[mode]
        forecast = law.ideal(SwitchingSignal.constant(mode), 0.0)
        if not isinstance(forecast, Forecast):
            raise ArgumentError(
                "law must have a model with one delay for characteristic roots, got "
                f"delay={law.plant.delay_text}: give a step for the growth of the digital loop."
            )
        K, S, R, L = _terms_in_aged_mode(forecast)
        t, r = balance(A), balance(S)
        A, B, L = A * t / t[:, None], B / t[:, None], L * t / r[:, None]
        K, S, R, lead = K * r, S * r / r[:, None], R / r[:, None], forecast.lead
        KE = K @ discretise(S, R, lead)[0]
        require_finite_gains(KE, KE @ L @ B)
        norms = np.linalg.norm(A, 2), np.linalg.norm(S, 2), 1.0 / max(delay, lead)
        near = 2.0 * float(max(norms))
        tau, taps = weights(K, S, R, lead, 1.5 * near)
        F = KE @ L
        rate = float(max(*norms[:2], np.linalg.norm(F @ B, 2), np.linalg.norm(K @ R, 2)))
        rate = rate or 1.0 / max(delay, lead)
        return cls(A, B, delay, K, S, R, lead, F, KE, tau, taps, near, rate)

    def memory(
        self, s: Complex[np.ndarray, " point"]
    ) -> tuple[Complex[np.ndarray, "point m m"], Complex[np.ndarray, "point m m"]]:
        """W(s) and W'(s)."""
        m = self.B.shape[1]
        W, slope = np.zeros((2, s.size, m, m), complex)
        if self.lead == 0.0:
            return W, slope
        inside = np.abs(s) <= self.near
        decay = np.exp(-s[inside, None] * self.tau)
        W[inside] = np.tensordot(decay, self.taps, 1)
        slope[inside] = -np.tensordot(decay * self.tau, self.taps, 1)
        # W = K (sI − S)⁻¹ (R − e^{−sD̂} e^{SD̂} R), where the inverse is far from singular.
        far = s[~inside, None, None]
        shifted = far * np.eye(self.S.shape[0]) - self.S
        once = np.linalg.solve(shifted, np.broadcast_to(self.R + 0j, (far.size, *self.R.shape)))
        twice = np.linalg.solve(shifted, once)
        late = np.exp(-far * self.lead)
        W[~inside] = self.K @ once - late * (self.KE @ once)
        slope[~inside] = late * (self.KE @ (self.lead * once + twice)) - self.K @ twice
        return W, slope

    def matrix(
        self, s: Complex[np.ndarray, " point"]
    ) -> tuple[Complex[np.ndarray, "point k k"], Complex[np.ndarray, "point k k"]]:
        """Δ(s) and Δ'(s), of order k = n + m."""
        n, m = self.B.shape
        W, slope = self.memory(s)
        Delta, prime = np.zeros((2, s.size, n + m, n + m), complex)
        late = np.exp(-s * self.delay)[:, None, None] * self.B
        Delta[:, :n, :n] = s[:, None, None] * np.eye(n) - self.A
        Delta[:, :n, n:] = -late
        Delta[:, n:, :n] = -self.F
        Delta[:, n:, n:] = np.eye(m) - W
        prime[:, :n, :n] = np.eye(n)
        prime[:, :n, n:] = self.delay * late
        prime[:, n:, n:] = -slope
        return Delta, prime

    def magnitude(self, s: Complex[np.ndarray, " point"]) -> Float[np.ndarray, "point k k"]:
        """How large the numbers are that Δ(s) is the sum of, entry by entry: its round-off."""
        n, m = self.B.shape
        size = np.zeros((s.size, n + m, n + m))
        absolute = np.abs(s)[:, None, None]
        late = np.exp(-np.real(s) * self.delay)[:, None, None]
        ahead = 1.0 + np.linalg.norm(self.S) * self.lead  # of e^{SD̂}
        window = np.tensordot(np.exp(-np.real(s)[:, None] * self.tau), np.abs(self.taps), 1)
        size[:, :n, :n] = absolute + np.linalg.norm(self.A)
        size[:, :n, n:] = late * (1.0 + absolute * self.delay) * np.abs(self.B)
        size[:, n:, :n] = ahead * np.abs(self.F)
        size[:, n:, n:] = 1.0 + ahead * window
        return size

    @property
    def longest(self) -> float:
        """T, the longer delay, seconds."""
        return max(self.delay, self.lead)

    @property
    def unit(self) -> float:
        """How far apart roots are at least, roughly: `rate`, or 1/T where that is less, 1/s."""
        return min(1.0 / self.longest, self.rate)

    def radius(self, right: float, any_delay: bool = False) -> float:
        """R: every root with Re s ≥ `right` has |s| < R; if asked for, whatever the delay.

        With Y(s) = W(s) + F (sI − A)⁻¹ B e^{−sD} a root beyond |A| makes I − Y(s) singular. For
        |s| > max(|A|, |S|) both inverses are geometric series,

            Y(s) = Σ_k s^{−k−1} (K S^k R + K e^{SD̂} (L A^k B e^{−sD} − S^k R e^{−sD̂})),

        whose terms are bounded one by one. Where model and plant agree the last two cancel,
        however large the gains.
        """
        unit, shift = 2.0 * self.rate, 0.0 if any_delay else right
        own, ahead = np.exp(-shift * self.delay), np.exp(-shift * self.lead)
        alike = self.delay == self.lead and not any_delay
        A, S, FA, KS, KES = self.A / unit, self.S / unit, self.F, self.K, self.KE
        terms = []
        for _ in range(_TERMS):
            law, arriving, window = KS @ self.R, own * (FA @ self.B), ahead * (KES @ self.R)
            if self.lead == 0.0:
                parts = [arriving]
            else:
                parts = [law, arriving - window] if alike else [law, arriving, window]
            terms.append(sum(np.linalg.norm(part, 2) for part in parts) / unit)
            FA, KS, KES = FA @ A, KS @ S, KES @ S
        powers = -1.0 - np.arange(_TERMS)
        low = high = 1.0
        while terms @ high**powers > 0.99:
            low, high = high, 2.0 * high
        while high > 1.001 * low:
            middle = np.sqrt(low * high)
            low, high = (middle, high) if terms @ middle**powers > 0.99 else (low, middle)
        return float(high * unit)


def weights(
    K: np.ndarray, S: np.ndarray, R: np.ndarray, lead: float, rate: float
) -> tuple[Float[np.ndarray, " node"], Float[np.ndarray, "node m m"]]:
    """τ_j and the taps that integrate w(τ) = K e^{Sτ} R against functions of a rate in 1/s."""
    from deadtime.numerics.exponential import discretise

    if lead == 0.0:
        return np.empty(0), np.empty((0, R.shape[1], R.shape[1]))
    if not rate * lead <= _RATE * _MOST_PANELS:
        raise ArgumentError(
            f"delay must be shorter for characteristic roots: the loop's fastest rate times the "
            f"delay is {rate * lead:.3g}, and at most {_RATE * _MOST_PANELS:.0g} is possible."
        )
    panels = int(np.ceil(rate * lead / _RATE)) + 1
    length = lead / panels
    z, weight = np.polynomial.legendre.leggauss(_NODES)
    first = (z + 1.0) / 2.0 * length
    inside = (
        np.stack([discretise(S, R, t)[0] @ R for t in first])
        * (weight / 2.0 * length)[:, None, None]
    )
    whole, row, taps = discretise(S, R, length)[0], K, []
    for _ in range(panels):
        taps.append(row @ inside)
        row = row @ whole
    return (np.arange(panels)[:, None] * length + first).ravel(), np.concatenate(taps)


def _terms_in_aged_mode(
    forecast: Forecast,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """K, S, R, L of a forecast in a mode that has been held throughout."""
    from scipy.linalg import block_diag

    start = forecast.until(np.zeros(1))
    late = np.maximum(start, 0.0) + 1.0 if np.isfinite(start[0]) else np.zeros(1)
    stays = forecast.until(late)[0] > late[0]
    ends = forecast.path(late).repeat(forecast.branches.size) if stays else forecast.branches
    gains = forecast.gains(late)[0]
    n = forecast.A.shape[1]
    lift = np.eye(n) if forecast.lift is None else forecast.lift
    S = np.asarray(block_diag(*forecast.A[ends]))
    R = np.concatenate([forecast.B[e] for e in ends])
    return np.concatenate(list(gains), axis=1), S, R, np.tile(lift, (ends.size, 1))
