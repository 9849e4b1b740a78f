"""A running table law, one period per call: `Controller` without its exports."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import count, instance, positive
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Stateful
from deadtime.controller.controller_arguments import (
    Clock,
    RestValues,
    Status,
    limits_of,
    require_state,
    vector,
)
from deadtime.controller.controller_state import ModeBelief, Observing
from deadtime.controller.past_inputs import past_inputs
from deadtime.feedback import Law
from deadtime.feedback.prediction_rows import PredictionTable, prediction_table
from deadtime.feedback.table import age_after
from deadtime.simulation.initial_input import InitialInput, held_samples
from deadtime.switching import SwitchingSignal

if TYPE_CHECKING:
    from deadtime.plant import OperatingPoint


class RunningLaw(Stateful):
    """A running law: call `update` once per period; see `Controller` for its arguments.

    `measured` is the number of states, or outputs, that are measured at a sample, and `inner` is
    the law whose table it runs.
    """

    def __init__(
        self,
        law: Law,
        step: float,
        *,
        limits: tuple[ArrayLike, ArrayLike] | None = None,
        u0: InitialInput = None,
        mode_age: int = 0,
        operating_point: OperatingPoint | None = None,
    ) -> None:
        instance("law", law, Law)
        if law.row_law.why_not_run:
            raise ArgumentError(
                f"law must be a table that a controller can run; {law.row_law.why_not_run}."
            )
        self.law, self.inner, self.step = law, law.row_law, positive("step", step)
        tables = law.tables_along(self.step, SwitchingSignal.constant(0), 1)
        assert tables is not None
        assert tables.feedback is not None
        form, memory = tables.bank or tables.belief, tables.memory
        self.table = tables.feedback
        self.observing = None if memory is None else Observing(memory, law.reference)
        self.mode_belief = None if form is None else ModeBelief(form, self.table)
        tracked = None if self.observing is None else self.observing.memory.tracked
        self.operating_point, size = operating_point, self.table.state_gain.shape[2]
        self.rest = RestValues.of(law, size, tracked, operating_point)
        self.limits = limits_of(limits, law.plant.inputs)
        self.low, self.high = (limit - self.rest.u for limit in self.limits)
        self._past = past_inputs(self.table)
        self._reads_row = self.table.context != "none" and self.mode_belief is None
        self.reads_mode = self._reads_row or bool(self.observing and self.observing.reads_mode)
        self.measured = law.plant.states if law.outputs is None else law.outputs.shape[1]
        self._clock, self._nothing = Clock(self.step), np.full(self.measured, np.nan)
        self._u, self._latest, self._command = np.zeros((3, law.plant.inputs))
        self._x = np.empty(self.measured)  # of the last sample, for predictions
        self.reset(u0, mode_age)

    def reset(self, u0: InitialInput = None, mode_age: int = 0) -> None:
        """Start after the inputs u0, as `simulate` takes them; None: at rest."""
        m, taps = self.law.plant.inputs, self.table.taps
        history = held_samples(u0, m, taps, self.step, self.law.plant.longest_delay)
        if u0 is not None:
            history = history - self.rest.u
        self._age, self._mode = count("mode_age", mode_age, 0), -1
        self._past.clear()
        if self.mode_belief:
            self.mode_belief.begin()
        # The first call pushes the last one, or the input that was applied instead.
        for u in history[:-1]:
            self._push(u)
        self._u[:] = history[-1]
        if self.observing:
            self.observing.begin(history)
        self._clock.reset()
        self._x[:] = np.nan
        self.status, self.refused, self.late, self.samples = Status.OK, 0, 0, 0

    def update(
        self,
        x: ArrayLike,
        mode: int | None = None,
        applied: ArrayLike | None = None,
        out: Float[np.ndarray, " m"] | None = None,
        reference: ArrayLike | None = None,
        time: float | None = None,
        belief: ArrayLike | None = None,
    ) -> Float[np.ndarray, " m"]:
        """The input of this period, u_k.

        Parameters
        ----------
        x : array_like, shape (n,) or (p,)
            The state at t_k; of a law that measures outputs, y.
        mode : int, optional
            The mode at t_k; laws whose rows depend on it need it. A `BeliefPredictor` does not
            read it.
        applied : array_like, shape (m,), optional
            The input applied in the period that ends, if it differs from the last return value.
        out : (m,) float array, optional
            Receives the input; by default a new array does.
        reference : array_like, shape (tracked,), optional
            r at t_k, of a law with a servo; by default the law's own.
        time : float, optional
            When this sample was taken, seconds on any clock that only goes forward; by default the
            next period. Jitter below half a period is ignored. A second call for a period is
            refused. In periods without a call the input counts as held, or as `applied`; `late`
            counts them. A time more than 100,000 periods later is refused as out of order: it is of
            another clock.
        belief : array_like, shape (modes,) or (modes, ages), optional
            For a `BeliefPredictor`: a belief at t_k from another source, which replaces the
            filter's own; a call out of order ignores it. Over modes alone, each mode keeps the
            shares of its ages.

        Returns
        -------
        (m,) array
            If x or `applied` is not finite or the mode is not valid, the call is refused: the last
            input is held, `status` says why and `refused` counts. If y is not finite, the observer
            or the filter of a law on outputs predicts without it, and u is new.

        Raises
        ------
        ArgumentError
            If a shape is wrong, the mode is missing where the law reads it, or `belief` is not ≥ 0
            with sum 1; nothing is changed then.
        """
        x = vector("x" if self.law.outputs is None else "y", x, self.measured)
        applied = None if applied is None else vector("applied", applied, self._u.size)
        # Checks that may raise come first: an error leaves the controller unchanged.
        self._require(mode, reference)
        x = x - self.rest.given
        applied = None if applied is None else applied - self.rest.u
        reference = None if reference is None else reference - self.rest.reference
        given_belief = None
        if belief is not None:
            if self.mode_belief is None:
                raise ArgumentError(
                    f"belief needs a BeliefPredictor; {self.law.label} reads the mode: leave it "
                    "out."
                )
            given_belief = self.mode_belief.running.require(belief)
        periods = self._clock.periods(time)
        if not periods:
            self.status, self.refused = Status.OUT_OF_ORDER, self.refused + 1
            return self._answer(out)
        # Missed periods come first: past inputs are pushed in the order of time.
        self._skip(applied, periods - 1)
        self._x[:] = x
        status = self._record(applied)
        # A refused mode outranks an applied input that is not finite.
        status = self._update_mode(mode) or status
        if self.mode_belief:
            self._update_belief(x, given_belief)
        if self.observing:
            status = self._command_from_outputs(x, reference, status)
        else:
            usable = bool(np.isfinite(x).all())
            if not status and (usable or (self.mode_belief and self.mode_belief.running.usable(x))):
                status = self._compute(x)
            if status <= Status.SATURATED and not usable:
                status = Status.BAD_STATE
        self.refused += status > Status.SATURATED
        self.late += periods - 1
        self.samples += 1
        self.status = Status.LATE if periods > 1 and status <= Status.SATURATED else status
        return self._answer(out)

    def _answer(self, out: Float[np.ndarray, " m"] | None) -> Float[np.ndarray, " m"]:
        u = self._u + self.rest.u
        if out is None:
            return u
        out[:] = u
        return out

    def _require(self, mode: int | None, reference: ArrayLike | None) -> None:
        """Refuse missing or misshapen arguments before anything changes."""
        if self.reads_mode and mode is None:
            readers = ["the rows of this law"] * self._reads_row
            other = "a `BeliefPredictor` tells it from x or y"
            if self.observing and self.observing.reads_mode:
                readers.append("the observer")
                other += '; an observer designed with model="mean" reads none'
            verb = "depends" if readers == ["the observer"] else "depend"
            raise ArgumentError(
                f"mode must be given: {' and '.join(readers)} {verb} on it. It is one of 0 to "
                f"{self.law.plant.modes - 1}; where nothing measures it, {other}."
            )
        if reference is None:
            return
        if self.observing is None:
            raise ArgumentError("reference needs a law with a servo; this one tracks nothing.")
        self.observing.require(reference)

    def _skip(self, applied: Float[np.ndarray, " m"] | None, missed: int) -> None:
        """Periods without a call: observer and belief predict over each of them."""
        follows = self.observing is not None or self.mode_belief is not None
        # Without a state beside the past inputs, periods beyond those inputs change nothing.
        for _ in range(missed if follows else min(missed, self.table.taps)):
            self._record(applied)
            if self.mode_belief:
                self._update_belief(self._nothing, None)
            if self.observing:
                self.observing.update(self._latest, self._nothing, self._mode, None, self.samples)
                self.observing.set_command(self._u)
            self.samples += follows
        self.samples += 0 if follows else missed
        self._age = min(self._age + missed, self.table.ages)

    def _record(self, applied: Float[np.ndarray, " m"] | None) -> Status:
        """Add the input of the period that ends to the past inputs."""
        u = self._u if applied is None else applied
        finite = bool(np.isfinite(u).all())
        self._latest[:] = u if finite else self._u
        self._push(self._latest)
        return Status.OK if finite else Status.BAD_APPLIED

    def _push(self, u: Float[np.ndarray, " m"]) -> None:
        self._past.push(u)
        if self.mode_belief:
            self.mode_belief.push(u)

    def _update_belief(
        self, x: Float[np.ndarray, " n"], given_belief: Float[np.ndarray, "mode age"] | None
    ) -> None:
        """Update the belief by x, or replace it by the one that was passed."""
        assert self.mode_belief is not None
        self.mode_belief.update(x)
        if given_belief is not None:
            self.mode_belief.running.now[:] = given_belief

    def _update_mode(self, mode: int | None) -> Status:
        """Update mode and age by the mode at this sample."""
        if not self.reads_mode:
            return Status.OK
        number = int(mode) if isinstance(mode, (int, np.integer)) else -1
        number = number if 0 <= number < self.law.plant.modes else -1
        # The age first: it is counted from the mode of the sample before.
        self._age = min(age_after(self._mode, self._age, number), self.table.ages)
        if number < 0:
            return Status.BAD_MODE
        self._mode = number
        return Status.OK

    def _command_from_outputs(
        self, y: np.ndarray, reference: ArrayLike | None, status: Status
    ) -> Status:
        """Update the observer; then u_k from its estimate, unless an argument was refused."""
        observing = self.observing
        assert observing is not None
        known = -1 if status == Status.BAD_MODE else self._mode
        z, bad_y, bad_reference = observing.update(self._latest, y, known, reference, self.samples)
        if not status:
            status = self._compute(z)
            if status != Status.OVERFLOW:
                if bad_y or bad_reference:
                    status = Status.BAD_STATE if bad_y else Status.BAD_REFERENCE
                observing.set_command(self._command)
                return status
        # The held input counts as the command, so that anti-windup sees no saturation.
        observing.set_command(self._u)
        return status

    def _compute(self, x: np.ndarray) -> Status:
        """Compute and saturate u_k; hold the last one if it is not finite."""
        if self.mode_belief:
            self.mode_belief.command(self._past, x, self._command)
        else:
            row = self.table.row(self._mode, self._age) if self._reads_row else 0
            self._past.row(row, x, self._command)
        if not np.isfinite(self._command).all():
            return Status.OVERFLOW
        np.clip(self._command, self.low, self.high, out=self._u)
        return Status.OK if (self._u == self._command).all() else Status.SATURATED

    @property
    def belief(self) -> Float[np.ndarray, " mode"] | None:
        """The probability of each mode at the last sample; None for a law without a belief."""
        return None if self.mode_belief is None else self.mode_belief.running.by_mode

    @cached_property
    def prediction_table(self) -> PredictionTable:
        """The rows of `prediction`."""
        return prediction_table(self.inner, self.step)

    @property
    def state(self) -> dict[str, Any]:
        """Copies of the state on which the next periods depend, for `restore`."""
        return {
            "law": self.law.label,
            "step": self.step,
            "taps": self.table.taps,
            "mode": self._mode,
            "age": self._age,
            "samples": self.samples,
            "refused": self.refused,
            "late": self.late,
            "clock": self._clock.state.copy(),
            "input": self._u.copy(),
            **self._past.snapshot(),
            **(self.observing.snapshot() if self.observing else {}),
            **(self.mode_belief.snapshot() if self.mode_belief else {}),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a `state`: the following inputs are the same to the last bit.

        Raises `ArgumentError` for a state of another law or step.
        """
        require_state(state, self.state, self.law.plant.modes)
        if self.mode_belief:
            # First, since it raises on an invalid belief: a refused state changes nothing.
            self.mode_belief.load(state, int(state["samples"]) > 0)
        self._past.load(state)
        if self.observing:
            self.observing.load(state)
        self._x[:] = np.nan
        self._mode, self._age = int(state["mode"]), int(state["age"])
        self.samples, self.refused = int(state["samples"]), int(state["refused"])
        self.late, self._clock.state[:] = int(state["late"]), state["clock"]
        self._u[:] = state["input"]
        self.status = Status.OK

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.law.label}; step={self.step:g}, {self.table!r})"
