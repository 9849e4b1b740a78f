"""`Validation`: how well an identified plant predicts a log, which may be another one.

A fit is the normalised root mean square error of an output in percent, as MATLAB's `compare`,

    100 (1 − ‖y − ŷ‖ / ‖y − ȳ‖),

100 if exact, 0 for a constant, and negative below that. A free run that is worse than a constant
condemns the model if its own noise does not explain the error: with e the error and v its variance
by that noise, Σ e² > q Σ v, q the 1/1000 quantile of χ² of one degree of freedom. (No sum of
squares of normal errors with this mean, however correlated, has a larger one so far out.)
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import compress
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.base.wording import amount
from deadtime.identification.differences import CHANCE, ROUND_OFF, difference_of, inflation_of
from deadtime.identification.estimate import Estimate
from deadtime.identification.log.logged_states import resting, still
from deadtime.identification.log.read_recording import read_beside
from deadtime.identification.log.recording import Recording
from deadtime.identification.log.unit_changes import require_seconds
from deadtime.identification.parameters import SensorMatrix
from deadtime.identification.predictor import FreeRun, Predictor

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DOUBT = "the model predicts worse than a constant"
NOT_LOGGED = (
    "test, and compare, need modes that were logged: those of the test log would have to be found "
    "from the outputs to be predicted. Log the mode, and give its column by modes=, --modes."
)
_DELAYS = 3.0  # longest delays that predictions of several rows reach
_FEW = 20_000  # rows of the identified log that run freely
_COMPARED = 4_000  # rows in which differences are looked for
_UNITS = 0.2  # relative difference of a gain that may be one of units
_LARGER = 2.0  # ratio of variances from which errors count as larger


class Course(NamedTuple):
    """Outputs of a part in the log's own units: measured, run freely, and a row ahead."""

    time: Float[np.ndarray, " sample"]
    measured: Float[np.ndarray, "sample p"]
    free_run: Float[np.ndarray, "sample p"]
    one_step: Float[np.ndarray, "sample p"]


@dataclass(frozen=True, eq=False, repr=False)
class Validation(Frozen):
    """How well a plant predicts a log: fits in percent of every output (immutable).

    100 is exact and 0 is what the mean of the log as a constant prediction gives. NaN where nothing
    was predicted.

    Attributes
    ----------
    outputs : tuple of str
    free_run : (p,) array
        Fit of the run with inputs alone.
    one_step : (p,) array
        Fit of predictions a row ahead.
    last_value : (p,) array
        Fit of the prediction, in the same rows, that the last value holds.
    several_steps : (p,) array
        Fit of predictions `horizon` seconds ahead.
    horizon : float
        Three longest delays, and at least a row, seconds.
    samples : int
        Rows that the free run predicts.
    judged : bool
        Whether the free run tests the model: the plant is stable, and its noise does not explain
        the error.
    worse_than_constant : bool
        Whether the model predicts an output worse than a constant, farther than noise explains.
    sentences : tuple of str
        The results in words.
    courses : tuple of Course
        Times, measurements and predictions of every stretch between long gaps.

    Examples
    --------
    See `Identification.compare`.
    """

    outputs: tuple[str, ...]
    free_run: Float[np.ndarray, " p"]
    one_step: Float[np.ndarray, " p"]
    last_value: Float[np.ndarray, " p"]
    several_steps: Float[np.ndarray, " p"]
    horizon: float
    samples: int
    judged: bool
    worse_than_constant: bool
    sentences: tuple[str, ...]
    courses: tuple[Course, ...] = field(repr=False)

    @property
    def message(self) -> str:
        """The sentences, as one text."""
        return " ".join(self.sentences)

    def plot(self) -> Figure:
        """Every output as measured, run freely and a row ahead; and the errors of both."""
        from deadtime.identification.validation_figure import plot_validation

        return plot_validation(self.outputs, self.courses)

    def __repr__(self) -> str:
        each = ", ".join(
            f"{name}={free:.1f} % free, {one:.1f} % a row ahead"
            for name, free, one in zip(self.outputs, self.free_run, self.one_step, strict=True)
        )
        return f"Validation({each}, samples={self.samples})"


