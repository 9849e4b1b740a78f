"""The ideal loop with one mode held, as a characteristic matrix.

    dx/dt = A x(t) + Σ_j b_j u_j(t − D_j),    u(t) = F x(t) + ∫ w(τ) u(t − τ) dτ,

the D_j of the plant, F and w of the law: the windows of `deadtime.spectrum.input_windows`. A motion
(x, u) = (X, U) e^{st} solves Δ(s) (X, U) = 0,

    Δ(s) = [[sI − A, −B diag(e^{−sD_j})], [−F, I − W(s)]],    W(s) = ∫ e^{−sτ} w(τ) dτ,

an entire function of s.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

import numpy as np
from jaxtyping import Complex, Float

from deadtime.feedback import Law
from deadtime.feedback.table import require_finite_gains
from deadtime.plant import SwitchedSystem
from deadtime.spectrum.input_windows import LawWindow, weights, windows_of
from deadtime.switching import SwitchingSignal

_TERMS = 60


@dataclass(frozen=True, eq=False)
class IdealLoop:
    """A plant in one mode under a law updated continuously, in balanced states (immutable).

    Attributes
    ----------
    A : (n, n), B : (n, m), delays : (m,)
        The plant's mode and D_j, seconds.
    F : (m, n), windows : tuple of Window
        The law; of length 0 if it predicts nothing.
    tau : (nodes,), taps : (nodes, m, m)
        W(s) = Σ_j e^{−sτ_j} taps_j to round-off for |s| ≤ `near`.
    near : float
        Twice the largest of the norms of A and all S and one over the longest delay, 1/s.
    rate : float
        The largest of the norms of A, F B and all S and C R, 1/s: how fast the loop is but for
        its delays.
    """

    A: Float[np.ndarray, "n n"]
    B: Float[np.ndarray, "n m"]
    delays: Float[np.ndarray, " m"]
    F: Float[np.ndarray, "m n"]
    windows: tuple[LawWindow, ...]
    tau: Float[np.ndarray, " node"]
    taps: Float[np.ndarray, "node m m"]
    near: float
    rate: float

    @classmethod
    def of(cls, plant: SwitchedSystem, law: Law, mode: int) -> IdealLoop:
        """The loop with one mode held.

        Raises `ArgumentError` if the law has no closed form in continuous time.
        """
        from deadtime.numerics.exponential import balance

        A, B, delays = plant.A[mode], plant.B[mode], plant.delays[mode]
        t = balance(A)
        A, B = A * t / t[:, None], B / t[:, None]
        F, windows = windows_of(law.ideal(SwitchingSignal.constant(mode), 0.0), t)
        require_finite_gains(F @ B, *(window.ending for window in windows))
        longest = max(float(delays.max()), *(window.far for window in windows))
        own = [np.linalg.norm(X, 2) for X in (A, *(window.S for window in windows))]
        near = 2.0 * float(max(*own, 1.0 / longest))
        tau, taps = weights(windows, 1.5 * near)
        gains = [np.linalg.norm(X, 2) for X in (F @ B, *(w.C @ w.R for w in windows))]
        rate = float(max(*own, *gains)) or 1.0 / longest
        return cls(A, B, delays, F, windows, tau, taps, near, rate)

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
        for window in self.windows:
            part, change = window.transform(s[~inside])
            W[~inside] += part
            slope[~inside] += change
        return W, slope

    @property
    def lead(self) -> float:
        """How far back the law looks, seconds; 0 for one that predicts nothing."""
        return max(window.far for window in self.windows)

    @property
    def pipes(self) -> list[tuple[float, Float[np.ndarray, "n m"]]]:
        """The distinct delays of the plant, seconds, each with the inputs that have it."""
        return [
            (delay, np.where(self.delays == delay, self.B, 0.0))
            for delay in np.unique(self.delays).tolist()
        ]

    def matrix(
        self, s: Complex[np.ndarray, " point"]
    ) -> tuple[Complex[np.ndarray, "point k k"], Complex[np.ndarray, "point k k"]]:
        """Δ(s) and Δ'(s), of order k = n + m."""
        n, m = self.B.shape
        W, slope = self.memory(s)
        Delta, prime = np.zeros((2, s.size, n + m, n + m), complex)
        late = np.exp(-s[:, None] * self.delays)[:, None, :] * self.B
        Delta[:, :n, :n] = s[:, None, None] * np.eye(n) - self.A
        Delta[:, :n, n:] = -late
        Delta[:, n:, :n] = -self.F
        Delta[:, n:, n:] = np.eye(m) - W
        prime[:, :n, :n] = np.eye(n)
        prime[:, :n, n:] = self.delays * late
        prime[:, n:, n:] = -slope
        return Delta, prime

    def magnitude(self, s: Complex[np.ndarray, " point"]) -> Float[np.ndarray, "point k k"]:
        """How large the numbers are that Δ(s) is the sum of, entry by entry: its round-off."""
        n, m = self.B.shape
        size = np.zeros((s.size, n + m, n + m))
        absolute = np.abs(s)[:, None, None]
        late = np.exp(-np.real(s)[:, None] * self.delays)[:, None, :]
        ahead = 1.0 + max(np.linalg.norm(w.S) for w in self.windows) * self.lead  # of e^{Sτ}
        window = np.tensordot(np.exp(-np.real(s)[:, None] * self.tau), np.abs(self.taps), 1)
        size[:, :n, :n] = absolute + np.linalg.norm(self.A)
        size[:, :n, n:] = late * (1.0 + absolute * self.delays) * np.abs(self.B)
        size[:, n:, :n] = ahead * np.abs(self.F)
        size[:, n:, n:] = 1.0 + ahead * window
        return size

    @property
    def longest(self) -> float:
        """T, the longest delay of the plant or the law, seconds."""
        return max(float(self.delays.max()), self.lead)

    @property
    def unit(self) -> float:
        """How far apart roots are at least, roughly: `rate`, or 1/T where that is less, 1/s."""
        return min(1.0 / self.longest, self.rate)

    def radius(self, right: float, any_delay: bool = False) -> float:
        """R: every root with Re s ≥ `right` has |s| < R; if asked for, whatever the delays.

        With Y(s) = W(s) + F (sI − A)⁻¹ B diag(e^{−sD_j}) a root beyond |A| makes I − Y(s)
        singular. Both ends of a window and every delay of the plant are edges θ of the past,

            Y(s) = Σ_e e^{−sθ_e} H_e (sI − S_e)⁻¹ R_e,

        (H, S, R) = (C, S, R) at θ = α, (−C e^{S(β − α)}, S, R) at β and (F, A, b_j e_jᵀ) at D_j.
        For |s| above all |S_e| the inverses are geometric series,

            Y(s) = Σ_k s^{−k−1} Σ_θ e^{−sθ} Σ_{e: θ_e = θ} H_e S_e^k R_e,

        whose terms are bounded one by one, those of one θ added first. Where model and plant agree
        what arrives cancels what the windows end with, however large the gains. Where delays may
        be any, for Re s ≥ 0, all of B is one edge: |F A^k B diag(e^{−sD_j})| ≤ |F A^k B|.
        """
        unit, shift = 2.0 * self.rate, 0.0 if any_delay else right
        pipes = [(None, self.B)] if any_delay else self.pipes
        edges = chain(
            ((w.near, w.C, w.S, w.R) for w in self.windows),
            ((delay, self.F, self.A, B) for delay, B in pipes),
            ((w.far, -w.ending, w.S, w.R) for w in self.windows),
        )
        together: dict[float | None, list[list[np.ndarray]]] = {}
        for theta, H, S, R in edges:
            together.setdefault(theta, []).append([H, S / unit, R])
        terms = []
        for _ in range(_TERMS):
            size = 0.0
            for theta, group in together.items():
                decay = np.exp(-shift * (theta or 0.0))
                size += np.linalg.norm(sum(decay * (H @ R) for H, _, R in group), 2)
                for edge in group:
                    edge[0] = edge[0] @ edge[1]
            terms.append(size / unit)
        return unit * _least_power(np.array(terms))


def _least_power(terms: np.ndarray) -> float:
    """About the least r ≥ 1 with Σ_k terms_k r^{−k−1} ≤ 0.99."""
    powers = -1.0 - np.arange(terms.size)
    low = high = 1.0
    while terms @ high**powers > 0.99:
        low, high = high, 2.0 * high
    while high > 1.001 * low:
        middle = np.sqrt(low * high)
        low, high = (middle, high) if terms @ middle**powers > 0.99 else (low, middle)
    return float(high)
