"""The interface of laws: a model of the plant, gains, and for all but one a table at any period."""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import wraps
from types import FunctionType, NoneType
from typing import Any

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import brief, instance, positive
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.feedback.belief import BeliefFilter
from deadtime.feedback.ideal_form import Forecast, Functional
from deadtime.feedback.memory import Tables
from deadtime.feedback.preview import Preview
from deadtime.feedback.table import Feedback, Known
from deadtime.plant import SampledPlant, SwitchedSystem, Window
from deadtime.switching import SwitchingSignal

MOST_BYTES = 1e9  # of a table: more is mostly a mistake of units

# From x_k, the past inputs (the latest last), the sampled mode and its age in samples to u_k. It is
# called at every sample. At a lost sample x is NaN; if the result is NaN, the last input is held.
Update = Callable[[np.ndarray, np.ndarray, int, int], np.ndarray]


class UpdateWithEstimates(ABC):
    """An `Update` with a state: it reads the measurement, NaN included, and estimates the state.

    Attributes
    ----------
    estimates : list of arrays
        Its estimate of the state of the law's model at every call.
    """

    estimates: list[np.ndarray]

    @abstractmethod
    def __call__(self, y: np.ndarray, past: np.ndarray, mode: int, age: int) -> np.ndarray:
        """u_k; a mode below 0 is not known."""


# Laws may be written by users: what their methods must return is checked at every call.
_ANSWERS = {
    "digital": (Feedback,),
    "ideal": (Functional, Forecast),
    "online": (Callable,),
    "preview": (Preview, NoneType),
}


def _answering(name: str, method: FunctionType, kinds: tuple[type, ...]) -> Callable[..., Any]:
    """The method of a law, with a check of the type that it returns."""

    @wraps(method)
    def checked(self: Law, *args: Any, **options: Any) -> Any:
        answer = method(self, *args, **options)
        if not isinstance(answer, kinds):
            wanted = " or ".join(kind.__name__.replace("NoneType", "None") for kind in kinds)
            raise ArgumentError(
                f"{type(self).__name__}.{name} must return a {wanted}, got "
                f"{brief(answer)}, a {type(answer).__name__}."
            )
        if isinstance(answer, Feedback):
            _require_fit(self, answer)
        return answer

    return checked


def _require_fit(law: Law, table: Feedback) -> None:
    """Refuse a table whose sizes or rows do not fit the law's model."""
    plant, (rows, m, n) = law.plant, table.state_gain.shape
    name, inputs = f"{type(law).__name__}.digital", m - table.memory
    alone = law.is_linear and law.observer is None
    if alone and (inputs, n) != (plant.inputs, plant.states):
        raise ArgumentError(
            f"{name} must return gains of shape (rows, m, n) = (rows, {plant.inputs}, "
            f"{plant.states}), got {table.state_gain.shape}."
        )
    wanted = {"none": 1, "mode": plant.modes, "mode_age": plant.modes * table.ages, "step": rows}
    if wanted.get(table.context) != rows:
        raise ArgumentError(
            f"{name} must return {wanted.get(table.context)} rows for the context "
            f"{table.context!r}, ages = {table.ages} and {plant.modes} modes, got {rows}."
        )


