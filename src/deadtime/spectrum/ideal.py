"""The ideal loop with one mode held: its characteristic matrix, and the windows of its law.

    dx/dt = A x(t) + Σ_j b_j u_j(t − D_j),    u(t) = F x(t) + ∫ w(τ) u(t − τ) dτ,

the D_j of the plant, F and w of the law. A motion (x, u) = (X, U) e^{st} solves Δ(s) (X, U) = 0,

    Δ(s) = [[sI − A, −B diag(e^{−sD_j})], [−F, I − W(s)]],    W(s) = ∫ e^{−sτ} w(τ) dτ,

an entire function of s. A law depends on past inputs through windows,

    u(t) = F x(t) + Σ_p C_p ∫ e^{S_p (τ − α_p)} R_p u(t − τ) dτ,    τ from α_p to β_p,

of a `Functional`, or of a `Forecast` after the mode has been held throughout. Then

    W(s) = Σ_p W_p(s),    W_p(s) = C_p ∫ e^{S_p (τ − α_p)} e^{−sτ} dτ R_p
         = C_p (sI − S_p)⁻¹ (e^{−sα_p} − e^{−sβ_p} e^{S_p (β_p − α_p)}) R_p,

where the integral, unlike (sI − S_p)⁻¹, is finite at the eigenvalues of S_p.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from deadtime.base.errors import ArgumentError
from deadtime.feedback import Forecast, Functional, Law
from deadtime.feedback.table import require_finite_gains
from deadtime.plant import SwitchedSystem
from deadtime.switching import SwitchingSignal

# A Gauss panel of _NODES nodes integrates e^{at} to round-off for |a| · length ≤ _RATE.
_NODES, _RATE = 16, 8.0
_MOST_PANELS = 100_000


class LawWindow(NamedTuple):
    """One window of a law on its past inputs.

    C : (m, q), S : (q, q), R : (q, m);  near, far : α ≤ β, seconds;
    ending : (m, q), C e^{S (β − α)}
    """

    C: np.ndarray
    S: np.ndarray
    R: np.ndarray
    near: float
    far: float
    ending: np.ndarray

    @classmethod
    def balanced(
        cls, C: np.ndarray, S: np.ndarray, R: np.ndarray, near: float, far: float
    ) -> LawWindow:
        """A window with S balanced: a change of the states' units, without effect on W."""
        from deadtime.numerics.exponential import balance, discretise

        r = balance(S)
        C, S, R = C * r, S * r / r[:, None], R / r[:, None]
        return cls(C, S, R, near, far, C @ discretise(S, R, far - near)[0])

    def transform(
        self, s: Complex[np.ndarray, " point"]
    ) -> tuple[Complex[np.ndarray, "point m m"], Complex[np.ndarray, "point m m"]]:
        """W_p(s) and its slope, far from the eigenvalues of S."""
        at = s[:, None, None]
        shifted = at * np.eye(self.S.shape[0]) - self.S
        once = np.linalg.solve(shifted, np.broadcast_to(self.R + 0j, (s.size, *self.R.shape)))
        twice = np.linalg.solve(shifted, once)
        early, late = np.exp(-at * self.near), np.exp(-at * self.far)
        slope = late * (self.ending @ (self.far * once + twice))
        slope -= early * (self.C @ (self.near * once + twice))
        return early * (self.C @ once) - late * (self.ending @ once), slope


def windows_of(
    law: Functional | Forecast, units: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "m n"], tuple[LawWindow, ...]]:
    """F for a state x in `units`, and the windows of a law with its mode held."""
    held = law.settled
    row = int(held.row(np.zeros(1))[0])
    pieces = zip(held.C[row], held.S, held.R, held.near.tolist(), held.far.tolist(), strict=True)
    return held.F[row] * units, tuple(LawWindow.balanced(*piece) for piece in pieces)


