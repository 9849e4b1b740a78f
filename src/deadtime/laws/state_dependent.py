"""Exact predictor feedback of a plant whose mode is a function of its state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.errors import ArgumentError, ChatteringError
from deadtime.feedback import Feedback
from deadtime.forecast import Forecast
from deadtime.laws.base import Law, Update, checked_gains
from deadtime.plant import SwitchedSystem
from deadtime.steps import TOLERANCE
from deadtime.switching import SwitchingSignal
from deadtime.switching.rules import Rule, as_rule


@dataclass(frozen=True, eq=False, init=False, repr=False)
class StateDependentPredictor(Law):
    """Exact predictor feedback where the state decides the mode, σ = r(x): the rule run forward.

        u(t) = K_σ(t+D) P(t),    P(t) = x(t + D) of the model under its rule, from x(t) and the
                                 inputs in the pipe; σ(t + D) = r(P(t))

    The state decides the future, so there is nothing to guess: with the right model and rule it
    is exact, as the oracle is, and knows no signal. Between crossings the model moves by its
    matrix exponentials. A crossing at exactly t + D counts. It is the one law that is no table:
    not linear in the state, it runs its model once a period.

    Parameters
    ----------
    plant : SwitchedSystem
        The law's model.
    gains : array_like, shape (modes, m, n)
        K_i of u = +K_i x.
    rule : HalfSpace, Polyhedra or callable
        r, from a state of shape (n,) to a mode. A function is asked at samples, see
        `deadtime.switching.FunctionRule`; half-spaces and polyhedra miss no crossing.
    allow_unstable : bool
        Accept gains that leave some A_i + B_i K_i unstable.

    Raises
    ------
    ArgumentError
        If the gains or the rule do not fit the plant.
    ChatteringError
        By the function that `online` returns, if the prediction meets a boundary at which both
        modes point, so that it cannot go on. `simulate` ends the run there and says so.

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
        gains = checked_gains(plant, gains, allow_unstable)
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
            "step must be given for StateDependentPredictor: it has no closed form when updated "
            "continuously; a short step comes close."
        )

    def online(
        self, step: float, signal: SwitchingSignal | None = None, steps: int | None = None
    ) -> Update:
        window = self.window(step)
        # A switch within 1e-9 h after an instant counts as at it: the last length looks ahead.
        lengths = window.phase, window.step, TOLERANCE * window.step
        motion = self.rule.motion(self.plant, lengths)
        kinds = np.array([0] + [1] * (window.count - 1))

        def control(x: np.ndarray, past: np.ndarray, mode: int, age: int) -> np.ndarray:
            if not np.isfinite(x).all():
                return np.full(past.shape[1], np.nan)
            arrival = motion.follow(kinds, past[-window.count :], x)
            if arrival.chatter is not None:
                raise ChatteringError(
                    "chattering in the prediction of StateDependentPredictor, "
                    f"{arrival.chatter.time:.6g} s ahead: {arrival.chatter.reason}."
                )
            final = motion.advance(2, arrival.x, arrival.place, past[-1]).place
            return self.gains[motion.mode_of(final)] @ arrival.x

        return control