@dataclass(frozen=True, eq=False, repr=False)
class Law(Frozen, ABC):
    r"""A predictor-feedback law.

    Attributes
    ----------
    plant : SwitchedSystem
        The law's *model* of the plant, delay included.
    gains : (modes, m, n) array or None
        :math:`K_i` of :math:`u = +K_i x`, used for the mismatch; None where the law has no gain per
        mode.
    outputs : (modes, p, n) array or None
        :math:`C_i`, of a law that measures :math:`y = C_\sigma x`; None for the whole state.
    observer, servo, reference : Observer, Servo, Reference or None
        The parts of a law on estimated states or with tracked outputs; see `OutputFeedback`.
    filter : BeliefFilter or None
        The filter of a law that weights its rows by a belief; see `BeliefPredictor`.
    """

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        declared = vars(cls).get("__annotations__", {})
        taken = [one.name for one in fields(Law) if not one.init and one.name in declared]
        if taken and not cls.__module__.startswith("deadtime."):
            raise ArgumentError(
                f"{cls.__name__}.{taken[0]} must have another name: a law has {taken[0]} where it "
                "runs on estimates, else None."
            )
        for name, kinds in _ANSWERS.items():
            if isinstance(own := vars(cls).get(name), FunctionType):
                setattr(cls, name, _answering(name, own, kinds))

    plant: SwitchedSystem
    gains: Float[np.ndarray, "mode m n"] | None
    outputs: Float[np.ndarray, "mode p n"] | None = field(default=None, kw_only=True)
    observer: Any = field(default=None, init=False)
    servo: Any = field(default=None, init=False)
    filter: BeliefFilter | None = field(default=None, init=False)
    reference: Any = field(default=None, init=False)

    @property
    @abstractmethod
    def label(self) -> str:
        """A few words for legends and tables."""

    @property
    def row_law(self) -> Law:
        """The law whose rows it runs: the inner law of an observer or belief law, else itself."""
        return self

    @property
    def is_linear(self) -> bool:
        """Whether u is linear in measurements and the law's state, along any signal of modes."""
        return False

    @property
    def predicts(self) -> bool:
        """Whether it is predictor feedback; False for a baseline without prediction."""
        return True

    @property
    def why_not_run(self) -> str:
        """Why it has no table that can run in real time; empty if it has one."""
        if not self.is_linear:
            return f"{type(self).__name__} is no table"
        return f"{type(self).__name__} needs a preview of the signal" if self.needs_preview else ""

    @property
    def observer_alone_reads_mode(self) -> bool:
        """Whether only the observer, not the law's rows, needs the measured mode."""
        return False

    @property
    def needs_preview(self) -> bool:
        """Whether it must know how the mode will switch, and so cannot run in real time."""
        return False

    @property
    def previewed(self) -> SwitchingSignal | None:
        """The fixed signal of its preview; None if it uses the signal of the run."""
        return None

    @property
    def draws(self) -> bool:
        """Whether each run samples its initial estimate or its reference."""
        return False

    def drawn(self, seed: int) -> Law:
        """The law of the run with this seed, if runs sample (`draws`); else the law itself."""
        return self

    @abstractmethod
    def digital(
        self, step: float, signal: SwitchingSignal | None = None, steps: int | None = None
    ) -> Feedback:
        """The law's table at a sampling period.

        Parameters
        ----------
        step : float
            Sampling period h > 0, in seconds.
        signal, steps
            Read only by laws whose rows are indexed by the step: the future signal, and how
            many samples to make rows for.
        """

    def tables_along(self, step: float, signal: SwitchingSignal, steps: int) -> Tables | None:
        """The tables for a run along a signal; None for a law that is called at every sample."""
        return None

    def beginning_at(self, memory: Float[np.ndarray, " w"]) -> Law:
        """The law with no reference whose state before its first sample is w."""
        return self

    @abstractmethod
    def ideal(self, signal: SwitchingSignal, horizon: float) -> Functional | Forecast:
        """The law in continuous time, for a run on [0, horizon] along a signal.

        Raises `ArgumentError` for a law that has no such form.
        """

    @abstractmethod
    def online(
        self, step: float, signal: SwitchingSignal | None = None, steps: int | None = None
    ) -> Update | UpdateWithEstimates:
        """The law as a function that is called once per period.

        A law that measures outputs gives an `UpdateWithEstimates`, called with y in place of x.
        `signal` and `steps` as in `digital`. Raises `ArgumentError` if a law that needs the future
        signal does not get one.
        """

    def preview(
        self, step: float, signal: SwitchingSignal | None = None, steps: int | None = None
    ) -> Preview | None:
        """The preview of a law for a known signal; None for every other law.

        `signal` and `steps` as in `digital`.
        """
        return None

    def require_step(self, step: float) -> None:
        """Refuse a period that is not that of its observer or filter."""

    @property
    def horizons(self) -> Float[np.ndarray, "future m"]:
        """The prediction horizon of each input, seconds, by the system its forecast ends in."""
        return self.plant.delays

    def extend(self, plant: SwitchedSystem, rows: Float[np.ndarray, "future r n"]) -> Law:
        """The law with the same forecast for a larger plant, with gains `rows` for inputs after m.

        Its rows are the predictions of this law (`deadtime.feedback.prediction_rows`). Raises
        `ArgumentError` for a law without a prediction.
        """
        raise ArgumentError(
            f"law must predict for a prediction: {type(self).__name__} ({self.label}) has no "
            "forecast of its own. Make the controller of a law that has one, such as "
            "ExpectedPredictor or AveragedPredictor."
        )

    def spread(
        self, step: float, known: Known, W: Float[np.ndarray, "*mode n n"]
    ) -> Float[np.ndarray, "case input future n n"]:
        """The covariance of :math:`x(t_k + D_j)` in every row that may apply and every future.

        W is the intensity of white noise on dx/dt, one or one per mode. Raises `ArgumentError` for
        a law without a covariance.
        """
        raise ArgumentError(
            f"law must say how it is uncertain for a covariance: {type(self).__name__} "
            f"({self.label}) does not."
        )

    def __repr__(self) -> str:
        label = self.label if isinstance(self.label, str) else "its label is no text"
        return f"{type(self).__name__}({label}; model {self.plant!r})"

    def sampled_plant(self, step: float) -> SampledPlant:
        """The model at a sampling period."""
        return SampledPlant.of(self.plant, step)

    def window(self, step: float) -> Window:
        """The window of the model's delay at a sampling period."""
        return self.sampled_plant(step).window


