"""`Identification`: a plant identified from a log, with intervals, a verdict and a problem file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np

from deadtime.base.checks import positive
from deadtime.base.files import replacing
from deadtime.identification.departures import Departures, departures_of
from deadtime.identification.estimate import IdentifiedLog
from deadtime.identification.identified_plant import Findings
from deadtime.identification.levels import rest_of
from deadtime.identification.sentences import repeats, sentences_of, verdict_of

if TYPE_CHECKING:
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
        departures = Departures() if untimed else departures_of(estimate)
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
        >>> fit = dt.identify(log, modes=None, delay=(0.0, 1.0))
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
