"""The likelihood of a log: value, score and information over a plant's unknowns and others.

Where states are measured exactly, a period adds noise of any covariance:

    x_{k+1} = P_σ(θ) r_k + w_k,    w ~ N(0, S_σ),    r_k: the state and the inputs that act

The covariance that maximises that likelihood is that of the residuals, so

    log L(θ) = −½ Σ_i N_i (log det S_i(θ) + n (1 + log 2π)),    S_i = Σ e eᵀ / N_i.

It depends on the log of mode i through Σ z zᵀ alone, z = (x_{k+1}, r_k). Its square root is stored,
the triangular factor of the stacked z, block by block, because squaring would lose half the digits.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from deadtime.base.frozen import Frozen
from deadtime.identification.likelihoods.innovations import (
    Changes,
    Signals,
    with_inputs,
    without_constants,
)
from deadtime.identification.log.recording import Part, Recording
from deadtime.identification.parameters import (
    Cells,
    FisherMatrix,
    Layout,
    Nodes,
    Square,
    Squares,
    Vector,
    Window,
    cells_of,
)
from deadtime.identification.sampling import Sampling, Term, TermsIn, UsablePeriods, sampling_of
from deadtime.identification.scoring import (
    GAIN,
    STEPS,
    Climb,
    Evaluate,
    EvaluateIn,
    Evaluation,
    Maximum,
    climb,
)

_APART = 1e-8  # ratio of variances at which double precision still resolves both informations
REACH = 3.0  # periods on either side of the delays in a window


@dataclass(frozen=True, eq=False)
class Likelihood(Frozen, ABC):
    """The likelihood of a recording, over a vector that begins with the unknowns of `layout`.

    within : whether the mode may change within periods
    bounds : of the delays, seconds
    nodes : of interpolation, for uneven samples
    gain : the least rise of log likelihood of a step
    profiled : whether it is quick enough to be maximised at many delays, for a profile
    """

    recording: Recording
    layout: Layout
    within: bool
    bounds: Window
    nodes: Nodes = field(repr=False)

    gain: ClassVar[float] = GAIN
    profiled: ClassVar[bool] = True

    @property
    @abstractmethod
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """The least and the largest value of every unknown, delays aside."""

    @abstractmethod
    def stride(self, vector: Vector) -> Vector:
        """The largest step of each unknown whose information is nearly 0."""

    @abstractmethod
    def identified(self, vector: Vector, F: FisherMatrix) -> Int[np.ndarray, " identified"]:
        """The places of unknowns that an information identifies."""

    @abstractmethod
    def evaluate_in(self, low: float, high: float) -> EvaluateIn:
        """The likelihood for delays in a range, seconds; for even rows in cells of delays.

        The usable periods depend on the range: likelihoods compare in the same range only.
        """

    @abstractmethod
    def along(self, recording: Recording) -> OfKnownModes:
        """The likelihood with known modes, those of a recording."""

    @cached_property
    def sampling(self) -> Sampling:
        """How the recording was sampled."""
        return sampling_of(self.recording, self.nodes)

    def cells(self, theta: Vector) -> Cells:
        return cells_of(theta[self.layout.at_delays], self.recording.step)


class OfKnownModes(Likelihood):
    """A likelihood with known modes."""

    @abstractmethod
    def residuals(self, vector: Vector, window: Window) -> tuple[np.ndarray, np.ndarray]:
        """Errors of one-step predictions, and the variances known of them.

        Two arrays (samples, p), NaN where a period is not usable for delays in a window.
        """


@dataclass(frozen=True, eq=False)
class PlantLikelihood(Likelihood):
    """A likelihood of the plant's unknowns alone: the covariances of noise are eliminated."""

    @property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        return np.full(self.layout.size, -np.inf), np.full(self.layout.size, np.inf)

    def stride(self, vector: Vector) -> Vector:
        return np.full(vector.size, np.inf)

    def identified(self, vector: Vector, F: FisherMatrix) -> Int[np.ndarray, " identified"]:
        return np.arange(self.layout.size)


def window_of(log: Likelihood, delays: Float[np.ndarray, " delay"], reach: float = REACH) -> Window:
    """The range of delays to search next: some periods on either side, within the bounds."""
    h = log.recording.step
    low = max(log.bounds[0], float(delays.min()) - reach * h)
    return low, min(log.bounds[1], float(delays.max()) + reach * h)


def climb_within(
    log: Likelihood, evaluate: Evaluate, theta: Vector, cells: np.ndarray, gain: float
) -> Maximum:
    """The maximum near a start with delays in given cells."""
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
    steps: int = STEPS,
) -> tuple[Maximum, Window]:
    """The maximum near a start, and the window of delays that was searched.

    Without `window` the search moves its own until the maximum lies inside. The usable periods
    depend on the window: likelihoods compare in the same one only. `gain` is the rise of log
    likelihood that ends the climb; by default the likelihood's own.
    """
    place, still = log.layout.at_delays, np.zeros(theta.size, bool) if fixed is None else fixed
    gain = log.gain if gain is None else gain
    while True:
        low, high = window or window_of(log, theta[place])
        how = Climb(place, log.limits, still, log.stride, gain, steps)
        best = log.sampling.climb(log.evaluate_in(low, high), theta, (low, high), how)
        D = best.theta[place]
        edge = ((low >= D) & (low > log.bounds[0])) | ((high <= D) & (high < log.bounds[1]))
        if window or not (edge & ~still[place]).any() or np.array_equal(best.theta, theta):
            return best, (low, high)
        theta = best.theta


