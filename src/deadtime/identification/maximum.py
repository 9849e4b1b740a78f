"""The maximum of a log's likelihood over all unknowns, or with some of them held."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from deadtime.base.frozen import Frozen
from deadtime.identification.cells import cell_of, cells_of
from deadtime.identification.hidden.hidden_likelihood import HiddenLog
from deadtime.identification.hidden.noisy_likelihood import HiddenNoisyLog
from deadtime.identification.log.recording import Recording
from deadtime.identification.noisy.likelihood import NoisyLog
from deadtime.identification.parameters import Layout
from deadtime.identification.regression import concentrated, even_terms, lags_of
from deadtime.identification.scoring import (
    GAIN,
    Evaluate,
    Maximum,
    Stride,
    climb,
    climb_cells,
)
from deadtime.identification.uneven import uneven_terms, usable

REACH = 3.0  # periods on either side of a delay that the log's start leaves room for


@dataclass(frozen=True, eq=False)
class ExactLog(Frozen):
    """The likelihood of a recording whose states are measured without noise.

    within : whether the mode may change within periods
    bounds : of the delays, seconds
    nodes : for uneven samples
    """

    recording: Recording
    layout: Layout
    within: bool
    bounds: tuple[float, float]
    nodes: Float[np.ndarray, " node"] = field(repr=False)

    @property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """What bounds unknowns, delays aside: nothing."""
        return np.full(self.layout.size, -np.inf), np.full(self.layout.size, np.inf)

    def cells(self, theta: np.ndarray) -> np.ndarray:
        """The cells that delays lie in."""
        return cells_of(theta[self.layout.at_delays], self.recording.step)

    def terms_in(self, low: float, high: float) -> Callable[[np.ndarray], Callable]:
        """The regressions for delays between two, seconds."""
        record, layout = self.recording, self.layout
        if record.even:
            first, last = cell_of(low, record.step, up=True), cell_of(high, record.step)
            lags = lags_of(record.parts, layout, first - 1, last, self.within)
            return lambda cells: (
                lambda theta: even_terms(lags, layout, record.step, layout.spread(cells), theta)
            )
        good = [np.flatnonzero(usable(part, self.within, high, low)) for part in record.parts]
        return lambda _: (
            lambda theta: uneven_terms(record.parts, good, layout, record.step, self.nodes, theta)
        )

    def evaluate_in(self, low: float, high: float) -> Callable[[np.ndarray], Evaluate]:
        """The likelihood for delays between two, seconds, in cells of theirs."""
        terms_in = self.terms_in(low, high)

        def within(cells: np.ndarray) -> Evaluate:
            terms = terms_in(cells)
            return lambda theta: concentrated(terms(theta), self.layout.size)[0]

        return within


Likelihood = ExactLog | NoisyLog | HiddenLog | HiddenNoisyLog


def window_of(
    log: Likelihood, delays: Float[np.ndarray, " delay"], reach: float = REACH
) -> tuple[float, float]:
    """Where delays are looked for next: some periods about where they are, within the bounds."""
    h = log.recording.step
    low = max(log.bounds[0], float(delays.min()) - reach * h)
    return low, min(log.bounds[1], float(delays.max()) + reach * h)


def stride_of(log: Likelihood) -> Stride | None:
    """How far unknowns may go at a time; None: as far as the information says."""
    return log.stride if isinstance(log, NoisyLog) else None


def maximise(
    log: Likelihood,
    theta: Float[np.ndarray, " size"],
    fixed: Bool[np.ndarray, " size"] | None = None,
    window: tuple[float, float] | None = None,
    gain: float | None = None,
) -> tuple[Maximum, tuple[float, float]]:
    """The maximum that a start leads to, and the window of delays that it was sought in.

    What is usable of a log depends on the window, so likelihoods compare in the same one only.
    `gain` is the rise of log likelihood that is worth a step; by default 1e-10, and 1e-3
    where each step takes two filters for every unknown.
    """
    place = log.layout.at_delays
    if gain is None:
        gain = 1e-3 if isinstance(log, HiddenNoisyLog) else GAIN
    h, asked = log.recording.step, window
    stride = stride_of(log)
    while True:
        low, high = asked or window_of(log, theta[place])
        evaluate_in, ends = log.evaluate_in(low, high), log.limits
        if log.recording.even:
            cells = cells_of(theta[place], h)
            reach = (low, high), ends, fixed, stride, gain
            best, _ = climb_cells(evaluate_in, theta, place, cells, h, *reach)
        else:
            ends[0][place], ends[1][place] = low, high
            if fixed is not None:
                ends[0][fixed], ends[1][fixed] = theta[fixed], theta[fixed]
            best = climb(evaluate_in(np.zeros(0, np.int64)), theta, *ends, stride=stride, gain=gain)
        D, free = best.theta[place], np.ones(log.layout.delays, bool)
        if fixed is not None:
            free = ~fixed[place]
        edge = ((low >= D) & (low > log.bounds[0])) | ((high <= D) & (high < log.bounds[1]))
        if asked or not (edge & free).any() or np.array_equal(best.theta, theta):
            return best, (low, high)
        theta = best.theta
