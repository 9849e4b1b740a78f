"""Identification: a plant from a log, how well the log knows it, and what to do with it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import positive
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.identification.estimate import Estimate
from deadtime.identification.hidden.hidden_modes import HiddenModes
from deadtime.identification.hidden.identify_hidden import Hidden
from deadtime.identification.levels import Rest, rest_of
from deadtime.identification.log.recording import Recording
from deadtime.identification.outputs.following import largest_of
from deadtime.identification.residuals import ResidualTests
from deadtime.identification.results.sentences import doubts_of, sentences_of
from deadtime.identification.unknowns import Unknowns
from deadtime.plant import OperatingPoint, SwitchedSystem, UncertainPlant
from deadtime.switching import SemiMarkov

_SINGULAR = 1e9  # a condition number: rests are not found beyond it

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from deadtime.feedback import Law
    from deadtime.identification.results.delay_verdict import Margin


@dataclass(frozen=True, eq=False, repr=False)
class Identification(Frozen):
    """A plant that `identify` found, with intervals at 95 % (immutable).

    Attributes
    ----------
    plant : SwitchedSystem
        The likeliest plant.
    delay_interval : (modes, m, 2) array
        Of every delay, seconds.
    step : float
        The sampling period of the log, seconds; its mean where rows are uneven.
    disturbance : (modes, n, n) array
        Intensity W of the process noise in each mode, x² per second; one for all modes where
        sensors are noisy.
    noise : (p,) array
        Standard deviations of the sensors; 0 where measurements are taken as exact.
    model : SemiMarkov or None
        How the mode switches, where enough sojourns were logged.
    tests : ResidualTests
        Whether what is left looks like chance.
    states, inputs, modes : tuple of str
        Names: those of the log's columns and of its modes.
    log_likelihood : float
    samples : int
        Rows of the log.
    hidden : HiddenModes or None
        Of modes that were not logged: which was active when, and how sure that is.
    sentences : tuple of str
        What there is to say, in words.
    doubts : tuple of str
        Why intervals of delays may not hold them; then no verdict is "enough".

    Examples
    --------
    See `identify`.
    """

    plant: SwitchedSystem
    delay_interval: Float[np.ndarray, "mode m 2"]
    step: float
    disturbance: Float[np.ndarray, "mode n n"]
    noise: Float[np.ndarray, " p"]
    model: SemiMarkov | None
    tests: ResidualTests
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    modes: tuple[str, ...]
    log_likelihood: float
    samples: int
    sentences: tuple[str, ...]
    _found: Estimate = field(repr=False)
    _recording: Recording = field(repr=False)
    _C: Float[np.ndarray, "p n"] = field(repr=False)
    hidden: HiddenModes | None = None
    doubts: tuple[str, ...] = ()
    _rest: Rest | None = field(default=None, repr=False)

    @classmethod
    def of(
        cls,
        found: Estimate,
        recording: Recording,
        model: SemiMarkov | None,
        why: str,
        C: Float[np.ndarray, "p n"],
        states: tuple[str, ...],
    ) -> Identification:
        """What there is to hand over of an estimate; `why` there is no switching model."""
        Unknowns(found, recording.step).require_inside()
        rest = rest_of(found, np.linalg.pinv(C))
        fit = cls(
            found.plant,
            found.log.layout.spread(found.intervals),
            recording.step,
            found.disturbance,
            found.noise,
            model,
            found.tests,
            states,
            recording.inputs,
            recording.modes,
            found.best.found.value,
            recording.samples,
            sentences_of(found, recording, why, rest, states),
            found,
            recording,
            C,
            _rest=rest,
            doubts=doubts_of(found, recording),
        )
        raised = fit._filter_noise[1]
        return replace(fit, sentences=(*fit.sentences, raised)) if raised else fit

    @classmethod
    def of_hidden(
        cls, hidden: Hidden, C: Float[np.ndarray, "p n"], states: tuple[str, ...]
    ) -> Identification:
        """The same of modes that were not logged."""
        if hidden.estimate is None:
            raise ArgumentError("hidden must have an estimate.")
        given = hidden.estimate, hidden.recording, hidden.model, hidden.why
        fit = cls.of(*given, C, states)
        return replace(fit, sentences=(*hidden.sentences, *fit.sentences), hidden=hidden.modes)

    @property
    def delays(self) -> Float[np.ndarray, "mode m"]:
        """The likeliest delay of every mode and input, seconds."""
        return self.plant.delays

    @property
    def operating_point(self) -> OperatingPoint | None:
        """Where the plant rests: its states and inputs are deviations from that. None: from 0."""
        return None if self._rest is None else self._rest.point

    @property
    def rest_error(self) -> Float[np.ndarray, " n"]:
        """Standard errors of the states at which the plant rests under u₀ of the operating point.

        A plant of one mode rests at a state for every input, so that x₀ and u₀ are chosen together;
        what the log leaves open is x₀ for that u₀: the solution of A_i x = −B_i u₀ − c_i over all
        modes by least squares, of which the right-hand sides are as uncertain as the entries. NaN
        where many states solve it, as of a plant that integrates, where modes rest apart
        (`offset`), and where there is no point.
        """
        modes, n, _ = self.plant.A.shape
        point, level = self.operating_point, self._recording.level
        A = self.plant.A.reshape(-1, n)
        apart = bool(self.offset.any())
        if point is None or level is None or apart or np.linalg.cond(A) > _SINGULAR:
            return np.full(n, np.nan)
        layout, place = self._found.log.layout, np.indices((modes, n))
        x, u = point.x - np.linalg.pinv(self.C) @ level.output, point.u - level.input
        by_theta = np.zeros((modes, n, layout.size))
        for b in range(n):
            by_theta[(*place, layout.of_A[:, :, b])] = x[b]
        for j, value in enumerate((*u, 1.0)):
            by_theta[(*place, layout.of_B[:, :, j])] = value
        moved = np.linalg.pinv(A) @ by_theta.reshape(-1, layout.size)
        covariance = self._found.spread.covariance[: layout.size, : layout.size]
        return np.sqrt(np.diagonal(moved @ covariance @ moved.T))

    @property
    def offset(self) -> Float[np.ndarray, "mode n"]:
        """What each mode adds to dx/dt at the operating point; 0 where all modes rest there."""
        return np.zeros(self.plant.A.shape[:2]) if self._rest is None else self._rest.offset

    @property
    def C(self) -> Float[np.ndarray, "p n"]:
        """What the log's columns are of the states; the identity where they are the states."""
        return self._C

    @property
    def largest_states(self) -> Float[np.ndarray, " n"]:
        """The largest |x| of every state in the log."""
        if (log := self._found.of_outputs) is not None:
            return largest_of(log, self._found.best.theta, self._found.window)
        back, recording = np.linalg.pinv(self._C).T, self._recording.absolute()
        every = np.vstack([part.output @ back for part in recording.parts])
        at = 0.0 if self.operating_point is None else self.operating_point.x
        return np.nanmax(np.abs(every - at), axis=0)

    @property
    def uncertain(self) -> UncertainPlant:
        """The plant with the covariance of all its entries and delays: to draw, and corners."""
        _, own = self._found.log.layout.without_constant()
        return UncertainPlant(self.plant, self._found.spread.covariance[np.ix_(own, own)])

    @cached_property
    def _filter_noise(self) -> tuple[Float[np.ndarray, "n n"], str]:
        """W of the saved file's observer, and why it is not `disturbance`; "" where it is."""
        from deadtime.identification.results.filter_noise import filter_noise

        return filter_noise(self)

    @property
    def message(self) -> str:
        """The sentences, as one text."""
        return " ".join(self.sentences)

    @property
    def names(self) -> tuple[str, ...]:
        """What `interval` knows by name: entries A[i][a,b], B[i][a,j] of mode i, delays, noise.

        From outputs alone those entries that the choice of states fixes are left out.
        """
        return tuple(self._unknowns.places)

    @cached_property
    def _unknowns(self) -> Unknowns:
        return Unknowns(self._found, self.step)

    def estimate(self, name: str) -> float:
        """The likeliest value of one unknown, by its name; see `interval`."""
        return self._unknowns.estimate(name)

    def interval(self, name: str) -> tuple[float, float]:
        """The ends of the 95 % interval of one unknown.

        Parameters
        ----------
        name : str
            One of `names`: "delay", or "delay[j]" of input j where there are several, "delay[i][j]"
            where every mode i has its own; "A[0][0,1]", "B[1][2,0]"; "disturbance[0][1,1]" for a
            diagonal entry of W in mode 0; "noise[1]" for the second sensor. Noise that the log does
            not tell from none begins at 0: it is less than the other end.

        Raises
        ------
        ArgumentError
            If there is no such name.
        """
        return self._unknowns.interval(name)

    def verdict(self, margin: Margin, law: Law | None = None, step: float | None = None) -> str:
        """Whether a law stands every delay that the log allows.

        A margin is of delays that all err alike. Of several delays it is "enough" only where the
        law is given, too: then each input's delay alone is held against its margin, and the loop
        must decay in every mode, held, at all corners of the box of intervals (up to 4 inputs).
        Delays between corners, and different errors while modes switch, are not looked at. Nothing
        is enough while intervals are in doubt: see `doubts`. Of a law
        that is given it also says on how many plants, drawn from all that the log leaves open
        (`uncertain`), every mode held decays.

        Parameters
        ----------
        margin : DelayMargin
            Of the law on `plant`: `deadtime.delay_margin(fit.plant, law, fit.step, dwell_time)`.
        law : Law, optional
            The law, for errors that differ, and those of A and B.
        step : float, optional
            Its sampling period, seconds; that of the log by default.

        Examples
        --------
        >>> import deadtime as dt, numpy as np, pandas as pd
        >>> rng = np.random.default_rng(1)
        >>> x, u = np.zeros(200), rng.standard_normal(200)
        >>> for k in range(3, 199):
        ...     x[k + 1] = 1.05 * x[k] + 0.06 * u[k - 3] + 0.04 * u[k - 2]
        ...     x[k + 1] += 0.005 * rng.standard_normal()
        >>> log = pd.DataFrame({"t": 0.1 * np.arange(200), "x": x, "u": u})
        >>> fit = dt.identify(log, modes=None, delay=(0.0, 1.0))
        >>> law = dt.AveragedPredictor(fit.plant, dt.place(fit.plant, [-1.0]))
        >>> print(fit.verdict(dt.delay_margin(fit.plant, law, 0.1)))
        Delay 0.2594 s (0.2589 … 0.26); the law bears 0 … 1.054 s: enough.
        """
        from deadtime.identification.results.delay_verdict import verdict_of

        period = self.step if step is None else positive("step", step)
        return verdict_of(self, margin, law, period)

    def save(
        self, path: str | PathLike[str], *, title: str = "", horizon: float | None = None
    ) -> None:
        """Write a problem file: plant, names, switching, mode filter, and gains to begin with.

        Gains are those of least ∫|x|² + |u|²; change them to yours. Laws are the paper's.

        Parameters
        ----------
        path : path
            The file, TOML.
        title : str
            Of the problem.
        horizon : float, optional
            Length of its run, seconds; by default 20 times the longest delay, and at least 5 mean
            sojourns of the mode that lasts longest.
        """
        from deadtime.identification.results.problem_text import problem_text, write_problem

        write_problem(problem_text(self, title, horizon), path)

    def plot(self) -> Figure:
        """The likelihood over the delays, predictions against the log, residuals, and modes."""
        from deadtime.identification.results.identification_figure import plot_identification

        return plot_identification(self)

    def __repr__(self) -> str:
        return (
            f"Identification(modes={self.plant.modes}, states={self.plant.states}, "
            f"inputs={self.plant.inputs}, delay={self.delays[0].round(6).tolist()}, "
            f"samples={self.samples})"
        )
