"""The likelihood of noisy measurements, of all states or of outputs alone, by Kalman's filter.

    dx = (A x + Σ b_j u_j(t − D_j)) dt + dβ,    E dβ dβᵀ = W dt,
    y_k = C x_k + v_k,    v ~ N(0, V)

W is one for all modes, V diagonal. With the innovation e of every measurement and its variance s,

    log L = −½ Σ (log 2π s + e²/s),
    score = Σ (∂s (e²/s − 1)/2 − e ∂e)/s,    F = Σ (∂s²/2s² + ∂e²/s).

The filter computes ∂e and ∂s with e and s (`switched_filter`).

**Outputs alone.** From y = C x with fewer outputs than states, A and B are known only up to a
change of states. It is fixed by `order`, the number n_j of states of each output y_j, in a chain:

    x_j,1 = y_j,    dx_j,k/dt = x_j,k+1 + (b u)_j,k,    k < n_j,

so that row k of a chain is known except for B, and its last row of A is free. Any plant has such
states in which the rows C_j A^k, k < n_j, are independent (overlapping observability indices:
van Overbeek and Ljung, Automatica 18(5), 1982). Without `zeros` B acts on the last state of a chain
alone: then the states are the outputs and their derivatives.

Several modes have the same states if all share the C_j A^k, k < n_j, as position and speed do; else
a chain of each mode jumps at a switch. So with `jumps` the chains are those of the first mode, and
all of A is free in the others; of B only the weights of inputs in y_j' are known to be 0.

W is diagonal except for the last states of the chains, whose noise may be correlated. With the
sensors' deviations the noise then has at most the n p + p (p + 1)/2 parameters that outputs can
determine.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from deadtime.base.checks import read_only
from deadtime.base.frozen import Frozen
from deadtime.identification.likelihoods.innovations import (
    Changes,
    Signals,
    with_inputs,
    without_constants,
)
from deadtime.identification.likelihoods.likelihood import Likelihood, OfKnownModes
from deadtime.identification.likelihoods.switched_filter import (
    Places,
    Sensors,
    SwitchedKalmanFilter,
)
from deadtime.identification.log.recording import Part, Recording
from deadtime.identification.parameters import (
    Cells,
    FisherMatrix,
    Layout,
    SensorMatrix,
    Square,
    Vector,
    Window,
)
from deadtime.identification.scoring import Evaluate, Evaluation


@dataclass(frozen=True, eq=False)
class Embedding(Frozen):
    """The states of outputs.

    order : their number for each output; zeros : whether inputs act on all of them
    size : (n,), approximate size of each state, for the prior of an unknown state
    lead : the order that determines how many first measurements are left out, so that likelihoods
        of several orders use the same ones; by default `order`
    jumps : whether the states are chains in the first mode alone
    integrates : whether a pole of every chain is fixed at 0
    """

    order: tuple[int, ...]
    zeros: bool
    size: Float[np.ndarray, " n"]
    lead: tuple[int, ...] | None = None
    jumps: bool = False
    integrates: bool = False

    @property
    def last(self) -> Int[np.ndarray, " p"]:
        """The last state of every chain."""
        return np.cumsum(self.order) - 1

    @property
    def C(self) -> SensorMatrix:
        """The outputs: the first state of every chain."""
        return np.eye(sum(self.order))[self.first]

    @property
    def first(self) -> Int[np.ndarray, " p"]:
        """The first state of every chain, an output."""
        return self.last - np.array(self.order) + 1

    @property
    def upper(self) -> Int[np.ndarray, " row"]:
        """The states that are not last in a chain."""
        return np.setdiff1d(np.arange(sum(self.order)), self.last)

    def shift(self) -> Square:
        """A of chains of integrators: the known entries of A, and 0 elsewhere."""
        n = sum(self.order)
        A = np.zeros((n, n))
        A[self.upper, self.upper + 1] = 1.0
        return A

    def known(
        self, layout: Layout
    ) -> tuple[Int[np.ndarray, " known"], Float[np.ndarray, " known"]]:
        """The places and values of known entries, in a layout followed by W's triangle."""
        n, upper = layout.n, self.upper
        chained = 1 if self.jumps else layout.modes
        at_A = layout.of_A[:chained, upper].reshape(-1)
        values = np.tile(self.shift()[upper], (chained, 1, 1)).reshape(-1)
        if self.integrates:  # the last derivative does not depend on the output
            at_pole = layout.of_A[:, self.last, self.first].reshape(-1)
            at_A, values = np.append(at_A, at_pole), np.append(values, np.zeros(at_pole.size))
        at_B = layout.of_constant[:chained, upper].reshape(-1)  # it would only shift a state
        if not self.zeros:
            first = np.intersect1d(upper, self.first)
            at_B = layout.of_B[:chained, upper].reshape(-1)
            at_B = np.append(at_B, layout.of_B[chained:, first, : layout.m].reshape(-1))
        i, j = np.tril_indices(n)
        off = (i != j) & ~(np.isin(i, self.last) & np.isin(j, self.last))
        at_W = layout.size + np.flatnonzero(off)
        places = np.concatenate((at_A, at_B, at_W))
        return places, np.concatenate((values, np.zeros(at_B.size + at_W.size)))

    def initial(
        self, output: Float[np.ndarray, "sample p"], start: Bool[np.ndarray, " sample"]
    ) -> Bool[np.ndarray, "sample p"]:
        """The measurements that determine the first state: until output j has n_j of them.

        They are left out of the likelihood, which is conditional on them: it then depends neither
        on the prior of the first state nor on the coordinates of states.
        """
        measured = np.isfinite(output)
        before = np.cumsum(measured, axis=0) - measured
        latest = np.maximum.accumulate(np.where(start, np.arange(start.size), 0))
        lead = np.array(self.lead or self.order)
        few = np.any(before - before[latest] < lead, axis=1, keepdims=True)
        return measured & few