def fit_percent(
    measured: Float[np.ndarray, "sample p"], predicted: Float[np.ndarray, "sample p"]
) -> Float[np.ndarray, " p"]:
    """100 (1 − ‖y − ŷ‖ / ‖y − ȳ‖) of every column over the rows that have both; NaN without any.

    It is −∞ where a column is constant and predicted otherwise.

    Examples
    --------
    >>> y = np.array([[1.0], [2.0], [3.0]])
    >>> fit_percent(y, y), fit_percent(y, 0.0 * y + 2.0)
    (array([100.]), array([0.]))
    """
    both = np.isfinite(measured) & np.isfinite(predicted)
    y, off = np.where(both, measured, 0.0), np.where(both, measured - predicted, 0.0)
    mean = y.sum(axis=0) / np.maximum(both.sum(axis=0), 1)
    spread = np.linalg.norm(np.where(both, measured - mean, 0.0), axis=0)
    with np.errstate(over="ignore"):  # an unstable plant's free run
        size = np.linalg.norm(off, axis=0)
    still = np.where(size > 0.0, np.inf, np.nan)
    return 100.0 * (1.0 - np.divide(size, spread, out=still, where=spread > 0.0))


class ComparedLog(NamedTuple):
    """A recording to compare with predictions, and its name in sentences."""

    recording: Recording
    name: str


def log_to_compare(
    test: object, recording: Recording, before: float, rest: bool | None
) -> tuple[Recording, ComparedLog | None]:
    """The recording to identify, and that to validate with: held out of it, or read.

    before : seconds for which inputs may still act
    """
    if test is None:
        return recording, None
    share = 0.5 if isinstance(test, str) and test == "half" else test
    if not isinstance(share, float | int | np.floating) or isinstance(share, bool):
        return recording, read_to_compare(test, recording, "test", rest, before)
    if not 0.0 < share < 1.0:
        raise ArgumentError(
            'test must be "half", a share between 0 and 1 to hold out, or another log, got '
            f"{test!r}."
        )
    first, last = recording.divided(float(share), before)
    visited = [{int(i) for part in one.parts for i in part.mode if i >= 0} for one in (first, last)]
    if only := sorted(visited[1] - visited[0]):
        raise ArgumentError(
            f"test={test!r} holds out all rows of mode {recording.modes[only[0]]!r}: nothing would "
            "be known of it. Hold out less, such as test=0.2, --test 0.2, or give a second log."
        )
    return first, ComparedLog(last, "held-out part")


def read_to_compare(
    log: object, recording: Recording, argument: str, rest: bool | None, longest: float
) -> ComparedLog:
    """Another log as a recording; `longest`: delay that was searched, seconds."""
    other = read_beside(log, recording, argument)
    require_seconds(other, longest)
    return ComparedLog(resting(other, rest), "test log")


def validate(
    estimate: Estimate, C: SensorMatrix, recording: Recording, compared: ComparedLog
) -> Validation:
    """How well an estimate from `recording` predicts another one, or the same."""
    predictor = Predictor.of(estimate, C, compared.recording)
    predicted = _Predicted.by(predictor, max(estimate.plant.longest_delay, 0.0))
    figures = predicted.figures
    judged, worse, samples, sentences = False, False, 0, []
    if _rests(compared.recording, recording):
        figures = [np.full(len(C), np.nan)] * len(figures)
        sentences.append(
            f"Nothing moves in the {compared.name}: inputs are constant and outputs at rest, so "
            "that it does not test the model. Choose one in which inputs move: test=0.8, "
            "--test 0.8, holds out more, and test= or --test takes a second log."
        )
    elif not predicted.rows:
        sentences.append(
            f"No row of the {compared.name} can be predicted: inputs of a longest delay, "
            f"{estimate.plant.longest_delay:.4g} s, must be known before it."
        )
    else:
        samples = predicted.rows
        judged, worse, answer = predicted.answer(compared.name)
        sentences = [answer, *_a_row_ahead(predicted)] if judged else [answer]
        sentences += _details(predicted, estimate, C, recording, compared, judged)
    free, one_step, last, several = figures
    return Validation(
        outputs=compared.recording.outputs,
        free_run=free,
        one_step=one_step,
        last_value=last,
        several_steps=several,
        horizon=predicted.horizon,
        samples=samples,
        judged=judged,
        worse_than_constant=worse,
        sentences=tuple(sentences),
        courses=predicted.courses(),
    )


