"""The baseline: state feedback that ignores the delay."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.feedback import Feedback, Functional
from deadtime.feedback.law import TableLaw
from deadtime.gains.state_feedback import check_gains
from deadtime.plant import SwitchedSystem
from deadtime.switching import SwitchingSignal


@dataclass(frozen=True, eq=False, init=False, repr=False)
class DelayedStateFeedback(TableLaw):
    r"""State feedback :math:`u(t) = K_{\sigma(t)} x(t)` that ignores the delay.

    The law that every predictor is measured against; with a long delay it fails.

    Parameters
    ----------
    plant : SwitchedSystem
        The law's model; only its sizes and delay matter here.
    gains : array_like, shape (modes, m, n)
        :math:`K_i` of :math:`u = +K_i x`.
    allow_unstable : bool
        Accept gains that leave some :math:`A_i + B_i K_i` unstable.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> dt.DelayedStateFeedback(problem.plant, problem.gains).digital(0.01)
    Feedback(context='mode', rows=2, taps=100, inputs=1, step=0.01, dense)
    """

    plant: SwitchedSystem
    gains: Float[np.ndarray, "mode m n"]
    allow_unstable: bool

    def __init__(
        self, plant: SwitchedSystem, gains: ArrayLike, *, allow_unstable: bool = False
    ) -> None:
        gains = check_gains(plant, gains, allow_unstable)
        vars(self).update(plant=plant, gains=gains, allow_unstable=allow_unstable)

    @property
    def predicts(self) -> bool:
        return False

    @property
    def label(self) -> str:
        return "delay ignored"

    def digital(
        self, step: float, signal: SwitchingSignal | None = None, steps: int | None = None
    ) -> Feedback:
        sampled = self.sampled_plant(step)
        modes, m, _ = self.gains.shape
        taps = np.zeros((modes, sampled.longest_lag, m, m))
        return Feedback(self.gains, taps, "mode", sampled.step)

    def ideal(self, signal: SwitchingSignal, horizon: float) -> Functional:
        return Functional.of_state(self.gains, signal)