@dataclass(frozen=True, eq=False, repr=False)
class TableLaw(Law):
    """A law that is a table of linear functionals, as all but the state-dependent law are."""

    @property
    def is_linear(self) -> bool:
        return True

    def tables_along(self, step: float, signal: SwitchingSignal, steps: int) -> Tables | None:
        preview = self.preview(step, signal, steps)
        feedback = None if preview else self.digital(step, signal, steps)
        return Tables(feedback, preview=preview)

    def online(
        self, step: float, signal: SwitchingSignal | None = None, steps: int | None = None
    ) -> Update:
        feedback = self.digital(step, signal, steps)
        taps, G = feedback.taps, feedback.oldest_first
        sample = itertools.count()

        def control(x: np.ndarray, past: np.ndarray, mode: int, age: int) -> np.ndarray:
            row = feedback.row(mode, age, next(sample))
            return feedback.state_gain[row] @ x + G[row] @ past[-taps:].ravel()

        return control


def require_input(asked: Any, inputs: int) -> Float[np.ndarray, " m"]:
    """The answer of an `Update` as an input vector; a number stands for a plant with one input."""
    if asked is None or (np.shape(asked) != (inputs,) and (np.ndim(asked) or inputs > 1)):
        raise ArgumentError(
            f"law.online(step) must make a function that returns u_k of shape (m,) = ({inputs},), "
            f"got {brief(asked)}."
        )
    return np.reshape(asked, inputs)


Digital = Callable[..., Feedback]


def cache_table(digital: Digital) -> Digital:
    """Keep the last table of a law whose table depends on the step only and takes long to fill."""

    @wraps(digital)
    def cached(
        self: Law, step: float, signal: SwitchingSignal | None = None, steps: int | None = None
    ) -> Feedback:
        table = vars(self).get("_table")
        if table is None or table.step != step:
            table = digital(self, step, signal, steps)
            vars(self)["_table"] = table
        return table

    return cached


def room(bytes_per_age: float, most_bytes: float = MOST_BYTES) -> int:
    """The largest number of ages that fits into `most_bytes`."""
    return int(most_bytes // bytes_per_age)


def require_room(name: str, ages: float, step: float, most: int) -> None:
    """Refuse a table with more ages than `most`."""
    if ages > most:
        raise ArgumentError(
            f"{name} needs a table of {ages:.3g} ages of {step:g} s, and there is room for "
            f"{most:,}: lengthen the step."
        )


def require_match(plant: SwitchedSystem, law: Law) -> None:
    """Refuse what is no plant or no law, and a law whose model has other sizes than the plant."""
    instance("plant", plant, SwitchedSystem)
    instance("law", law, Law)
    for name in ("modes", "states", "inputs"):
        mine, its = getattr(plant, name), getattr(law.plant, name)
        if mine != its:
            raise ArgumentError(
                f"law must be made for a plant with {mine} {name}, got a law for {its}: "
                "delay and matrices of the law's model may differ from the plant's, sizes not."
            )


def check_dwell_time(dwell_time: float | None) -> float | None:
    """A dwell time in seconds, or None for a law that assumes none."""
    return None if dwell_time is None else positive("dwell_time", dwell_time)