def doubt_of_free_run(
    estimate: Estimate, C: SensorMatrix, recording: Recording
) -> tuple[bool, tuple[str, ...]]:
    """Whether a plant predicts its own log worse than a constant, and a sentence if it seems so."""
    some = recording.stretches(_FEW, recording.lag(estimate.plant.longest_delay))
    predictor = Predictor.of(estimate, C, some)
    y, runs = _outputs(predictor), [predictor.free_run(i) for i in range(len(some.parts))]
    if not (fit_percent(y, _free_outputs(predictor, runs)) < 0.0).any():
        return False, ()
    predicted = _Predicted.by(predictor, estimate.plant.longest_delay)
    _, worse, answer = predicted.answer("log")
    return worse, (answer,)


class _Predicted(NamedTuple):
    """Predictions of all samples of a recording, (samples, p), about the level of the plant."""

    predictor: Predictor
    runs: list[FreeRun]
    free: Float[np.ndarray, "sample p"]
    one_step: Float[np.ndarray, "sample p"]
    last: Float[np.ndarray, "sample p"]
    several: Float[np.ndarray, "sample p"]
    steps: int

    @classmethod
    def by(cls, predictor: Predictor, longest: float) -> _Predicted:
        numbers, C = range(len(predictor.parts)), predictor.log.C
        steps = max(1, round(_DELAYS * longest / predictor.log.recording.step))
        runs = [predictor.free_run(i) for i in numbers]
        ahead = [predictor.ahead(i) for i in numbers]
        several = [predictor.several(i, one, steps) for i, one in zip(numbers, ahead, strict=True)]
        last = np.vstack([_last_values(part.output) for part in predictor.parts])
        one_step = np.where(np.isfinite(last), np.vstack(ahead) @ C.T, np.nan)
        last = np.where(np.isfinite(one_step), last, np.nan)
        free = _free_outputs(predictor, runs)
        return cls(predictor, runs, free, one_step, last, np.vstack(several) @ C.T, steps)

    @property
    def measured(self) -> Float[np.ndarray, "sample p"]:
        return _outputs(self.predictor)

    @property
    def horizon(self) -> float:
        return self.steps * self.predictor.log.recording.step

    @property
    def rows(self) -> int:
        """The number of rows that the free run predicts."""
        return int(np.isfinite(self.free * self.measured).any(axis=1).sum())

    @property
    def figures(self) -> list[Float[np.ndarray, " p"]]:
        """Fits in percent: free, a row ahead, by the last value, and several rows ahead."""
        each = self.free, self.one_step, self.last, self.several
        return [fit_percent(self.measured, one) for one in each]

    def answer(self, name: str) -> tuple[bool, bool, str]:
        """Whether the free run is judged, whether the model is worse than a constant; in words."""
        free, one_step, last, several = self.figures
        names = self.predictor.log.recording.outputs
        if not (free < 0.0).any():
            text = f"On the {name} the free run of the model fits {_percents(free, names)}, where "
            return True, False, f"{text}100 % is exact and 0 % a constant."
        why, worse = self._excuse(), False
        if not why:
            every = [self.predictor.free_run(i, noise=True) for i in range(len(self.runs))]
            variance = np.vstack([one.variance for one in every if one.variance is not None])
            worse = _beyond(self.measured - self.free, variance, free)
            why = "" if worse else "the model's own noise explains its error"
        said = f"On the {name} the model predicts worse than a constant: "
        if worse:
            return True, True, f"{said}free-run fit {_percents(free, names)}."
        off = self.measured - self.several
        variance = self.predictor.several_variance(self.steps)
        if _beyond(off, np.broadcast_to(variance, off.shape), several):
            text = f"{self.horizon:.3g} s ahead the fit is {_percents(several, names)}."
            return False, True, f"{said}{text}"
        some = bool(np.isfinite(several).all())
        return (
            False,
            False,
            f"The free run on the {name} is not judged, for {why}: the fit is "
            f"{f'{_percents(several, names)} over {self.horizon:.3g} s, and ' * some}"
            f"{_percents(one_step, names)} a row ahead, where the last value alone gives "
            f"{_percents(last, names)}.",
        )

    def _excuse(self) -> str:
        """Why a free run of a right model may diverge, however small its noise; "" if not."""
        modes = np.unique(np.concatenate([part.mode for part in self.predictor.parts]))
        rate = np.linalg.eigvals(self.predictor.model.plant.A[modes[modes >= 0]]).real.max()
        growth = float(rate) * max(run.longest for run in self.runs)
        if growth > 1.0:
            return "the plant is unstable by itself"
        slow = "the plant integrates, or has a time constant longer than the run"
        return slow if growth > -1.0 else ""

    def courses(self) -> tuple[Course, ...]:
        """The predictions of every part in the log's own units."""
        level, parts = self.predictor.log.recording.level, self.predictor.parts
        at = 0.0 if level is None else level.output
        cuts = np.cumsum([part.time.size for part in parts])[:-1]
        curves = (np.split(at + one, cuts) for one in (self.measured, self.free, self.one_step))
        return tuple(map(Course, (part.time for part in parts), *curves))