_VAGUE = 1e4  # prior variance of an unknown state, in variances of the log
_UNIDENTIFIED = 1e-4  # information on the logarithm of a noise below which the noise may be 0
_STRIDE = 1.5  # largest step of the logarithm of a noise


Starts = list[np.ndarray]  # of every part: at which samples a filter starts from the prior


class NoiseLevels(NamedTuple):
    """W (n, n), x² per second, and the standard deviations of the sensors (p,)."""

    W: Square
    deviation: Float[np.ndarray, " p"]


@dataclass(frozen=True, eq=False)
class SensorLikelihood(Likelihood):
    """A likelihood in the unknowns of a plant, of its noise, and of the noise of sensors.

    Its vector is that of the `Layout`, the lower triangle of L, W = L Lᵀ, its diagonal as
    logarithms, and the logarithms of the sensors' standard deviations. With an `embedding` the
    states are those of outputs alone, and some of the vector is known.
    """

    C: SensorMatrix
    embedding: Embedding | None = None

    @property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        # Noise is within 1e-6 … 1e6 of the measurements.
        low, high = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        at = self.logarithms
        size = 0.5 * np.log(np.diagonal(self.P0) / _VAGUE)
        size = np.append(size, 0.5 * np.log(np.diagonal(self.C @ self.P0 @ self.C.T) / _VAGUE))
        low[at], high[at] = size - np.log(1e6), size + np.log(1e6)
        if self.embedding is not None:
            places, values = self.embedding.known(self.layout)
            low[places], high[places] = values, values
        return low, high

    @property
    def logarithms(self) -> Int[np.ndarray, " log"]:
        """The places of logarithms: of the diagonal of L, and of the sensors' deviations."""
        i, j = self.places
        at = np.append(np.flatnonzero(i == j), i.size + np.arange(len(self.C)))
        return self.layout.size + at

    @cached_property
    def free(self) -> Int[np.ndarray, " free"]:
        """The places of the vector that are unknown."""
        free = np.arange(self.size)
        if self.embedding is not None:
            free = np.setdiff1d(free, self.embedding.known(self.layout)[0])
        return read_only(free)

    def identified(self, vector: Vector, F: FisherMatrix) -> Int[np.ndarray, " identified"]:
        # The information on the logarithm of a noise vanishes as the noise does.
        free, identified = self.free, self.unit(vector) ** 2 * np.diagonal(F) > _UNIDENTIFIED
        return free[(free < self.layout.size) | identified[free]]

    def starts(self, low: float, high: float) -> Starts:
        """The samples at which the filter starts from the prior, for a range of delays."""
        starts = []
        for part in self.recording.parts:
            start = np.ones(part.time.size, bool)
            start[1:] = ~self.sampling.fed(part, high, low)
            if self.within:
                start[1:] |= part.mode[1:] != part.mode[:-1]
            starts.append(start)
        return starts

    @cached_property
    def P0(self) -> Square:
        """The prior covariance of an unknown state."""
        if self.embedding is not None:
            return read_only(_VAGUE * np.diag(self.embedding.size**2))
        known = np.vstack([part.output for part in self.recording.parts])
        size = float(np.nanmean(known**2) / np.mean((self.C**2).sum(axis=1)))
        return read_only(_VAGUE * size * np.eye(self.layout.n))

    @property
    def acting(self) -> Int[np.ndarray, " row"]:
        """The states that inputs act on."""
        shape = self.embedding
        return np.arange(self.layout.n) if shape is None or shape.zeros else shape.last

    @cached_property
    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the triangle of L."""
        rows, columns = map(read_only, np.tril_indices(self.layout.n))
        return rows, columns

    @property
    def size(self) -> int:
        return self.layout.size + self.places[0].size + len(self.C)

    def join(self, theta: np.ndarray, noise: NoiseLevels) -> Vector:
        """The vector of a plant's unknowns and its noise."""
        L = np.linalg.cholesky(noise.W)
        i, j = self.places
        lower = np.where(i == j, np.log(np.abs(np.where(i == j, L[i, j], 1.0))), L[i, j])
        return np.concatenate((theta, lower, np.log(noise.deviation)))

    def noise(self, vector: Vector) -> NoiseLevels:
        """W and the deviations of a vector."""
        L = self.root(vector)
        return NoiseLevels(L @ L.T, np.exp(vector[self.layout.size + self.places[0].size :]))

    def unit(self, vector: Vector) -> Vector:
        """Units of the noise's unknowns: 1, but of L the deviation of their row."""
        unit, (i, j) = np.ones(self.size), self.places
        row = np.sqrt(np.diagonal(self.noise(vector).W))[i]
        unit[self.layout.size : self.layout.size + i.size] = np.where(i == j, 1.0, row)
        return unit

    def root(self, vector: Vector) -> Square:
        """L of a vector, W = L Lᵀ."""
        i, j = self.places
        lower = vector[self.layout.size : self.layout.size + i.size]
        L = np.zeros((self.layout.n, self.layout.n))
        L[i, j] = np.where(i == j, np.exp(np.where(i == j, lower, 0.0)), lower)
        return L

    @abstractmethod
    def evaluate(self, vector: Vector, starts: Starts, cells: Cells | None = None) -> Evaluation:
        """The log likelihood, its score and information; of an even log in cells of delays."""

    def evaluate_in(self, low: float, high: float) -> Callable[[np.ndarray], Evaluate]:
        starts = self.starts(low, high)
        return lambda cells: lambda vector: self.evaluate(vector, starts, cells)


