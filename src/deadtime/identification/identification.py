"""`Identification`: a plant identified from a log, with intervals, a verdict and a problem file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np

from deadtime.base.checks import positive
from deadtime.base.errors import ArgumentError
from deadtime.base.files import replacing
from deadtime.identification.departures import Departures, departures_of
from deadtime.identification.differences import contradictions
from deadtime.identification.estimate import IdentifiedLog
from deadtime.identification.identified_plant import Findings
from deadtime.identification.levels import rest_of
from deadtime.identification.sentences import repeats, sentences_of, verdict_of
from deadtime.identification.validation import (
    DOUBT,
    NOT_LOGGED,
    ComparedLog,
    Validation,
    doubt_of_free_run,
    read_to_compare,
    validate,
)

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from deadtime.feedback import Law
    from deadtime.margins import DelayMargin


@dataclass(frozen=True, eq=False, repr=False)
class Identification(Findings):
    """A plant identified from a log, with intervals at 95 % (immutable).

    Attributes
    ----------
    plant : SwitchedSystem
        The likeliest plant.
    delay_interval : (modes, m, 2) array
        Of every delay, seconds.
    step : float
        The sampling period of the log, seconds; its mean where rows are uneven.
    disturbance : (modes, n, n) array
        Intensity W of the process noise in each mode, :math:`x^2` per second; one for all modes
        where sensors are noisy.
    noise : (p,) array
        Standard deviations of the sensors; 0 where measurements are taken as exact.
    model : switching model or None
        The model of the switching, where enough sojourns were logged.
    tests : ResidualTests
        Tests of the residuals.
    states, inputs, modes : tuple of str
        Names of the log's columns and of its modes.
    log_likelihood : float
    samples : int
        Rows of the log.
    hidden : HiddenModes or None
        Modes that were not logged, with their probabilities.
    sentences : tuple of str
        The results in words.
    doubts : tuple of str
        Reasons why intervals may not contain the delays; then no verdict is "enough".
    departures : tuple of Departure
        What the log shows and the model lacks, such as a lag of the actuator: `name`, `statistic`
        (the rise of 2 log L), `chance`, `sentence`, `advice`, and `others` that explain nearly as
        much. Logs whose modes are hidden are not tested.
    validation : Validation or None
        How well the plant predicts the log of `test`.
    worse_than_constant : bool
        Whether the plant predicts that log, or the one it is from, worse than a constant.

    Examples
    --------
    See `identify`.
    """

    @classmethod
    def of(cls, log: IdentifiedLog) -> Identification:
        """The result of an estimate with its log."""
        from deadtime.identification.problem_text import filter_noise

        estimate, recording, C, states = log.estimate, log.recording, log.C, log.states
        estimate.require_inside()
        rest = rest_of(estimate, np.linalg.pinv(C))
        untimed = log.modes is not None or bool(repeats(recording))
        departures = Departures() if untimed else departures_of(estimate, log.linear)
        given = estimate, recording, C, log.why, rest, states, departures
        sentences, doubts = sentences_of(*given)
        fit = cls(
            plant=estimate.plant,
            delay_interval=estimate.log.layout.spread(estimate.intervals),
            step=recording.step,
            disturbance=estimate.disturbance,
            noise=estimate.noise,
            model=log.model,
            tests=estimate.tests,
            states=states,
            inputs=recording.inputs,
            modes=recording.modes,
            log_likelihood=estimate.best.value,
            samples=recording.samples,
            sentences=sentences,
            hidden=log.modes,
            doubts=(*doubts, *log.doubts),
            departures=departures.found,
            _estimate=estimate,
            _recording=recording,
            _C=C,
            _rest=rest,
        )
        _, raised = filter_noise(fit)
        own = (*sentences, raised) if raised else sentences
        first = log.modes is None or bool(fit.delays_not_found)
        joined = (*own, *log.sentences) if first else (*log.sentences, *own)
        return replace(fit, sentences=joined)

    def compare(self, log: str | PathLike[str] | pd.DataFrame | Sequence) -> Validation:
        """How well the plant predicts another log, which has the columns of its own.

        The free run begins at the logged state, or where sensors are noisy at the state that fits
        its first rows best, with the operating point of the plant. Differences of the log in gain,
        delay or level are tested and named. Predictions begin once the inputs of a longest delay
        are known, and again after lost rows.

        Parameters
        ----------
        log : path, DataFrame, or list of them

        Returns
        -------
        Validation

        Raises
        ------
        ArgumentError
            If the log is malformed or visits modes that the plant does not have, or if modes were
            not logged.

        Examples
        --------
        >>> import deadtime as dt, numpy as np, pandas as pd
        >>> rng = np.random.default_rng(0)
        >>> x, u = np.zeros(400), rng.standard_normal(400)
        >>> for k in range(3, 399):
        ...     x[k + 1] = 0.9 * x[k] + 0.06 * u[k - 3] + 0.04 * u[k - 2]
        ...     x[k + 1] += 0.01 * rng.standard_normal()
        >>> log = pd.DataFrame({"t": 0.1 * np.arange(400), "x": x, "u": u})
        >>> fit = dt.identify(log[:200], modes=None, delay=(0.0, 1.0))
        >>> validation = fit.compare(log[200:])
        >>> bool(validation.free_run[0] > 80.0), validation.samples
        (True, 196)
        """
        if self.hidden is not None:
            raise ArgumentError(NOT_LOGGED)
        compared = read_to_compare(log, self._recording, "log", None, self._estimate.searched[1])
        return validate(self._estimate, self._C, self._recording, compared)

    def validated(self, compared: ComparedLog | None) -> Identification:
        """With the validation by another log, and doubts where logs contradict the plant."""
        of = self._estimate, self._C, self._recording
        worse, free = doubt_of_free_run(*of)
        sentences, doubts = contradictions(*of) if self.hidden is None else ((), ())
        validation = None
        if compared is not None:
            validation = validate(*of, compared)
            worse |= validation.worse_than_constant
            free = (*validation.sentences, *free)
        answer = int(bool(self.delays_not_found))  # a delay that is not found is said first
        first, rest = self.sentences[:answer], self.sentences[answer:]
        ahead, later = (free, ()) if worse else ((), free)
        return replace(
            self,
            sentences=(*first, *ahead, *sentences, *rest, *later),
            doubts=(*((DOUBT,) if worse else ()), *self.doubts, *doubts),
            validation=validation,
            worse_than_constant=worse,
        )

    def verdict(
        self, margin: DelayMargin, law: Law | None = None, step: float | None = None
    ) -> str:
        """Whether a law tolerates every delay in the intervals, as a sentence.

        A margin is for a common error of all delays. For several delays the verdict is "enough"
        only if the law is given, too: each input's delay alone is then compared with its margin,
        and the loop must decay in every constant mode at all corners of the box of intervals (up to
        4 inputs). Delays between corners, and different errors while modes switch, are not tested.
        Nothing is enough while intervals are in doubt: see `doubts`. With a law the sentence also
        gives the share of plants, drawn from `uncertain`, on which every constant mode decays.

        Parameters
        ----------
        margin : DelayMargin
            Of the law on `plant`: `deadtime.delay_margin(fit.plant, law, fit.step, dwell_time)`.
        law : Law, optional
            The law, for different errors of delays, and errors of A and B.
        step : float, optional
            Its sampling period, seconds; the log's by default.

        Returns
        -------
        str

        Examples
        --------
        >>> import deadtime as dt, numpy as np, pandas as pd
        >>> rng = np.random.default_rng(1)
        >>> x, u = np.zeros(200), rng.standard_normal(200)
        >>> for k in range(3, 199):
        ...     x[k + 1] = 1.05 * x[k] + 0.06 * u[k - 3] + 0.04 * u[k - 2]
        ...     x[k + 1] += 0.005 * rng.standard_normal()
        >>> log = pd.DataFrame({"t": 0.1 * np.arange(200), "x": x, "u": u})
        >>> fit = dt.identify(log, modes=None, delay=(0.0, 1.0), hold="held")
        >>> law = dt.AveragedPredictor(fit.plant, dt.place(fit.plant, [-1.0]))
        >>> print(fit.verdict(dt.delay_margin(fit.plant, law, 0.1)))
        Delay 0.2594 s (0.2589 … 0.26); the law tolerates 0 … 1.054 s: enough.
        """
        period = self.step if step is None else positive("step", step)
        return verdict_of(self, margin, law, period)

    def save(
        self, path: str | PathLike[str], *, title: str = "", horizon: float | None = None
    ) -> None:
        r"""Write a problem file: plant, names, switching, mode filter, and first gains.

        The gains minimise :math:`\int |x|^2 + |u|^2 \, dt`; change them to yours. Laws are the
        paper's.

        Parameters
        ----------
        path : path
            The file, TOML.
        title : str
            The title of the problem.
        horizon : float, optional
            Length of its run, seconds; by default 20 times the longest delay, and at least 5 mean
            sojourns of the mode that lasts longest.
        """
        from deadtime.identification.problem_text import problem_text

        text = problem_text(self, title, horizon)
        with replacing(path) as place:
            place.write_text(text, encoding="utf-8")

    def plot(self) -> Figure:
        """The likelihood over the delays, predictions against the log, residuals, and modes."""
        from deadtime.identification.identification_figure import plot_identification

        return plot_identification(self)

    def __repr__(self) -> str:
        return (
            f"Identification(modes={self.plant.modes}, states={self.plant.states}, "
            f"inputs={self.plant.inputs}, delay={self.delays[0].round(6).tolist()}, "
            f"samples={self.samples})"
        )