def concentrated(terms: list[Term], size: int) -> tuple[Evaluation, Squares]:
    """The log likelihood of all modes, and the covariances S_i that maximise it."""
    value, score, information, covariances = 0.0, np.zeros(size), np.zeros((size, size)), []
    for term in terms:
        count, P, n = term.periods, term.P, len(term.P)
        y, r = term.root[:, :n], term.root[:, n:]
        e = y - r @ P.T
        S = e.T @ e / count
        if not np.isfinite(S).all():  # of a trial far out, whose exponential overflows
            nothing = Evaluation(-np.inf, score, np.eye(size))
            return nothing, np.full((len(terms), n, n), np.nan)
        S = floored(S, P[:, :n], y, count)
        L = np.linalg.cholesky(S)
        add_score(term, e, L, score, information)
        value -= 0.5 * count * (2.0 * np.log(np.diagonal(L)).sum() + n * np.log(2.0 * np.pi * np.e))
        covariances.append(S)
    return Evaluation(value, score, information), np.array(covariances)


def add_score(
    term: Term, e: np.ndarray, L: np.ndarray, score: Vector, information: np.ndarray
) -> None:
    """Add the score and information of residuals e (rows, n) of covariance L Lᵀ, in place."""
    place, r = term.place, term.root[:, len(L) :]
    white = np.linalg.solve(L, e.T)
    moved = np.linalg.solve(L, term.by_P @ r.T).reshape(len(place), -1)
    score[place] += moved @ white.ravel()
    information[np.ix_(place, place)] += moved @ moved.T


def floored(S: Square, Phi: Square, y: np.ndarray, total: float) -> Square:
    """The covariance S of residuals of y, of weight `total`, made regular.

    A state without noise beside noisy ones, or noises that are multiples of each other, would
    determine some combinations of unknowns so well that round-off hides others. So 1e-4 of
    the deviation of each state's noise is added as independent noise, spread from state to state by
    powers of Φ − I, as noise in dx/dt spreads.
    """
    M = Phi - np.eye(len(S))
    M /= max(1.0, float(np.abs(np.linalg.eigvals(M)).max()))
    spread, moved = np.diag(np.diagonal(S)), S
    for _ in range(len(S) - 1):
        moved = M @ moved @ M.T
        spread = spread + moved
    least = 1e-24 * (y**2).sum(axis=0) / total + np.finfo(float).tiny
    return S + _APART * spread + np.diag(least)


def log_density(
    z: Float[np.ndarray, "period z"], P: Float[np.ndarray, "n r"], S: Square
) -> Float[np.ndarray, " period"]:
    """log N(x_{k+1} − P r_k; 0, S) of rows z = (x_{k+1}, r_k)."""
    n, L = len(P), np.linalg.cholesky(S)
    white = np.linalg.solve(L, (z[:, :n] - z[:, n:] @ P.T).T)
    constant = 2.0 * np.log(np.diagonal(L)).sum() + n * np.log(2.0 * np.pi)
    return -0.5 * ((white**2).sum(axis=0) + constant)


def rooted(z: Float[np.ndarray, "period z"], weight: Float[np.ndarray, " period"]) -> np.ndarray:
    """R with RᵀR = Σ w z zᵀ, R triangular."""
    return np.asarray(np.linalg.qr(np.sqrt(weight)[:, None] * z, mode="r"))


@dataclass(frozen=True, eq=False)
class ExactLog(PlantLikelihood, OfKnownModes):
    """The likelihood of a recording whose states are measured without noise: regressions.

    usable : the periods of every part; by default those usable in a window
    weight : the probability of each mode in them; by default modes are as logged
    """

    usable: tuple[Int[np.ndarray, " period"], ...] | None = field(default=None, repr=False)
    weight: Float[np.ndarray, "every mode"] | None = field(default=None, repr=False)

    def along(self, recording: Recording) -> ExactLog:
        return replace(self, recording=recording, usable=None, weight=None)

    def residuals(self, vector: Vector, window: Window) -> tuple[np.ndarray, np.ndarray]:
        layout, cells, sampling = self.layout, self.cells(vector), self.sampling
        reads, every = sampling.reads(layout, vector, cells), []
        maps = sampling.maps(layout, vector, cells, slopes=False)
        for part in self.recording.parts:
            e = np.full((part.time.size, layout.n), np.nan)
            usable = sampling.usable(part, self.within, *window)
            for i, own in enumerate(maps):
                k = usable[part.mode[usable] == i]
                if not k.size:
                    continue
                z = sampling.rows(part, k, reads[i], layout.constant)
                e[k + 1] = z[:, : layout.n] - z[:, layout.n :] @ own.P.T
            every.append(e)
        e = np.vstack(every)
        return e, np.ones(e.shape)

    def terms_in(self, low: float, high: float) -> TermsIn:
        """The regressions for delays in a range, seconds, in cells of delays."""
        parts, k = self.recording.parts, self.usable
        if k is None:
            k = [self.sampling.usable(part, self.within, low, high) for part in parts]
        periods = UsablePeriods(parts, k, self.weight)
        return self.sampling.terms_in(self.layout, periods, (low, high))

    def evaluate_in(self, low: float, high: float) -> EvaluateIn:
        terms_in = self.terms_in(low, high)

        def within(cells: np.ndarray) -> Evaluate:
            terms = terms_in(cells)
            return lambda theta: concentrated(terms(theta), self.layout.size)[0]

        return within

    def innovations_at(
        self, vector: Vector, window: Window, tested: Recording | None = None
    ) -> ExactInnovations:
        """Errors of a period, for score tests, of all rows or those `tested`, with all rows' noise.

        window : of the delays, seconds
        """
        return ExactInnovations.at(self, vector, window, tested)