@dataclass(frozen=True, eq=False)
class NoisyLog(SensorLikelihood, OfKnownModes):
    """The likelihood of a recording with measurement noise, its modes known."""

    def stride(self, vector: Vector) -> Vector:
        """The largest steps, which limit noise near 0, whose information vanishes.

        Where W = 0 is likeliest, log L falls linearly in W = L Lᵀ, hence with the squares of L's
        rows. The information is of second order in W and misses this curvature. A stride of a row's
        own size adds it.
        """
        stride = np.full(self.size, np.inf)
        of_L = slice(self.layout.size, self.size - len(self.C))
        stride[of_L] = self.unit(vector)[of_L]
        stride[self.logarithms] = _STRIDE
        return stride

    def initial(self, starts: Starts) -> list[Bool[np.ndarray, "sample p"]]:
        """The measurements of every part that are left out: see `Embedding.initial`."""
        parts = self.recording.parts
        if self.embedding is None:
            return [np.zeros(part.output.shape, bool) for part in parts]
        given = zip(parts, starts, strict=True)
        return [self.embedding.initial(part.output, start) for part, start in given]

    def determined(self, part: Part, start: Bool[np.ndarray, " sample"]) -> Bool[np.ndarray, " s"]:
        """Whether the rows since the latest start determine a state: as many of each output."""
        measured = np.isfinite(part.output)
        before = np.cumsum(measured, axis=0) - measured
        latest = np.maximum.accumulate(np.where(start, np.arange(start.size), 0))
        lead = np.ones(len(self.C)) if self.embedding is None else np.array(self.embedding.order)
        return ~start & (before - before[latest] >= lead).all(axis=1)

    def measured(self, starts: Starts) -> int:
        """The number of measurements in the likelihood."""
        every = sum(int(np.isfinite(part.output).sum()) for part in self.recording.parts)
        return every - sum(int(one.sum()) for one in self.initial(starts))

    def filter(
        self, vector: Vector, starts: Starts, cells: Cells | None = None
    ) -> SwitchedKalmanFilter:
        """The filter over all parts; of an even log in cells of delays, by default their own."""
        theta = vector[: self.layout.size]
        own = self.cells(theta) if cells is None else cells
        periods_of = self.sampling.periods_of(self.layout, theta, self.root(vector), own)
        sensors = Sensors(self.C, self.noise(vector).deviation ** 2, self.P0)
        left_out = self.initial(starts)
        return SwitchedKalmanFilter(self.recording.parts, starts, left_out, periods_of, sensors)

    def along(self, recording: Recording) -> NoisyLog:
        return replace(self, recording=recording)

    def residuals(self, vector: Vector, window: Window) -> tuple[np.ndarray, np.ndarray]:
        starts = self.starts(*window)
        e, s = self.innovations(vector, starts)
        fresh = np.concatenate(starts)[:, None] | np.vstack(self.initial(starts))
        known = np.vstack([np.isfinite(part.output) for part in self.recording.parts]) & ~fresh
        return np.where(known, e, np.nan), s

    def innovations(self, vector: Vector, starts: Starts) -> tuple[np.ndarray, np.ndarray]:
        """Errors and variances of all measurements, (samples, p) each."""
        blocks = self.filter(vector, starts).innovations(Places.none(self.layout.modes))
        e, s = zip(*((block.e, block.s) for block in blocks), strict=True)
        return np.vstack(e), np.vstack(s)

    def innovations_at(
        self, vector: Vector, window: Window, tested: Recording | None = None
    ) -> FilterInnovations:
        """Innovations of the filter, for score tests, of all rows or those `tested`.

        window : of the delays, seconds
        """
        log = self if tested is None else self.along(tested)
        return FilterInnovations(log, log.starts(*window))

    def value(self, vector: Vector, starts: Starts) -> float:
        return self.filter(vector, starts).evaluate(Places.none(self.layout.modes)).value

    def evaluate(self, vector: Vector, starts: Starts, cells: Cells | None = None) -> Evaluation:
        free = self.free
        places = Places.of(self.layout, len(self.C), free)
        with np.errstate(all="ignore"):
            now = self.filter(vector, starts, cells).evaluate(places)
        score, information = np.zeros(self.size), np.zeros((self.size, self.size))
        score[free], information[np.ix_(free, free)] = now.score, now.information
        known = np.isfinite(score).all() and np.isfinite(information).all()
        return Evaluation(now.value if known else -np.inf, score, information)