def weights(
    windows: Sequence[LawWindow], rate: float
) -> tuple[Float[np.ndarray, " node"], Float[np.ndarray, "node m m"]]:
    """τ_j and taps: W(s) = Σ_j e^{−sτ_j} taps_j to round-off for |s| + |S| up to `rate`, 1/s."""
    m = windows[0].C.shape[0]
    parts = [(np.empty(0), np.empty((0, m, m)))]
    parts += [_weights(window, rate) for window in windows if window.far > window.near]
    tau, taps = zip(*parts, strict=True)
    return np.concatenate(tau), np.concatenate(taps)


def _weights(window: LawWindow, rate: float) -> tuple[np.ndarray, np.ndarray]:
    from deadtime.numerics.exponential import discretise

    S, R, whole_length = window.S, window.R, window.far - window.near
    if not rate * whole_length <= _RATE * _MOST_PANELS:
        raise ArgumentError(
            f"delay must be shorter for characteristic roots: the loop's fastest rate times the "
            f"delay is {rate * whole_length:.3g}, and at most {_RATE * _MOST_PANELS:.0g} is "
            "possible."
        )
    panels = int(np.ceil(rate * whole_length / _RATE)) + 1
    length = whole_length / panels
    z, weight = np.polynomial.legendre.leggauss(_NODES)
    first = (z + 1.0) / 2.0 * length
    inside = (
        np.stack([discretise(S, R, t)[0] @ R for t in first])
        * (weight / 2.0 * length)[:, None, None]
    )
    whole, row, taps = discretise(S, R, length)[0], window.C, []
    for _ in range(panels):
        taps.append(row @ inside)
        row = row @ whole
    tau = window.near + (np.arange(panels)[:, None] * length + first).ravel()
    return tau, np.concatenate(taps)


_TERMS = 60  # of the series in `radius`, whose bound halves from term to term


@dataclass(frozen=True, eq=False)
class IdealLoop:
    """A plant in one mode under a law updated continuously, in balanced states (immutable).

    Attributes
    ----------
    A : (n, n), B : (n, m), delays : (m,)
        The plant's mode and D_j, seconds.
    F : (m, n), windows : tuple of Window
        The law; windows of length 0 if it predicts nothing.
    tau : (nodes,), taps : (nodes, m, m)
        W(s) = Σ_j e^{−sτ_j} taps_j to round-off for |s| ≤ `near`.
    near : float
        Twice the largest of the norms of A and all S and one over the longest delay, 1/s.
    rate : float
        The largest of the norms of A, F B and all S and C R, 1/s: the rate of the loop without
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
        """The age of the oldest input that the law reads, seconds; 0 without a prediction."""
        return max(window.far for window in self.windows)

    @property
    def pipes(self) -> list[tuple[float, Float[np.ndarray, "n m"]]]:
        """The distinct delays of the plant, seconds, each with the columns of B that have it."""
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
        """The size of the terms of each entry of Δ(s); times ε, the round-off of the entry."""
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
        """The smaller of `rate` and 1/T, 1/s: roughly the least distance of two roots."""
        return min(1.0 / self.longest, self.rate)

    def radius(self, right: float, any_delay: bool = False) -> float:
        """R: every root with Re s ≥ `right` has |s| < R; with `any_delay`, for all delays.

        With Y(s) = W(s) + F (sI − A)⁻¹ B diag(e^{−sD_j}) a root beyond |A| makes I − Y(s)
        singular. Both ends of a window and every delay of the plant are edges θ of the past,

            Y(s) = Σ_e e^{−sθ_e} H_e (sI − S_e)⁻¹ R_e,

        (H, S, R) = (C, S, R) at θ = α, (−C e^{S(β − α)}, S, R) at β and (F, A, b_j e_jᵀ) at D_j.
        For |s| above all |S_e| the inverses are geometric series,

            Y(s) = Σ_k s^{−k−1} Σ_θ e^{−sθ} Σ_{e: θ_e = θ} H_e S_e^k R_e,

        whose terms are bounded one by one, edges of equal θ added first: where model and plant
        agree, the arriving input cancels the end of a window, however large the gains. For any
        delays and Re s ≥ 0 all of B is one edge: |F A^k B diag(e^{−sD_j})| ≤ |F A^k B|.
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
