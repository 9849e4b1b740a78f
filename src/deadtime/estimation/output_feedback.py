"""A predictor law on the state that an observer estimates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import instance, read_only, real_array, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.estimation.observer import Observer
from deadtime.estimation.servo import Drawable, Reference, Servo
from deadtime.feedback import Feedback, Forecast, Law
from deadtime.feedback.law import Update, UpdateWithEstimates
from deadtime.feedback.memory import Memory, MemorySizes, Tables
from deadtime.loop.running_observer import RunningObserver
from deadtime.numerics.streams import stream
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.plant.weight import weight_matrix
from deadtime.switching import SwitchingSignal


@dataclass(frozen=True, eq=False, init=False, repr=False)
class OutputFeedback(Law):
    r"""A law that acts on an observer's estimate of the state from :math:`y = C_\sigma x`.

    Every law may be used: it is given x̂ instead of x. Its model and the observer's are the same
    where nothing is known to the contrary, but need not be. With the right model, an exact first
    estimate and switches on samples the loop is the one of state feedback. A lost sample is
    predicted over: the input goes on, it is not held.

    With a `servo` the law is one of the servo's extended plant (`deadtime.Servo`): outputs follow
    a reference, and constant disturbances leave no offset.

    Parameters
    ----------
    law : Law
        The law, of the observed plant; with a servo, a law with a table, of `servo.plant`.
    observer : Observer
        Of the same plant; with a servo, of `servo.model`. It fixes the period. It reads the mode,
        whether or not the law does, unless it is of one model (`luenberger(…, model="mean")`).
    servo : Servo, optional
        What is tracked.
    reference : optional
        r: a number, shape (tracked,), a pair (times, values) with values of shape (T,) or
        (T, tracked), each held until the next time, or a function of time. 0 by default. Or a
        distribution that scipy.stats freezes: every run draws a constant for each output.
    estimate : array_like, shape (n,), optional
        First estimate, of the observer's states; 0 by default.
    covariance : array_like, shape (n, n), (n,) or a number, optional
        Its covariance, a diagonal or a number times the identity: every run draws its own first
        estimate, normal around `estimate`. The draw depends on the seed of the run alone (`drawn`);
        where there is no run, as in `Controller` and exports, the mean applies.

    Raises
    ------
    ArgumentError
        If law, observer and servo do not belong together; by `digital` and `ideal`, always.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> law = dt.AveragedPredictor(problem.plant, problem.gains)
    >>> observer = dt.luenberger(problem.plant, [[1.0, 0.0]], poles=[-4, -5], step=0.02)
    >>> loop = dt.OutputFeedback(law, observer)
    >>> run = dt.simulate(problem.plant, loop, problem.signal, problem.x0, 10.0, step=0.02)
    >>> run.measured.shape, run.estimates.shape, run.diverged
    ((1, 501), (2, 501), False)
    """

    law: Law
    observer: Observer
    servo: Servo | None
    reference: Reference | None
    estimate: Float[np.ndarray, " n"]
    covariance: Float[np.ndarray, "n n"] | None

    def __init__(
        self,
        law: Law,
        observer: Observer,
        *,
        servo: Servo | None = None,
        reference: ArrayLike
        | tuple[ArrayLike, ArrayLike]
        | Callable[[float], ArrayLike]
        | Drawable = 0.0,
        estimate: ArrayLike | None = None,
        covariance: ArrayLike | None = None,
    ) -> None:
        instance("law", law, Law)
        instance("observer", observer, Observer)
        if law.outputs is not None:
            raise ArgumentError("law must take the state: this one measures outputs already.")
        n = observer.plant.states
        if servo is None:
            _same("law", law.plant, "the observer's plant", _with_delays(observer, law.plant))
            followed = None
            if not (np.isscalar(reference) and reference == 0.0):
                raise ArgumentError("reference needs a servo: `Servo` says what tracks it.")
        else:
            instance("servo", servo, Servo)
            if not law.is_linear:
                raise ArgumentError(
                    f"law must be a table to follow a reference, got {type(law).__name__}: laws on "
                    "a belief, or on a rule of the state, follow none. Where the mode is not "
                    "measured, take AveragedPredictor or MeanPredictor on an observer that reads "
                    'none, luenberger(…, model="mean").'
                )
            _same("law", law.plant, "servo.plant", servo.plant)
            _same("observer", _with_delays(observer, servo.model), "servo.model", servo.model)
            followed = Reference.of(reference, servo.tracked.shape[0])
        first = np.zeros(n) if estimate is None else estimate
        first = require_shape("estimate", real_array("estimate", first, "(n,)", 1), (n,), "(n,)")
        if covariance is not None:
            covariance = weight_matrix("covariance", covariance, n, "n")
        states = n if servo is None else servo.base.states
        vars(self).update(
            plant=law.plant if servo is None else servo.base,
            gains=law.gains if servo is None else None,
            outputs=observer.C[:, :, :states],
            law=law,
            observer=observer,
            servo=servo,
            reference=followed,
            estimate=first,
            covariance=covariance,
        )

    @property
    def draws(self) -> bool:
        return self.covariance is not None or (
            self.reference is not None and self.reference.distribution is not None
        )

    def drawn(self, seed: int) -> OutputFeedback:
        """The law of the run with a seed: first estimate and reference drawn, for all laws alike.

        Examples
        --------
        >>> import deadtime as dt
        >>> problem = dt.problems.paper()
        >>> law = dt.AveragedPredictor(problem.plant, problem.gains)
        >>> observer = dt.luenberger(problem.plant, [[1.0, 0.0]], poles=[-4, -5], step=0.02)
        >>> loop = dt.OutputFeedback(law, observer, covariance=[[0.1, 0.0], [0.0, 0.2]])
        >>> loop.drawn(1).estimate.round(3), loop.drawn(1).draws
        (array([0.009, 0.501]), False)
        """
        if not self.draws:
            return self
        first, reference = self.estimate, self.reference
        if self.covariance is not None:
            # np.linalg.cholesky refuses semidefinite matrices.
            values, vectors = np.linalg.eigh(self.covariance)
            number = stream(seed, "Estimate").standard_normal(first.size)
            first = first + vectors @ (np.sqrt(np.maximum(values, 0.0)) * number)
        if reference is None:
            return OutputFeedback(self.law, self.observer, estimate=first)
        reference = reference.drawn(stream(seed, "Reference"))
        return OutputFeedback(
            self.law, self.observer, servo=self.servo, reference=reference, estimate=first
        )

    @property
    def row_law(self) -> Law:
        return self.law

    @property
    def is_linear(self) -> bool:
        return self.law.is_linear

    @property
    def label(self) -> str:
        return f"{self.law.label}, observed"

    @property
    def observer_alone_reads_mode(self) -> bool:
        if not self.observer.reads_mode or self.why_not_run:
            return False
        return self.law.digital(self.observer.step).context == "none"

    @property
    def needs_preview(self) -> bool:
        return self.law.needs_preview

    @property
    def previewed(self) -> SwitchingSignal | None:
        return self.law.previewed

    def digital(
        self, step: float, signal: SwitchingSignal | None = None, steps: int | None = None
    ) -> Feedback:
        raise ArgumentError(
            "OutputFeedback has no table: it keeps an estimate. `growth_rate`, the margins, "
            "`certify` and `falsify` take it; for the rest ask about its .law, which is given the "
            "state, and its .observer (.rates)."
        )

    def ideal(self, signal: SwitchingSignal, horizon: float) -> Forecast:
        raise ArgumentError(
            "step must be given for OutputFeedback: its observer runs at samples, every "
            f"{self.observer.step:g} s."
        )

    def require_step(self, step: float) -> None:
        """Refuse a period that is not the observer's."""
        if step != self.observer.step:
            raise ArgumentError(
                f"step must be the observer's, {self.observer.step:g} s, got {step:g}: design the "
                "observer for the period of the loop."
            )

    def memory(
        self,
        step: float,
        signal: SwitchingSignal | None = None,
        steps: int | None = None,
        samples: int = 1,
    ) -> Memory:
        """The observer as data, with so many references; `signal`, `steps` as in `Law.digital`."""
        self.require_step(step)
        observer, servo, modes = self.observer, self.servo, self.observer.plant.modes
        Phi, Gamma, lag = SampledPlant.of(observer.plant, step).periods()
        tracked = np.zeros((0, observer.outputs)) if servo is None else servo.tracked
        q, r = 0 if servo is None else servo.sums, len(tracked)
        push = np.zeros((modes, self.plant.inputs, 0))
        push = self._push(self.law.digital(step, signal, steps)) if q else push
        # A row of every mode:  | Φ | Γ by lag | C | L | push |
        parts = Phi, Gamma, observer.C, observer.gain, push
        reference = np.zeros((samples, r))
        if self.reference is not None:
            reference = self.reference.along(np.arange(samples) * step)
        start = np.concatenate((self.estimate, np.zeros(q + r)))
        matrices = np.concatenate([part.reshape(modes, -1) for part in parts], axis=1)
        n, p, m = observer.plant.states, observer.outputs, self.plant.inputs
        sizes = MemorySizes(n, p, q, r, m, lag.size)
        arrays = (read_only(part) for part in (start, tracked, reference))
        return Memory(read_only(matrices), read_only(lag), sizes, *arrays, step=step)

    def tables_along(self, step: float, signal: SwitchingSignal, steps: int) -> Tables | None:
        if not self.is_linear:
            return None
        return Tables(
            self.law.digital(step, signal, steps), self.memory(step, signal, steps, steps)
        )

    def beginning_at(self, memory: Float[np.ndarray, " w"]) -> OutputFeedback:
        first = memory[: self.observer.plant.states]
        return OutputFeedback(self.law, self.observer, servo=self.servo, estimate=first)

    def _push(self, table: Feedback) -> np.ndarray:
        """How the law's input answers the sum of errors, on average over a mode's rows."""
        n, modes = self.observer.plant.states, self.plant.modes
        F = table.state_gain[:, :, n : n + (self.servo.sums if self.servo else 0)]
        if table.context in ("mode", "mode_age"):
            return F.reshape(modes, table.ages, *F.shape[1:]).mean(axis=1)
        return np.tile(F.mean(axis=0), (modes, 1, 1))

    def online(
        self, step: float, signal: SwitchingSignal | None = None, steps: int | None = None
    ) -> OutputUpdate:
        inner = self.law.online(step, signal, steps)
        observer = RunningObserver(self.memory(step, signal, steps))
        return OutputUpdate(inner, observer, self.reference, step)