class FilterInnovations(NamedTuple):
    """Innovations of noisy measurements: those of Kalman's filter."""

    log: NoisyLog
    starts: Starts

    def residuals(self, vector: Vector) -> Float[np.ndarray, "row p"]:
        e, s = self.log.innovations(vector, self.starts)
        return np.where(self._known, e / np.sqrt(s), 0.0)

    def slopes(self, vector: Vector) -> Float[np.ndarray, "datum size"]:
        log = self.log
        places = Places.of(log.layout, len(log.C), log.free)
        blocks = list(log.filter(vector, self.starts).innovations(places))
        s = np.concatenate([block.s for block in blocks])[:, :, None]
        by_e = np.concatenate([block.by_e for block in blocks]) / np.sqrt(s)
        by_s = np.concatenate([block.by_s for block in blocks]) / (np.sqrt(2.0) * s)
        known = self._known[:, :, None]
        result = np.zeros((2, *known.shape[:2], log.size))
        result[0][:, :, log.free] = np.where(known, -by_e, 0.0)
        result[1][:, :, log.free[places.wide]] = np.where(known, by_s, 0.0)
        return result.reshape(-1, log.size)

    def stacked(self, residuals: Float[np.ndarray, "row p"]) -> Float[np.ndarray, " datum"]:
        variance = np.where(self._known, residuals**2 - 1.0, 0.0) / np.sqrt(2.0)
        return np.concatenate((residuals.ravel(), variance.ravel()))

    def responses(self, vector: Vector, inputs: Changes) -> Float[np.ndarray, "datum many"]:
        given, parts = without_constants(self.log.layout, vector), self.log.recording.parts
        many = with_inputs(parts, inputs)
        own = self.log.filter(given, self.starts)
        copied = own._replace(
            parts=tuple(part for each in many for part in each),
            starts=own.starts * len(many),
            left_out=own.left_out * len(many),
        )
        blocks = copied.innovations(Places.none(self.log.layout.modes))
        e = np.concatenate([block.e / np.sqrt(block.s) for block in blocks])
        e = np.where(self._known, e.reshape(len(many), *self._known.shape), 0.0)
        means = e.reshape(len(many), -1).T
        return -np.concatenate((means, np.zeros(means.shape)))

    def to_signals(self, vector: Vector, signals: Signals) -> Float[np.ndarray, "datum many"]:
        inputs = [np.zeros((*one.shape, self.log.layout.m)) for one in signals]
        for own, one in zip(inputs, signals, strict=True):
            own[:, :, 0] = one
        return self.responses(vector, inputs)

    @property
    def _known(self) -> np.ndarray:
        log = self.log
        fresh = np.concatenate(self.starts)[:, None] | np.vstack(log.initial(self.starts))
        return np.isfinite(np.vstack([part.output for part in log.recording.parts])) & ~fresh


_MOST = 10_000  # samples of a long log whose states are computed


class Following(NamedTuple):
    """States of a part, smoothed and predicted one sample ahead; NaN where not known yet."""

    states: Float[np.ndarray, "sample n"]
    ahead: Float[np.ndarray, "sample n"]


def following(log: NoisyLog, vector: Vector, part: Part, window: Window) -> Following:
    own = replace(log, recording=log.recording._replace(parts=(part,)))
    (start,) = starts = own.starts(*window)
    ahead, states, _ = own.filter(vector, starts).states(0)
    known = log.determined(part, start)[:, None]
    return Following(np.where(known, states, np.nan), np.where(known, ahead, np.nan))


def largest_of(log: NoisyLog, vector: Vector, window: Window) -> Float[np.ndarray, " n"]:
    """The largest |x| of every state; of a long log in stretches from all over it."""
    parts = log.recording.stretches(_MOST, log.recording.lag(window[1])).parts
    states = np.vstack([following(log, vector, part, window).states for part in parts])
    return np.nanmax(np.abs(states), axis=0)
