"""The possible steps of a plant over one period, as products of exponentials.

Over a period the plant takes y = (x, the inputs read) to e^{𝒜_K τ_K} … e^{𝒜_1 τ_1} y. With a
delay D, N = ⌈D/h⌉ and φ = D − (N − 1) h, u_{k−N} acts for the first φ and u_{k−N+1} for the rest.
So marks, 0, the φ of all delays and h, cut the period in parts, and in part p mode i reads its
inputs `lags[i][p]` samples ago:

    marks        0            φ₁             φ₂           h
    lags of i    | lags[i][0] |  lags[i][1]  | lags[i][2] |

    𝒜 = [[A_i, B_i in the columns of these inputs], [0, 0]].

The generators and their durations depend on parameters, each in [0, 1]:

    the instant of the switch, a fraction u of the part that it falls in,
    the plant's delay, φ = (1 − f) φ_low + f φ_high, where there is one and it has a range,

and on the point of a polytope of plants, Σ λ_k (A^k, B^k). A `Segment` is a generator and its
duration, bilinear in u and f, in one order of events.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float

from deadtime.base.frozen import Frozen
from deadtime.plant import SwitchedSystem, Window
from deadtime.plant.discretisation import windows_of
from deadtime.plant.plant_set import PlantSet

ROUND_OFF = 1e-12  # of a fraction of a part: far above the rounding error of its arithmetic


@dataclass(frozen=True, eq=False)
class Steps(Frozen, ABC):
    """The possible steps of a set of plants over a sampling period.

    Attributes
    ----------
    plants : PlantSet
    step : float
        h.
    """

    plants: PlantSet
    step: float

    @property
    def states(self) -> int:
        """n."""
        return self.plants.sizes[1]

    @cached_property
    def reads(self) -> tuple[tuple[int, int], ...]:
        """The past inputs that the plant reads, (lag, input), the oldest first."""
        return tuple(sorted(self._received(), key=lambda read: (-read[0], read[1])))

    @abstractmethod
    def _received(self) -> set[tuple[int, int]]:
        """The past inputs that some mode reads, (lag, input)."""

    @abstractmethod
    def ends(self, order: Any) -> Sequence[float | tuple[float, ...]]:
        """The corners of the delays that a step depends on."""

    @abstractmethod
    def switches(self, order: Any) -> bool:
        """Whether a step has a switch; a full step has none."""

    @abstractmethod
    def sample(
        self, order: Any, u: float = 0.0, f: Any = 0.0, weights: np.ndarray | None = None
    ) -> Float[np.ndarray, "n k"]:
        """The plant's rows E of x⁺ = E y at one point of the parameters, in floating point.

        Without weights at the centre of the polytope.
        """

    def corners(self, order: Any, instants: np.ndarray) -> np.ndarray:
        """Samples at the given u, at the ends of the delays, and the corners of the polytope.

        Returns (samples, n, k), the samples on which a search for a certificate is based.
        """
        us = instants if self.switches(order) else np.zeros(1)
        ends, points = self.ends(order), np.eye(len(self.plants.A))
        return np.stack([self.sample(order, u, f, w) for u in us for f in ends for w in points])

    def _weights(self, weights: np.ndarray | None) -> np.ndarray:
        count = len(self.plants.A)
        return np.full(count, 1.0 / count) if weights is None else weights


@dataclass(frozen=True)
class DelayInterval:
    """A range of a delay: N, φ_low and φ_high in seconds, and both ends of the delay as given."""

    count: int
    low: float
    high: float
    delays: tuple[float, float]

    @classmethod
    def of(cls, low: float, high: float, step: float) -> DelayInterval:
        """The interval between two delays of one N; φ_low may be 0, the end of N − 1 before."""
        first, last = Window.of(low, step), Window.of(high, step)
        phase = first.phase
        if first.count == last.count - 1 and first.phase == step:
            phase = 0.0  # a delay of whole periods is φ = h of its N, and φ = 0 of the next N
        elif first.count != last.count:
            raise ValueError("a range of delays must lie in one period")
        return cls(last.count, phase, last.phase, (low, high))

    @property
    def ranges(self) -> bool:
        """Whether the delay has a range."""
        return self.low < self.high


Lags = tuple[int, ...]  # per input, the age in samples of the value that acts


@dataclass(frozen=True)
class Segment:
    """A part of a period in one mode under the same held inputs.

    It lasts from the mark `start` to the mark `stop`, or a fraction of that: `share` is "all",
    "before" a switch (u of it) or "after" it (1 − u of it).
    """

    mode: int
    lags: Lags
    start: int
    stop: int
    share: str


@dataclass(frozen=True, eq=False)
class Family(Steps):
    """Steps of a plant with its delays, or with a range of its one delay.

    Attributes
    ----------
    count : int
        N of the longest delay.
    marks : tuple of (low, high)
        Where the period is cut, seconds: (0, 0), the φ of the delays, (h, h). Only a range of one
        delay has low < high.
    lags : tuple by mode, part and input
        The lags between one mark and the next.
    """

    count: int
    marks: tuple[tuple[float, float], ...]
    lags: tuple[tuple[Lags, ...], ...]

    @classmethod
    def of(cls, plants: PlantSet, delays: Float[np.ndarray, "mode m"], step: float) -> Family:
        """The family of the delays of every mode and input."""
        windows = windows_of(SwitchedSystem(plants.A[0], plants.B[0], delays), step)
        # φ = h cuts nothing: such a delay reads one lag over the whole period.
        phases = sorted({window.phase for row in windows for window in row} - {step})
        lags = tuple(
            tuple(tuple(w.count - (begin >= w.phase) for w in row) for begin in (0.0, *phases))
            for row in windows
        )
        count = max(window.count for row in windows for window in row)
        return cls(plants, step, count, tuple((p, p) for p in (0.0, *phases, step)), lags)

    @classmethod
    def of_range(cls, plants: PlantSet, low: float, high: float, step: float) -> Family:
        """The family of a range of the one delay, which must lie in one period."""
        one, (modes, _, m) = DelayInterval.of(low, high, step), plants.sizes
        start, phases, stop = (0.0, 0.0), (one.low, one.high), (step, step)
        whole = phases == stop
        lags = [(one.count,) * m] if whole else [(one.count,) * m, (one.count - 1,) * m]
        marks = (start, stop) if whole else (start, phases, stop)
        return cls(plants, step, one.count, marks, (tuple(lags),) * modes)

    def _received(self) -> set[tuple[int, int]]:
        return {(lag, j) for mode in self.lags for part in mode for j, lag in enumerate(part)}

    @property
    def ranges(self) -> bool:
        """Whether the delay is a range."""
        return any(low != high for low, high in self.marks)

    @property
    def sound(self) -> bool:
        """Whether the marks ascend within a period."""
        marks = [mark for pair in self.marks for mark in pair]
        return marks == sorted(marks) and marks[0] >= 0.0 and marks[-1] <= self.step

    def moving(self, order: tuple[Segment, ...]) -> list[str]:
        """The delays that a step depends on; the cells of this family always have one f."""
        return ["delay"]

    def orders(self, mode: int, after: int) -> list[tuple[Segment, ...]]:
        """The orders of events in a period from `mode` to `after`; one for a full step."""
        parts = len(self.marks) - 1
        if mode == after:
            return [tuple(self._held(mode, 0, parts))]
        cuts = self._cuts((mode, after), 0, parts)
        return [
            (
                *self._held(mode, 0, a),
                Segment(mode, self.lags[mode][a], a, b, "before"),
                Segment(after, self.lags[after][a], a, b, "after"),
                *self._held(after, b, parts),
            )
            for a, b in pairwise(cuts)
        ]

    def _cuts(self, modes: tuple[int, ...], start: int, stop: int) -> list[int]:
        """The marks from one to another at which the inputs of one of these modes change."""
        lags = [self.lags[i] for i in modes]
        inner = [p for p in range(start + 1, stop) if any(of[p - 1] != of[p] for of in lags)]
        return [start, *inner, stop]

    def _held(self, mode: int, start: int, stop: int) -> Iterator[Segment]:
        if start < stop:
            for a, b in pairwise(self._cuts((mode,), start, stop)):
                yield Segment(mode, self.lags[mode][a], a, b, "all")

    def shares(
        self, order: tuple[Segment, ...], instants: tuple[float, float] = (0.0, 1.0)
    ) -> tuple[float, float] | None:
        """The range of u that holds all switches between two fractions of the period.

        None if no switch of this order of events lies there; (0, 1) for a full step.
        """
        part = _switching(order)
        if part is None:
            return 0.0, 1.0
        if part.stop - part.start == len(self.marks) - 1:
            return instants  # u is the fraction of the period itself, without rounding
        low, high = (fraction * self.step for fraction in instants)
        (a0, a1), (b0, b1) = self.marks[part.start], self.marks[part.stop]
        # u = (s − a)/(b − a) decreases in a and in b, so its extremes are at the ends of the range.
        least = (low - a1) / (b1 - a1) if a1 < b1 else 0.0
        most = (high - a0) / (b0 - a0) if a0 < b0 else 1.0
        length = b1 - a1 if part.start else b0 or b1
        # Outwards by more than the rounding error: neighbouring parts overlap and leave no gap.
        wrong = ROUND_OFF + 8.0 * np.spacing(self.step * (self.count + 1)) / max(length, 1e-300)
        least, most = least - wrong, most + wrong
        return (max(0.0, least), min(1.0, most)) if least <= 1.0 and most >= 0.0 else None

    def instant(self, order: tuple[Segment, ...], u: float) -> float:
        """The fraction of the period at which a switch at u falls; φ at its largest."""
        a, b = self._ends(order)
        return a + u * (b - a)

    def place(self, mode: int, after: int, instant: float) -> tuple[tuple[Segment, ...], float]:
        """The order of events, and u, of a switch at a fraction of the period: as `instant`."""
        orders = self.orders(mode, after)
        order = next((one for one in orders if instant <= self._ends(one)[1]), orders[-1])
        a, b = self._ends(order)
        return order, (instant - a) / (b - a)

    def _ends(self, order: tuple[Segment, ...]) -> tuple[float, float]:
        """The part that the switch falls in, as fractions of the period; all of it without one."""
        part = _switching(order)
        if part is None:
            return 0.0, 1.0
        return self.marks[part.start][1] / self.step, self.marks[part.stop][1] / self.step

    def generator(self, mode: int, lags: Lags) -> Float[np.ndarray, "vertex k k"]:
        """𝒜 of every corner, in a mode that reads these inputs."""
        return self.arranged(self.plants.entries(mode), lags)

    def arranged(self, entries: np.ndarray, lags: Lags) -> Float[np.ndarray, "number k k"]:
        """𝒜 of each [A B] (number, n, n + m) in a mode that reads these inputs."""
        n, size = self.states, self.states + len(self.reads)
        result = np.zeros((len(entries), size, size))
        result[:, :n, :n] = entries[:, :, :n]
        for j, lag in enumerate(lags):
            result[:, :n, n + self.reads.index((lag, j))] = entries[:, :, n + j]
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

        marks = [low if low == high else (1.0 - f) * low + f * high for low, high in self.marks]
        weights = self._weights(weights)
        share = {"all": 1.0, "before": u, "after": 1.0 - u}
        n = self.states
        result: np.ndarray = np.eye(n + len(self.reads))
        for part in order:
            # Later segments multiply from the left.
            part_time = marks[part.stop] - marks[part.start]
            generator = np.tensordot(weights, self.generator(part.mode, part.lags), 1)
            result = expm(generator * (part_time * share[part.share])) @ result
        return result[:n]

    def switches(self, order: tuple[Segment, ...]) -> bool:
        """Whether a step has a switch; a full step has none."""
        return _switching(order) is not None

    def ends(self, order: tuple[Segment, ...]) -> tuple[float, ...]:
        """The corners of the delays: both ends of the one, if it has a range."""
        return (0.0, 1.0) if self.ranges else (0.0,)


def _switching(order: tuple[Segment, ...]) -> Segment | None:
    """The segment that a switch ends, if there is one."""
    return next((part for part in order if part.share == "before"), None)
