"""An estimate with its intervals and tests, and the probabilities of hidden modes.

Intervals of A, B and delays come from the peak of the likelihood (`intervals`), those of noise from
the normal distribution of a variance or its logarithm.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from deadtime.base.checks import brief
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.identification.intervals import Peak
from deadtime.identification.likelihoods.noisy_log import NoisyLog
from deadtime.identification.log.recording import Recording
from deadtime.identification.parameters import SensorMatrix, Squares
from deadtime.identification.residuals import ResidualTests, judge_residuals
from deadtime.plant import SwitchedSystem
from deadtime.switching.models.semi_markov import SemiMarkov

EDGE = 1e-6  # of the range searched
_WIDE = 0.25  # of the range searched: a longer interval hardly identifies a delay

SURE = 0.95  # least probability of a mode that counts as sure


@dataclass(frozen=True, eq=False, repr=False)
class HiddenModes(Frozen):
    """The likeliest path of modes that were not logged, and their probabilities.

    Modes are numbered in the order in which the path visits them.

    Attributes
    ----------
    time, mode : (samples,) arrays
        Times of all rows, seconds, log after log, and the likeliest path of modes (Viterbi).
    probability : (samples, modes) array
        The probability of every mode in every row, given all of the log.
    chain : (modes, modes) array
        Probabilities of a switch from one row to the next; of uneven rows within a sampling period.
    numbers, bic : (fits,) arrays
        The numbers of modes that were tried, and Bayes' information criterion of each; less is
        better. Numbers for which the log is too short are left out.
    likelihoods : (steps,) array
        The log likelihood after every step of expectation–maximisation, which never falls; with
        noisy sensors after every round.
    starts, agreed : int
        The numbers of starts, and of starts that led to the likeliest plant.
    widening : float
        The largest ratio of the plant's intervals to intervals with known modes.

    Examples
    --------
    See `identify`.
    """

    time: Float[np.ndarray, " sample"]
    mode: Int[np.ndarray, " sample"]
    probability: Float[np.ndarray, "sample mode"]
    chain: Float[np.ndarray, "mode mode"]
    numbers: Int[np.ndarray, " fit"]
    bic: Float[np.ndarray, " fit"]
    likelihoods: Float[np.ndarray, " step"]
    starts: int
    agreed: int
    widening: float

    @property
    def sure(self) -> float:
        """The share of rows whose mode is at least 95 % sure."""
        return float((self.probability.max(axis=1) >= SURE).mean())

    def __repr__(self) -> str:
        return f"HiddenModes(modes={len(self.chain)}, sure={self.sure:.3f})"


_REACH = 1.959963984540054  # standard deviations of a normal distribution's 95 % interval
_OWN = 0.5  # relative error of a variance beyond which the variance may be 0


@dataclass(frozen=True, eq=False, kw_only=True)
class Estimate(Peak):
    """The likeliest plant under one description of the noise.

    With noisy sensors the unknowns are those of the restricted likelihood, its value the largest.

    intervals : (delays, 2), seconds; several : (delays,), whether an interval holds other peaks
    disturbance : (modes, n, n), W of each mode, x² per second
    noise : (p,), standard deviations of the sensors
    noise_errors : standard errors of W's diagonal, mode by mode, then of the sensors' variances
    spare : (modes,), degrees of freedom of each W: periods less unknowns of the matrices
    white : of every log, the whitened residuals, NaN where there are none
    ends : (unknowns, 2), of intervals of A and B where delays are open; None elsewhere
    of_outputs : the likelihood, where states were found from outputs alone
    """

    plant: SwitchedSystem
    intervals: Float[np.ndarray, "delay 2"]
    several: Bool[np.ndarray, " delay"]
    disturbance: Squares
    noise: Float[np.ndarray, " p"]
    noise_errors: Float[np.ndarray, " variance"]
    spare: Int[np.ndarray, " mode"]
    tests: ResidualTests
    white: tuple[Float[np.ndarray, "sample p"], ...]
    ends: Float[np.ndarray, "unknown 2"] | None = None
    of_outputs: NoisyLog | None = None

    @classmethod
    def at(
        cls,
        peak: Peak,
        plant: SwitchedSystem,
        recording: Recording,
        white: list[Float[np.ndarray, "sample p"]],
        spent: int | None = None,
        **others: Any,
    ) -> Estimate:
        """The estimate at a peak, with tests of its residuals: see `judge_residuals`.

        others : the other fields, including `best` where the noise is restricted
        """
        intervals, several = peak.delay_intervals()
        # A search replaces a shortest delay of 0 by a tiny one.
        least = peak.log.bounds[0]
        if least <= EDGE * recording.step * (1.0 + EDGE):
            intervals = np.where(intervals <= least, 0.0, intervals)
        tests = judge_residuals(white, recording, plant.longest_delay, spent)
        own = {"plant": plant, "intervals": intervals, "several": several, "tests": tests}
        return cls(**{**vars(peak), **own, **others}, white=tuple(white))

    @property
    def delays(self) -> Float[np.ndarray, " delay"]:
        return self.best.theta[self.log.layout.at_delays]

    @property
    def searched(self) -> tuple[float, float]:
        """The range searched as given: its shortest delay is 0 where the search replaced 0."""
        low, high = self.log.bounds
        return (low if low > EDGE * self.log.recording.step * (1.0 + EDGE) else 0.0), high

    @property
    def missed(self) -> Bool[np.ndarray, " delay"]:
        """Which delays fit best at an end of the range searched, other than 0."""
        (low, high), D = self.searched, self.delays
        margin = EDGE * (high - low)
        return (high - margin < D) | ((low > 0.0) & (low + margin > D))

    @property
    def range_flags(
        self,
    ) -> tuple[Bool[np.ndarray, " delay"], Bool[np.ndarray, " delay"], Bool[np.ndarray, " delay"]]:
        """Delays at the edge of the range, whose interval it cuts, and that the log leaves open."""
        low, high = self.log.bounds
        margin, D, (left, right) = EDGE * (high - low), self.delays, self.intervals.T
        least = -np.inf if self.searched[0] == 0.0 else low  # no delay is less than 0
        at_edge = (low + margin > D) | (high - margin < D)
        vague = self.several | (right - left > _WIDE * (high - low))
        return at_edge, (left <= least) | (right >= high), vague

    @property
    def outside(self) -> bool:
        """Whether residuals depend most on an input of a delay outside the range searched."""
        (low, high), h = self.searched, self.log.recording.step
        return not (self.tests.unrelated or low - h < self.tests.input_delay < high + h)

    @cached_property
    def places(self) -> dict[str, int]:
        """The place of each unknown by name: in the layout, then W's diagonals, then the sensors.

        With outputs alone, entries fixed by the choice of states are left out.
        """
        layout, (modes, n) = self.log.layout, self.disturbance.shape[:2]
        more = [f"disturbance[{i}][{a},{a}]" for i in range(modes) for a in range(n)]
        more += [f"noise[{j}]" for j in range(self.noise.size)] if self.noise.any() else []
        places = {name: a for a, name in enumerate([*layout.names(), *more])}
        if self.of_outputs is not None:
            free = {*self.of_outputs.free.tolist(), *range(layout.size, len(places))}
            places = {name: a for name, a in places.items() if a in free}
        return places

    def value(self, name: str) -> float:
        place, size = self._place(name), self.log.layout.size
        if place < size:
            return float(self.best.theta[place])
        diagonal = np.diagonal(self.disturbance, axis1=1, axis2=2)
        return float(np.concatenate((diagonal.ravel(), self.noise))[place - size])

    def interval(self, name: str) -> tuple[float, float]:
        layout, place = self.log.layout, self._place(name)
        if place >= layout.size:
            return self.noise_interval(place - layout.size)
        if place >= layout.size - layout.delays:
            low, high = self.intervals[place - layout.size + layout.delays]
        elif self.ends is not None:
            low, high = self.ends[place]
        else:
            half = self.spread.reach[place] * np.sqrt(self.spread.covariance[place, place])
            low, high = self.best.theta[place] - half, self.best.theta[place] + half
        return float(low), float(high)

    def noise_interval(self, place: int) -> tuple[float, float]:
        """The 95 % interval of an entry of W's diagonals, mode by mode, or a sensor's deviation."""
        W = np.diagonal(self.disturbance, axis1=1, axis2=2).ravel()
        variance = float(np.append(W, self.noise**2)[place])
        low, high = variance_ends(variance, float(self.noise_errors[place]))
        return (low, high) if place < W.size else (float(np.sqrt(low)), float(np.sqrt(high)))

    @property
    def sensor_intervals(self) -> list[tuple[float, float]]:
        """The intervals of the sensors' standard deviations."""
        first = self.disturbance.shape[0] * self.disturbance.shape[1]
        return [self.noise_interval(first + j) for j in range(self.noise.size)]

    def require_inside(self) -> None:
        """Refuse an estimate that lies outside one of its own intervals.

        An interval over several plausible delays may exclude the likeliest plant: then that plant
        does not represent the log.
        """
        outside = []
        for name, place in self.places.items():
            low, high = self.interval(name)
            if place < self.log.layout.size and not low <= self.value(name) <= high:
                outside.append(f"{name} ({self.value(name):.4g}, not {low:.4g} … {high:.4g})")
        if outside:
            raise ArgumentError(
                "log leaves several delays open, and their 95 % intervals do not hold the "
                f"likeliest plant: {', '.join(outside)}. Move the input more, log for longer, or "
                "narrow delay=(low, high), --delay LOW HIGH."
            )

    def _place(self, name: str) -> int:
        if name not in self.places:
            raise ArgumentError(f"name must be one of {', '.join(self.places)}, got {brief(name)}.")
        return self.places[name]


class IdentifiedLog(NamedTuple):
    """An estimate with its recording and the other fields of an `Identification`.

    states : names of states; model : of the switching, or None and the reason `why`
    sentences, doubts : those that not every estimate has
    linear : whether inputs taken as held change linearly between samples, as the log shows
    """

    estimate: Estimate
    recording: Recording
    model: SemiMarkov | None
    why: str
    C: SensorMatrix
    states: tuple[str, ...]
    sentences: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    modes: HiddenModes | None = None
    linear: bool = False


def variance_ends(value: float, error: float) -> tuple[float, float]:
    """The 95 % interval of a variance w with standard error E.

    log w is nearly normal where E is well below w. Otherwise w is, and its interval w ± 1.96 E
    begins at 0 at the least: then the log only bounds w from above.

    Examples
    --------
    >>> [round(end, 3) for given in ((1.0, 0.1), (0.001, 1.0)) for end in variance_ends(*given)]
    [0.822, 1.217, 0.0, 1.961]
    """
    if error > _OWN * value:
        return max(0.0, value - _REACH * error), value + _REACH * error
    wide = float(np.exp(_REACH * error / value)) if value else 1.0
    return value / wide, value * wide