class OutputUpdate(UpdateWithEstimates):
    """An `OutputFeedback` that runs: from y_k, the past inputs, mode and age to u_k."""

    def __init__(
        self, inner: Update, observer: RunningObserver, reference: Reference | None, step: float
    ) -> None:
        self._inner, self._observer = inner, observer
        self._reference, self._step = reference, step
        self.estimates: list[np.ndarray] = []

    def __call__(self, y: np.ndarray, past: np.ndarray, mode: int, age: int) -> np.ndarray:
        observer, k = self._observer, len(self.estimates)
        if k == 0:
            observer.begin(past)
        r = None if self._reference is None else self._reference(k * self._step)
        self.estimates.append(observer.update(past[-1], y, mode, r).copy())
        u = self._inner(self.estimates[-1], past, max(mode, 0), age)
        observer.asked[:] = u  # less the input applied, it shows where the sum must stop
        return u


def _with_delays(observer: Observer, plant: SwitchedSystem) -> SwitchedSystem:
    """The observer's model; the one model for all modes has delays between those of the modes."""
    mine, low, high = observer.plant, plant.delays.min(axis=0), plant.delays.max(axis=0)
    if observer.reads_mode or mine.delays.shape[1] != low.size:
        return mine
    between = ((low <= mine.delays) & (mine.delays <= high)).all()
    return mine.like(mine.A, mine.B, plant.delays) if between else mine  # `_same` refuses others


def _same(name: str, mine: SwitchedSystem, whose: str, other: SwitchedSystem) -> None:
    """Refuse models that do not fit each other."""
    for size in ("modes", "states", "inputs", "delay_data"):
        a, b = getattr(mine, size), getattr(other, size)
        if a != b:
            size = size.removesuffix("_data")
            raise ArgumentError(
                f"{name} must be made for {whose}, with {size} = {b}, got {size} = {a}."
            )