def _a_row_ahead(predicted: _Predicted) -> list[str]:
    (_, one_step, last, _), names = predicted.figures, predicted.predictor.log.recording.outputs
    return [
        f"A row ahead the fit is {_percents(one_step, names)}, where the last value alone gives "
        f"{_percents(last, names)}."
    ]


def _details(
    predicted: _Predicted,
    estimate: Estimate,
    C: SensorMatrix,
    recording: Recording,
    compared: ComparedLog,
    judged: bool,
) -> list[str]:
    """Sentences after the answer: figures a row ahead, differences, and limits of the test."""
    other, name, predictor = compared.recording, compared.name, predicted.predictor
    names, sentences = other.outputs, []
    few = other.stretches(_COMPARED, other.lag(estimate.searched[1]))
    inflation = inflation_of(list(estimate.white))
    # Of a plant whose delay the log leaves open, a difference says nothing of the other log.
    known = not (estimate.missed | estimate.range_flags[2]).any()
    difference = difference_of(Predictor.of(estimate, C, few), inflation) if known else None
    if difference is not None:
        words = difference.words(other.inputs, names)
        own = difference.applied(predictor)
        runs = [own.free_run(i) for i in range(len(own.parts))]
        fits = fit_percent(_outputs(own), _free_outputs(own, runs))
        far = difference.gain is not None and (np.abs(difference.gain - 1.0) > _UNITS).any()
        units = " Compare the units of its columns." if far else ""
        sentences.append(
            f"The {name} differs from the model: {words} (likelihood ratio, level {CHANCE:g})"
            f"{f'; the free run would fit {_percents(fits, names)} with that' * judged}.{units}"
        )
    else:
        sentences += _larger_errors(
            predictor, Predictor.of(estimate, C, recording), inflation, name
        )
    used, starts = sum(r.used for r in predicted.runs), sum(len(r.starts) for r in predicted.runs)
    each = "The free run" if starts == 1 else f"Each of {starts} free runs"
    first = f"state that fits its first {used // starts} rows best"
    sentences.append(f"{each} starts from the {'logged state' if predictor.exact else first}.")
    constant = _constant(other)
    if constant.all():
        sentences.append(
            f"Inputs are constant in the {name}: it tests the return to rest, and not the delay."
        )
    else:
        sentences += [
            f"{one} is constant in the {name}, which does not test its gain and delay."
            for one in compress(other.inputs, constant)
        ]
    for one, value in other.constants:
        sentences.append(
            f"{one} is {value:.6g} throughout the log that was identified and another in the "
            f"{name}: the model does not have its effect."
        )
    visited = np.unique(np.concatenate([part.mode for part in other.parts]))
    for i in np.setdiff1d(np.arange(len(other.modes)), visited).tolist():
        sentences.append(f"Mode {other.modes[i]!r} is not visited in the {name}: nothing tests it.")
    return sentences


