"""An identified plant: its operating point, errors, intervals by name, and covariance.

The operating point's error and the covariance follow from the information at the maximum of the
likelihood, by linear propagation of errors.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from itertools import compress

import numpy as np
from jaxtyping import Float

from deadtime.base.frozen import Frozen
from deadtime.identification.departures import Departure
from deadtime.identification.estimate import Estimate, HiddenModes
from deadtime.identification.levels import Rest
from deadtime.identification.likelihoods.noisy_log import largest_of
from deadtime.identification.log.recording import Recording
from deadtime.identification.parameters import SensorMatrix, Squares
from deadtime.identification.process_models import Process, processes_of
from deadtime.identification.residuals import ResidualTests
from deadtime.identification.validation import Validation
from deadtime.plant import OperatingPoint, SwitchedSystem, UncertainPlant
from deadtime.switching import SwitchingModel

_SINGULAR = 1e9  # condition number of A beyond which the rest is not unique


@dataclass(frozen=True, eq=False, repr=False)
class Findings(Frozen):
    """An identified plant with intervals at 95 %: see `Identification`."""

    plant: SwitchedSystem
    delay_interval: Float[np.ndarray, "mode m 2"]
    step: float
    disturbance: Squares
    noise: Float[np.ndarray, " p"]
    model: SwitchingModel | None
    tests: ResidualTests
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    modes: tuple[str, ...]
    log_likelihood: float
    samples: int
    sentences: tuple[str, ...]
    _estimate: Estimate = field(repr=False)
    _recording: Recording = field(repr=False)
    _C: SensorMatrix = field(repr=False)
    hidden: HiddenModes | None = None
    doubts: tuple[str, ...] = ()
    departures: tuple[Departure, ...] = ()
    validation: Validation | None = None
    worse_than_constant: bool = False
    _rest: Rest | None = field(default=None, repr=False)

    @property
    def delays(self) -> Float[np.ndarray, "mode m"]:
        """The likeliest delay of every mode and input, seconds."""
        return self.plant.delays

    @property
    def read_as(self) -> tuple[str, ...]:
        """How the files of the log were read, in sentences, where not as plain CSV files."""
        return self._recording.read_as

    @property
    def delays_not_found(self) -> tuple[str, ...]:
        """Names of the delays that fit best at an end of the range searched, other than 0."""
        layout = self._estimate.log.layout
        return tuple(compress(layout.names()[layout.at_delays], self._estimate.missed))

    @property
    def operating_point(self) -> OperatingPoint | None:
        """Where the plant rests: its states and inputs are deviations from that. None: from 0."""
        return None if self._rest is None else self._rest.point

    @property
    def rest_error(self) -> Float[np.ndarray, " n"]:
        """Standard errors of the states at which the plant rests under u₀ of the operating point.

        A plant of one mode has a rest for every input, so x₀ and u₀ are chosen together. The error
        is that of x₀ for this u₀: of the least-squares solution of A_i x = −B_i u₀ − c_i over all
        modes, by propagation of the covariance of all entries. NaN where the solution is not
        unique, as for an integrating plant, where modes have different rests (`offset`), and where
        there is no operating point.
        """
        modes, n, _ = self.plant.A.shape
        point, level = self.operating_point, self._recording.level
        A = self.plant.A.reshape(-1, n)
        apart = bool(self.offset.any())
        if point is None or level is None or apart or np.linalg.cond(A) > _SINGULAR:
            return np.full(n, np.nan)
        layout, place = self._estimate.log.layout, np.indices((modes, n))
        x, u = point.x - np.linalg.pinv(self.C) @ level.output, point.u - level.input
        by_theta = np.zeros((modes, n, layout.size))
        for b in range(n):
            by_theta[(*place, layout.of_A[:, :, b])] = x[b]
        for j, value in enumerate((*u, 1.0)):
            by_theta[(*place, layout.of_B[:, :, j])] = value
        moved = np.linalg.pinv(A) @ by_theta.reshape(-1, layout.size)
        covariance = self._estimate.spread.covariance[: layout.size, : layout.size]
        return np.sqrt(np.diagonal(moved @ covariance @ moved.T))

    @property
    def offset(self) -> Float[np.ndarray, "mode n"]:
        """The constant that each mode adds to dx/dt at the operating point; 0 if all rest there."""
        return np.zeros(self.plant.A.shape[:2]) if self._rest is None else self._rest.offset

    @property
    def C(self) -> SensorMatrix:
        """The map from states to the log's columns; the identity where these are the states."""
        return self._C

    @property
    def largest_states(self) -> Float[np.ndarray, " n"]:
        """The largest magnitude of every state in the log."""
        if (log := self._estimate.of_outputs) is not None:
            return largest_of(log, self._estimate.best.theta, self._estimate.window)
        back, recording = np.linalg.pinv(self._C).T, self._recording.absolute()
        every = np.vstack([part.output @ back for part in recording.parts])
        at = 0.0 if self.operating_point is None else self.operating_point.x
        return np.nanmax(np.abs(every - at), axis=0)

    @property
    def uncertain(self) -> UncertainPlant:
        """The plant with the covariance of all its entries and delays: to draw, and corners."""
        _, own = self._estimate.log.layout.without_constant()
        return UncertainPlant(self.plant, self._estimate.spread.covariance[np.ix_(own, own)])

    @cached_property
    def processes(self) -> tuple[Process, ...]:
        """Gain, time constants and dead time of every stable mode, output and input: see `Process`.

        Those whose delay the log does not tell are left out, as are plants of more than 4 states.
        """
        return processes_of(self._estimate, self._recording, self._C)

    @property
    def message(self) -> str:
        """The sentences, as one text."""
        return " ".join(self.sentences)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of unknowns: entries A[i][a,b], B[i][a,j] of mode i, delays, noise.

        With outputs alone, entries fixed by the choice of states are left out.
        """
        return tuple(self._estimate.places)

    def estimate(self, name: str) -> float:
        """The likeliest value of one unknown, by its name; see `interval`."""
        return self._estimate.value(name)

    def interval(self, name: str) -> tuple[float, float]:
        """The ends of the 95 % interval of one unknown.

        Parameters
        ----------
        name : str
            One of `names`: "delay", or "delay[j]" of input j where there are several, "delay[i][j]"
            where every mode i has its own; "A[0][0,1]", "B[1][2,0]"; "disturbance[0][1,1]" for a
            diagonal entry of W in mode 0; "noise[1]" for the second sensor. An interval of noise
            that may be 0 begins at 0.

        Returns
        -------
        low, high : float

        Raises
        ------
        ArgumentError
            If there is no such name.
        """
        return self._estimate.interval(name)
