"""Exact predictor feedback of a plant whose mode is a function of its state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.errors import ArgumentError
from deadtime.feedback import Feedback, Forecast, Law
from deadtime.feedback.law import Update
from deadtime.gains.state_feedback import check_gains
from deadtime.laws.first_reads import RuleForecast, chattering_ahead
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.plant.discretisation import TOLERANCE
from deadtime.switching import Rule, SwitchingSignal
from deadtime.switching.rules.motion import Beside, Motion
from deadtime.switching.rules.rule import as_rule


@dataclass(frozen=True, eq=False, init=False, repr=False)
class StateDependentPredictor(Law):
    r"""Exact predictor feedback where the state decides the mode: the rule run forward.

    .. math::

        u(t) = K_{\sigma(t+D)} P(t), \quad \sigma(t + D) = r(P(t)),

    with :math:`P(t) = x(t + D)` of the model under its rule, from :math:`x(t)` and the inputs in
    flight.

    The state decides the future: with the right model and rule the law is exact, as the oracle is,
    without a known signal. Between crossings the model moves by its
    matrix exponentials; where both modes point at their boundary it slides along it, and there
    takes the gain of the mode beyond if that leads on, otherwise of the one it came from. A
    crossing at exactly t + D counts. Where inputs or modes have delays of their own, t + D is,
    input by input, when the plant first reads what is sent at t.

    It is the one law that is no table: not linear in the state, it runs its model once a period.
    The sampled mode tells it on which side of a boundary x is. Updated continuously (`step=None`)
    its loop is known where model and plant are the same: from D on, :math:`x` follows
    :math:`(A_\sigma + B_\sigma K_\sigma) x` under the rule, and, where an input's delay differs
    between modes, a delay equation.

    Parameters
    ----------
    plant : SwitchedSystem
        The law's model.
    gains : array_like, shape (modes, m, n)
        :math:`K_i` of :math:`u = +K_i x`.
    rule : HalfSpace, Polyhedra, QuadraticRegions or callable
        r, from a state of shape (n,) to a mode. A function is asked at samples, see
        `deadtime.switching.FunctionRule`; the others miss no crossing.
    allow_unstable : bool
        Accept gains that leave some :math:`A_i + B_i K_i` unstable.

    Raises
    ------
    ArgumentError
        If the gains or the rule do not fit the plant.
    ChatteringError
        By the function that `online` returns, if the prediction cannot go on: crossings pile up,
        or a rule that is a function does not say along what to slide. `simulate` ends the run there
        and says so.

    References
    ----------
    arXiv 2603.20027.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> rule = dt.HalfSpace([1.0, 1.0], offset=0.5)
    >>> law = dt.StateDependentPredictor(problem.plant, problem.gains, rule)
    >>> run = dt.simulate(problem.plant, law, rule, [-1, 1], horizon=5)
    >>> run.signal.switches, bool(abs(run.mismatch).max() < 1e-9)
    (2, True)
    """

    plant: SwitchedSystem
    gains: Float[np.ndarray, "mode m n"]
    rule: Rule
    allow_unstable: bool

    def __init__(
        self,
        plant: SwitchedSystem,
        gains: ArrayLike,
        rule: Rule | Callable[[np.ndarray], int],
        *,
        allow_unstable: bool = False,
    ) -> None:
        gains = check_gains(plant, gains, allow_unstable)
        rule = as_rule("rule", rule).require(plant)
        vars(self).update(plant=plant, gains=gains, rule=rule, allow_unstable=allow_unstable)

    @property
    def label(self) -> str:
        return "state-dependent"

    def digital(
        self, step: float, signal: SwitchingSignal | None = None, steps: int | None = None
    ) -> Feedback:
        raise ArgumentError(
            "StateDependentPredictor has no table: its input is not linear in the state; "
            "`simulate` runs it period by period, and law.online(step) is a function to do so."
        )

    def ideal(self, signal: SwitchingSignal, horizon: float) -> Forecast:
        raise ArgumentError(
            "step must be given for StateDependentPredictor where the plant follows a signal: its "
            "ideal loop is known where the state switches the plant, by the rule of the law."
        )

    def online(
        self, step: float, signal: SwitchingSignal | None = None, steps: int | None = None
    ) -> Update:
        sampled = self.sampled_plant(step)
        if self.plant.has_one_delay:
            predict = self._to_the_delay(sampled)
        else:
            predict = RuleForecast.of(sampled.cut_alike(), self.gains, self.rule)

        def control(x: np.ndarray, past: np.ndarray, mode: int, age: int) -> np.ndarray:
            if not np.isfinite(x).all():
                return np.full(past.shape[1], np.nan)  # the loop then holds the last input
            return predict(x, past, mode)

        return control

    def _to_the_delay(
        self, sampled: SampledPlant
    ) -> Callable[[np.ndarray, np.ndarray, int], np.ndarray]:
        """u_k of x_k, the past inputs and the mode, of a model with one delay."""
        ahead = sampled.ahead
        # A switch within 1e-9 h after an instant counts as at it: hence the last length.
        lengths = *ahead.length.tolist(), TOLERANCE * sampled.step
        motion = self.rule.motion(self.plant, lengths)
        inputs = np.arange(self.plant.inputs)

        def predict(x: np.ndarray, past: np.ndarray, mode: int) -> np.ndarray:
            arrival = motion.follow(ahead.kind, past[-ahead.lag, inputs], x, mode)
            if arrival.chatter is not None:
                raise chattering_ahead(arrival.chatter.time, arrival.chatter.reason)
            final = arrival
            if final.beside is None:
                final = motion.advance(ahead.length.size, arrival.x, arrival.place, past[-1])
            place = final_place(motion, self.gains, arrival.x, final.place, final.beside)
            return self.gains[motion.mode_of(place)] @ arrival.x

        return predict


def final_place(
    motion: Motion,
    gains: Float[np.ndarray, "mode m n"],
    x: Float[np.ndarray, " n"],
    place: int,
    beside: Beside | None,
) -> int:
    """The place whose mode's gain the feedback takes at the end of a prediction.

    On a boundary that the state slides along it is the one beyond, if its own gain leads on there.
    """
    if beside is None:
        return place
    there = gains[motion.mode_of(beside.place)] @ x
    return beside.place if motion.leads_on(x, beside, there) else place
