"""A law with rows by mode, run on a belief over the modes in place of the mode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deadtime.base.checks import instance
from deadtime.base.errors import ArgumentError
from deadtime.feedback import Feedback, Forecast, Law
from deadtime.feedback.belief import BeliefFilter, UpdateWithBelief
from deadtime.feedback.law import Update, UpdateWithEstimates
from deadtime.feedback.memory import Tables
from deadtime.loop.running_belief import RunningBank, RunningBelief, running_belief
from deadtime.switching import SwitchingSignal


@dataclass(frozen=True, eq=False, init=False, repr=False)
class BeliefPredictor(Law):
    r"""A law whose rows are weighted by the probabilities of their modes; it reads no mode.

    .. math::

        u_k = \sum_c \pi_c \Big( F_c x_k + \sum_j G_{c,j} u_{k-j} \Big),
        \quad c \text{ a mode, or a mode and its age}

    For an `ExpectedPredictor` under the filter's switching model this is the expectation over all
    that is unknown, the present mode included; for other laws it is the mean of their rows. With an
    `OutputModeFilter` it measures :math:`y` in place of :math:`x`, and each row acts on
    :math:`E[x \mid \text{its mode}]`. Rows are linear, so the sum is the mean over mode and state;
    `run.estimates` is then E[x].

    Parameters
    ----------
    law : Law
        A law with a table by mode or by mode and age.
    filter : ModeFilter, OutputModeFilter or another BeliefFilter
        Its plant has the sizes of the law's model and its period is the loop's. Matrices and delays
        may differ from the law's model, but no delay may exceed the longest delay of the law.

    Raises
    ------
    ArgumentError
        If the law has no such table, or the sizes or delays of law and filter do not match;
        `digital` and `ideal` always raise it.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem, model = dt.problems.paper(), dt.Markov([[0, 1.25], [1.25, 0]])
    >>> law = dt.ExpectedPredictor(problem.plant, problem.gains, model)
    >>> on_belief = dt.BeliefPredictor(law, dt.ModeFilter(problem.plant, model, step=0.02))
    >>> signal = model.sample(10.0, seed=1)
    >>> run = dt.simulate(problem.plant, on_belief, signal, problem.x0, 10.0, step=0.02)
    >>> run.belief.shape, run.diverged, bool((run.belief.argmax(axis=0) == run.mode).mean() > 0.97)
    ((2, 501), False, True)
    """

    law: Law
    filter: BeliefFilter

    def __init__(self, law: Law, filter: BeliefFilter) -> None:
        instance("law", law, Law)
        if not isinstance(filter, BeliefFilter):
            raise ArgumentError(
                "filter must be a ModeFilter, an OutputModeFilter or another BeliefFilter, got "
                f"{type(filter).__name__}."
            )
        kind = type(law).__name__
        if law.observer is not None or law.why_not_run:
            why = law.why_not_run or f"{kind} is no table"
            raise ArgumentError(
                f"law must have a table of rows by mode, or by mode and age: {why}."
            )
        for size in ("modes", "states", "inputs"):
            mine, its = getattr(law.plant, size), getattr(filter.plant, size)
            if mine != its:
                raise ArgumentError(
                    f"filter must be of a plant with the law's {mine} {size}, got {its}: delay and "
                    "matrices of the two models may differ, sizes not."
                )
        table = law.digital(filter.step)
        if table.context not in ("mode", "mode_age"):
            raise ArgumentError(
                f"law must have rows by mode, or by mode and age: {kind} ({law.label}) does not "
                "read the mode. Run it as it is; no belief changes what it does."
            )
        longest = law.sampled_plant(filter.step).longest_lag
        if filter.longest_lag > longest:
            raise ArgumentError(
                f"filter must read inputs of the last {longest} periods, as the law does, got "
                f"{filter.longest_lag}: give the law's model the longer delay, too."
            )
        own = {"plant": law.plant, "gains": law.gains, "outputs": filter.outputs}
        vars(self).update(**own, law=law, filter=filter)

    @property
    def row_law(self) -> Law:
        return self.law

    @property
    def label(self) -> str:
        label = self.law.label
        name = "belief" if label == "expected" else f"{label} by belief"
        return name if self.outputs is None else f"{name}, observed"

    def digital(
        self, step: float, signal: SwitchingSignal | None = None, steps: int | None = None
    ) -> Feedback:
        raise ArgumentError(
            "BeliefPredictor has no table: a belief weights its rows, no mode selects one. Use its "
            ".law, which reads the mode."
        )

    def ideal(self, signal: SwitchingSignal, horizon: float) -> Forecast:
        raise ArgumentError(
            "step must be given for BeliefPredictor: its filter runs at samples, every "
            f"{self.filter.step:g} s."
        )

    def require_step(self, step: float) -> None:
        if step != self.filter.step:
            raise ArgumentError(
                f"step must be the filter's, {self.filter.step:g} s, got {step:g}: make the filter "
                "for the period of the loop."
            )

    def tables_along(self, step: float, signal: SwitchingSignal, steps: int) -> Tables | None:
        self.require_step(step)
        feedback = self.law.digital(step)
        form = self.filter.form(feedback.ages)
        return Tables(feedback, belief=form.chain, bank=form.bank)

    def online(
        self, step: float, signal: SwitchingSignal | None = None, steps: int | None = None
    ) -> Update | UpdateWithEstimates:
        self.require_step(step)
        feedback = self.law.digital(step)
        kind = BeliefUpdate if self.outputs is None else OutputBeliefUpdate
        running = running_belief(self.filter.form(feedback.ages), len(feedback.state_gain))
        return kind(feedback, running)


class BeliefUpdate(UpdateWithBelief):
    """A running `BeliefPredictor`: u_k from x_k, or y_k, and the past inputs, without the mode."""

    def __init__(self, feedback: Feedback, running: RunningBelief) -> None:
        self._feedback, self._oldest_first = feedback, feedback.oldest_first
        self._running = running
        self.beliefs: list[np.ndarray] = []

    def __call__(self, x: np.ndarray, past: np.ndarray, mode: int, age: int) -> np.ndarray:
        running, feedback = self._running, self._feedback
        running.see(x, past, len(past) - 1)  # first: the belief at t_k weights the rows of t_k
        self.beliefs.append(running.by_mode)
        u = running.share() @ (self._oldest_first @ past[-feedback.taps :].ravel())
        running.add_states(feedback.state_gain, u)  # of a bank, each row on its own E[x | mode]
        return u


class OutputBeliefUpdate(BeliefUpdate, UpdateWithEstimates):
    """A `BeliefUpdate` on outputs that keeps its estimates."""

    _running: RunningBank

    def __init__(self, feedback: Feedback, running: RunningBelief) -> None:
        super().__init__(feedback, running)
        self.estimates: list[np.ndarray] = []

    def __call__(self, y: np.ndarray, past: np.ndarray, mode: int, age: int) -> np.ndarray:
        u = super().__call__(y, past, mode, age)
        self.estimates.append(self._running.mean)
        return u
