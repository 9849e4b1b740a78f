"""The likelihood of a log: value, score and information over unknowns that begin with a plant's."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int

from deadtime.base.frozen import Frozen
from deadtime.identification.log.recording import Recording
from deadtime.identification.parameters import Layout, Vector, Window, cells_of
from deadtime.identification.scoring import GAIN, Evaluate, Maximum, climb, climb_cells

REACH = 3.0  # periods on either side of a delay that the log's start leaves room for


@dataclass(frozen=True, eq=False)
class Likelihood(Frozen, ABC):
    """The likelihood of a recording, over a vector that begins with the unknowns of `layout`.

    within : whether the mode may change within periods
    bounds : of the delays, seconds
    nodes : of interpolation, for uneven samples
    gain : the rise of log likelihood that is worth a step
    profiled : whether it is quick enough to be maximised at many delays, for a profile
    """

    recording: Recording
    layout: Layout
    within: bool
    bounds: Window
    nodes: Float[np.ndarray, " node"] = field(repr=False)

    gain: ClassVar[float] = GAIN
    profiled: ClassVar[bool] = True

    @property
    @abstractmethod
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """The least and the largest value of every unknown, delays aside."""

    @abstractmethod
    def stride(self, vector: Vector) -> Vector:
        """How far each unknown may go at a time that does next to nothing where it is."""

    @abstractmethod
    def told(self, vector: Vector, F: Float[np.ndarray, "size size"]) -> Int[np.ndarray, " told"]:
        """The places of unknowns that an information is of."""

    @abstractmethod
    def evaluate_in(self, low: float, high: float) -> Callable[[np.ndarray], Evaluate]:
        """The likelihood for delays between two, seconds; of even rows in cells of theirs.

        What is usable of a log depends on these, so likelihoods compare between the same ones only.
        """

    def cells(self, theta: Vector) -> Int[np.ndarray, " delay"]:
        """The cells that delays lie in."""
        return cells_of(theta[self.layout.at_delays], self.recording.step)


@dataclass(frozen=True, eq=False)
class PlantLikelihood(Likelihood):
    """A likelihood whose unknowns are those of the plant alone: what noise adds is eliminated."""

    @property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        return np.full(self.layout.size, -np.inf), np.full(self.layout.size, np.inf)

    def stride(self, vector: Vector) -> Vector:
        return np.full(vector.size, np.inf)

    def told(self, vector: Vector, F: Float[np.ndarray, "size size"]) -> Int[np.ndarray, " told"]:
        return np.arange(self.layout.size)


def window_of(log: Likelihood, delays: Float[np.ndarray, " delay"], reach: float = REACH) -> Window:
    """Where delays are looked for next: some periods about where they are, within the bounds."""
    h = log.recording.step
    low = max(log.bounds[0], float(delays.min()) - reach * h)
    return low, min(log.bounds[1], float(delays.max()) + reach * h)


def climb_within(
    log: Likelihood, evaluate: Evaluate, theta: Vector, cells: np.ndarray, gain: float
) -> Maximum:
    """The maximum that a start leads to with delays in cells, of the likelihood there."""
    (low, high), place, h = log.limits, log.layout.at_delays, log.recording.step
    low[place] = np.maximum((cells - 1) * h, log.bounds[0])
    high[place] = np.minimum(cells * h, log.bounds[1])
    return climb(evaluate, theta, low, high, gain=gain, stride=log.stride)


def maximise(
    log: Likelihood,
    theta: Vector,
    fixed: Bool[np.ndarray, " size"] | None = None,
    window: Window | None = None,
    gain: float | None = None,
) -> tuple[Maximum, Window]:
    """The maximum that a start leads to, and the window of delays that it was sought in.

    What is usable of a log depends on the window, so likelihoods compare in the same one only.
    `gain` is the rise of log likelihood that is worth a step; by default the likelihood's own.
    """
    place = log.layout.at_delays
    gain = log.gain if gain is None else gain
    h, asked = log.recording.step, window
    while True:
        low, high = asked or window_of(log, theta[place])
        evaluate_in, ends = log.evaluate_in(low, high), log.limits
        if log.recording.even:
            cells = log.cells(theta)
            reach = (low, high), ends, fixed, log.stride, gain
            best, _ = climb_cells(evaluate_in, theta, place, cells, h, *reach)
        else:
            ends[0][place], ends[1][place] = low, high
            if fixed is not None:
                ends[0][fixed], ends[1][fixed] = theta[fixed], theta[fixed]
            evaluate = evaluate_in(np.zeros(0, np.int64))
            best = climb(evaluate, theta, *ends, stride=log.stride, gain=gain)
        D, free = best.theta[place], np.ones(log.layout.delays, bool)
        if fixed is not None:
            free = ~fixed[place]
        edge = ((low >= D) & (low > log.bounds[0])) | ((high <= D) & (high < log.bounds[1]))
        if asked or not (edge & free).any() or np.array_equal(best.theta, theta):
            return best, (low, high)
        theta = best.theta