class ExactInnovations(NamedTuple):
    """Innovations of exact states: their errors of one period.

    usable : the periods of every part; roots : of the noise's covariance in each mode
    """

    log: ExactLog
    usable: tuple[Int[np.ndarray, " period"], ...]
    roots: Squares

    @classmethod
    def at(
        cls, log: ExactLog, vector: Vector, window: Window, tested: Recording | None = None
    ) -> ExactInnovations:
        terms = log.terms_in(*window)(log.cells(vector))(vector)
        counts = np.array([term.periods for term in terms])
        spare = np.maximum(counts - log.layout.n - log.layout.acting - 1, 1)
        S = concentrated(terms, log.layout.size)[1] * (counts / spare)[:, None, None]
        own = log if tested is None else replace(log, recording=tested)
        parts = own.recording.parts
        k = tuple(own.sampling.usable(part, own.within, *window) for part in parts)
        return cls(own, k, np.linalg.cholesky(S))

    def residuals(self, vector: Vector) -> Float[np.ndarray, "row p"]:
        log, n = self.log, self.log.layout.n
        maps = log.sampling.maps(log.layout, vector, log.cells(vector), slopes=False)
        result = np.zeros((log.recording.rows, n))
        for mode, rows, z in self._periods(vector, log.recording.parts):
            e = z[:, :n] - z[:, n:] @ maps[mode].P.T
            result[rows] = np.linalg.solve(self.roots[mode], e.T).T
        return result

    def slopes(self, vector: Vector) -> Float[np.ndarray, "datum size"]:
        log, layout = self.log, self.log.layout
        result = np.zeros((log.recording.rows, layout.n, layout.size))
        maps = log.sampling.maps(layout, vector, log.cells(vector))
        for mode, rows, z in self._periods(vector, log.recording.parts):
            moved = np.tensordot(z[:, layout.n :], maps[mode].by_P, (1, 2))
            white = np.linalg.solve(self.roots[mode], moved.transpose(0, 2, 1))
            result[rows[:, None], :, maps[mode].place] = white.transpose(0, 2, 1)
        return result.reshape(-1, layout.size)

    def stacked(self, residuals: Float[np.ndarray, "row p"]) -> Float[np.ndarray, " datum"]:
        return residuals.ravel()

    def responses(self, vector: Vector, inputs: Changes) -> Float[np.ndarray, "datum many"]:
        log, n, parts = self.log, self.log.layout.n, self.log.recording.parts
        maps = log.sampling.maps(
            log.layout, without_constants(log.layout, vector), log.cells(vector), slopes=False
        )
        whole = [np.linalg.solve(self.roots[i], one.P) for i, one in enumerate(maps)]
        result = np.zeros((len(inputs[0]), log.recording.rows, n))
        for one, changed in enumerate(with_inputs(parts, inputs)):
            for mode, rows, z in self._periods(vector, changed):
                result[one, rows] = z[:, n:] @ whole[mode].T
        return np.nan_to_num(result.reshape(len(result), -1)).T

    def to_signals(self, vector: Vector, signals: Signals) -> Float[np.ndarray, "datum many"]:
        # A period has no memory: its response is that to 1 times the signal at its beginning.
        parts, p = self.log.recording.parts, self.log.layout.n
        one = [np.ones((1, *part.input.shape)) for part in parts]
        early = [np.hstack((s[:, :1], s[:, :-1])) for s in signals]
        acting = np.repeat(np.hstack(early).T, p, axis=0)
        return self.responses(vector, one) * acting

    def _periods(
        self, vector: Vector, parts: Sequence[Part]
    ) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """Mode, rows among those of all parts, and z of the usable periods, mode by mode."""
        log = self.log
        reads, first = log.sampling.reads(log.layout, vector, log.cells(vector)), 0
        for part, every in zip(parts, self.usable, strict=True):
            for mode in range(log.layout.modes):
                k = every[part.mode[every] == mode]
                if k.size:
                    z = log.sampling.rows(part, k, reads[mode], log.layout.constant)
                    yield mode, first + k + 1, z
            first += part.time.size
