"""The steps that a plant can take in one period, as products of exponentials.

Over a period the plant takes y = (x, early, late) to e^{𝒜_K τ_K} … e^{𝒜_1 τ_1} y, where `early`
is the input u_{k−N} that acts for the first φ and `late` is u_{k−N+1} that acts for the rest:

    𝒜 = [[A_i, B_i, 0], [0, 0, 0]] in the first part,   [[A_i, 0, B_i], [0, 0, 0]] in the second.

Which generators act for how long depends on parameters, each in [0, 1]:

    the instant of the switch, a fraction u of the part that it falls in,
    the plant's delay, φ = (1 − f) φ_low + f φ_high,

and on the point of a polytope of plants, Σ λ_k (A^k, B^k). A `Segment` says so for one order of
events: the generator and the duration, bilinear in u and f.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deadtime.base.frozen import Frozen
from deadtime.plant import Window

ROUND_OFF = 1e-12  # of a share of a part of the period, far more than its arithmetic rounds


@dataclass(frozen=True)
class Segment:
    """A part of a period in one mode under one held input.

    The duration is phase part · fraction of it: `early` tells φ from h − φ, and `share` is
    "all", "before" (u of it) or "after" (1 − u of it).
    """

    mode: int
    early: bool
    share: str


@dataclass(frozen=True, eq=False)
class Family(Frozen):
    """A plant, or a polytope of plants, at a period, with a delay or a range of delays.

    Attributes
    ----------
    A : (vertices, modes, n, n), B : (vertices, modes, n, m)
        The corners of the polytope; one for a plant.
    step : float
        h.
    count : int
        N of the plant.
    phases : (low, high)
        The range of φ.
    """

    A: Float[np.ndarray, "vertex mode n n"]
    B: Float[np.ndarray, "vertex mode n m"]
    step: float
    count: int
    phases: tuple[float, float]

    @classmethod
    def of(cls, A: np.ndarray, B: np.ndarray, delays: tuple[float, float], step: float) -> Family:
        """The family of a range of delays; its ends must have one N."""
        low, high = (Window.of(delay, step) for delay in delays)
        phase = low.phase
        if low.count == high.count - 1 and low.phase == step:
            phase = 0.0  # the range starts where u_{k−N+1} is not yet seen: φ = 0 of the next N
        elif low.count != high.count:
            raise ValueError("a range of delays must lie in one period")
        return cls(A, B, step, high.count, (phase, high.phase))

    @property
    def split(self) -> bool:
        """Whether a second held input acts in a period."""
        return not self.phases[0] == self.phases[1] == self.step

    @property
    def taps(self) -> tuple[int, ...]:
        """The past inputs that the plant reads, j of u_{k−j}."""
        return (self.count, self.count - 1) if self.split else (self.count,)

    @property
    def ranges(self) -> bool:
        """Whether the delay is a range."""
        return self.phases[0] != self.phases[1]

    def orders(self, mode: int, after: int) -> list[tuple[Segment, ...]]:
        """The orders of events in a period from `mode` to `after`; one for a full step."""
        if mode == after:
            parts = [Segment(mode, True, "all")]
            return [(*parts, Segment(mode, False, "all"))] if self.split else [tuple(parts)]
        first = [Segment(mode, True, "before"), Segment(after, True, "after")]
        if not self.split:
            return [tuple(first)]
        return [
            (*first, Segment(after, False, "all")),
            (
                Segment(mode, True, "all"),
                Segment(mode, False, "before"),
                Segment(after, False, "after"),
            ),
        ]

    def shares(
        self, order: tuple[Segment, ...], instants: tuple[float, float] = (0.0, 1.0)
    ) -> tuple[float, float] | None:
        """The range of u that holds all switches between two fractions of the period.

        None if no switch of this order of events lies there; (0, 1) for a full step.
        """
        if order[0].mode == order[-1].mode:
            return 0.0, 1.0
        if not self.split:
            return instants
        low, high = (fraction * self.step for fraction in instants)
        first, last = self.phases
        if order[0].share == "before":  # u = s/φ
            least, most = low / last, high / first if first else 1.0
        else:  # u = (s − φ)/(h − φ), which falls with φ
            least = (low - last) / (self.step - last) if last < self.step else 0.0
            most = (high - first) / (self.step - first)
        part = self.step - last if order[0].share == "all" else first or last
        wrong = ROUND_OFF + 8.0 * np.spacing(self.step * (self.count + 1)) / max(part, 1e-300)
        least, most = least - wrong, most + wrong
        return (max(0.0, least), min(1.0, most)) if least <= 1.0 and most >= 0.0 else None

    def generators(self, early: bool) -> Float[np.ndarray, "vertex mode k k"]:
        """𝒜 of every corner and mode."""
        corners, modes, n, m = self.B.shape
        size = n + m * len(self.taps)
        result = np.zeros((corners, modes, size, size))
        result[:, :, :n, :n] = self.A
        if early or self.split:
            at = n if early else n + m
            result[:, :, :n, at : at + m] = self.B
        return result

    def sample(
        self,
        order: tuple[Segment, ...],
        u: float = 0.0,
        f: float = 0.0,
        weights: np.ndarray | None = None,
    ) -> Float[np.ndarray, "n k"]:
        """The plant's rows E of x⁺ = E y at one point of the parameters, in floating point."""
        from scipy.linalg import expm

        n = self.A.shape[2]
        phase = (1.0 - f) * self.phases[0] + f * self.phases[1]
        weights = np.full(len(self.A), 1.0 / len(self.A)) if weights is None else weights
        share = {"all": 1.0, "before": u, "after": 1.0 - u}
        result: np.ndarray = np.eye(n + self.B.shape[3] * len(self.taps))
        for part in order:
            part_time = phase if part.early else self.step - phase
            generator = np.tensordot(weights, self.generators(part.early)[:, part.mode], 1)
            result = expm(generator * (part_time * share[part.share])) @ result
        return result[:n]

    def corners(self, order: tuple[Segment, ...], instants: np.ndarray) -> np.ndarray:
        """Samples at the given u, the ends of the delay's range, and the corners of the polytope.

        Returns (samples, n, k): what a search for a certificate looks at before the proof.
        """
        switches = any(part.share != "all" for part in order)
        us = instants if switches else np.zeros(1)
        fs = (0.0, 1.0) if self.ranges else (0.0,)
        points = np.eye(len(self.A))
        return np.stack([self.sample(order, u, f, w) for u in us for f in fs for w in points])