def _larger_errors(predictor: Predictor, own: Predictor, inflation: float, name: str) -> list[str]:
    """A sentence on errors a row ahead that are larger than on the log that was identified."""
    from scipy.stats import f

    delays = own.model.plant.delays
    window = float(delays.min()), float(delays.max())
    late, early = (one.errors(one.vector, window) for one in (predictor, own))
    squares, counts = (
        [reduced(one, axis=0) for one in (late, early)]
        for reduced in (
            lambda e, axis: np.nansum(e**2, axis),
            lambda e, axis: np.isfinite(e).sum(axis),
        )
    )
    size = ROUND_OFF * np.nanstd(_outputs(own), axis=0) if own.exact else 0.0
    floor = np.maximum(size**2, np.finfo(float).tiny)
    mean = [s / np.maximum(n, 1) for s, n in zip(squares, counts, strict=True)]
    ratio = mean[0] / np.maximum(mean[1], floor)
    if own.exact:  # errors are scaled to the period of their own recording
        ratio *= own.log.recording.step / predictor.log.recording.step
    free = [np.maximum(n / inflation, 1.0) for n in counts]
    chance = float((f.sf(ratio, *free) * ratio.size).min())
    if ratio.max() < _LARGER or chance > CHANCE:
        return []
    return [
        f"Errors a row ahead are {amount(float(np.sqrt(ratio.max())))} times those on the log that "
        f"was identified (F test, level {CHANCE:g}): the noise of the {name} or its plant is "
        "another one."
    ]


def _beyond(
    off: Float[np.ndarray, "sample p"],
    variance: Float[np.ndarray, "sample p"],
    fits: Float[np.ndarray, " p"],
) -> bool:
    """Whether an output with a negative fit has errors that the model's noise does not explain."""
    from scipy.stats import chi2

    known = np.isfinite(off)
    error, expected = (np.where(known, one, 0.0).sum(axis=0) for one in (off**2, variance))
    return bool(((fits < 0.0) & (error > chi2.isf(CHANCE, 1) * expected)).any())


def _outputs(predictor: Predictor) -> Float[np.ndarray, "sample p"]:
    return np.vstack([part.output for part in predictor.parts])


def _free_outputs(predictor: Predictor, runs: list[FreeRun]) -> Float[np.ndarray, "sample p"]:
    """Outputs of free runs, without the first states that were logged."""
    every = []
    for run in runs:
        states = run.states.copy()
        if predictor.exact:
            states[list(run.starts)] = np.nan
        every.append(states @ predictor.log.C.T)
    return np.vstack(every)


def _last_values(output: Float[np.ndarray, "sample p"]) -> Float[np.ndarray, "sample p"]:
    """The last known value of every column before each row; NaN where there is none."""
    import pandas as pd

    return pd.DataFrame(output).ffill().shift().to_numpy()


def _constant(recording: Recording) -> Bool[np.ndarray, " m"]:
    every = np.vstack([part.input for part in recording.parts])
    return np.asarray(np.nanmax(every, axis=0) == np.nanmin(every, axis=0))


def _rests(recording: Recording, other: Recording) -> bool:
    """Whether inputs are constant and outputs at rest, compared with their range in another log."""
    y, every = (np.vstack([part.output for part in one.parts]) for one in (recording, other))
    at_rest = (still(x, own) for x, own in zip(y.T, every.T, strict=True))
    return bool(_constant(recording).all()) and all(at_rest)


def _percents(fits: Float[np.ndarray, " p"], names: tuple[str, ...]) -> str:
    """Fits in words, with the names of several outputs."""
    each = [
        "undefined" if np.isnan(one) else f"{one:.1f} %".replace("-", "−").replace("inf", "∞")
        for one in fits
    ]
    if len(each) == 1:
        return each[0]
    of = [f"{one} of {name}" for one, name in zip(each, names, strict=True)]
    return f"{', '.join(of[:-1])} and {of[-1]}"
