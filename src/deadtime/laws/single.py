"""The exact predictor feedback of one mode, used in every mode of the plant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import index
from deadtime.feedback.law import Law
from deadtime.feedback.prediction_rows import extended_gains
from deadtime.feedback.table import Known
from deadtime.gains.state_feedback import check_gains
from deadtime.laws.constant_forecast import ConstantForecast, Future
from deadtime.plant import SwitchedSystem


@dataclass(frozen=True, eq=False, init=False, repr=False)
class SingleModePredictor(ConstantForecast):
    r"""Exact predictor feedback of mode i, forecasting that this mode is held.

    .. math::

        u(t) = K_i P_i(t),
        \quad P_i(t) = e^{A_i D} x(t) + \int_{t-D}^{t} e^{A_i (t - \theta)} B_i u(\theta) \, d\theta

    Parameters
    ----------
    plant : SwitchedSystem
        The law's model.
    gains : array_like, shape (modes, m, n)
        :math:`K_i` of :math:`u = +K_i x`.
    mode : int
        The mode i that the law assumes, counted from 0.
    allow_unstable : bool
        Accept gains that leave some :math:`A_i + B_i K_i` unstable.

    References
    ----------
    arXiv 2503.08446, equation (79), the law of Figures 4 and 5.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> dt.SingleModePredictor(problem.plant, problem.gains, mode=1).digital(0.01)
    Feedback(context='none', rows=1, taps=100, inputs=1, step=0.01, factored)
    """

    plant: SwitchedSystem
    gains: Float[np.ndarray, "mode m n"]
    mode: int
    allow_unstable: bool

    def __init__(
        self, plant: SwitchedSystem, gains: ArrayLike, mode: int, *, allow_unstable: bool = False
    ) -> None:
        mode = index("mode", mode, plant.modes)
        gains = check_gains(plant, gains, allow_unstable)
        vars(self).update(plant=plant, gains=gains, mode=mode, allow_unstable=allow_unstable)

    @property
    def label(self) -> str:
        return f"mode {self.mode} only"

    @property
    def _future(self) -> Future:
        return self.plant.only([self.mode]), self.gains[[self.mode]], np.ones(1)

    def extend(self, plant: SwitchedSystem, rows: Float[np.ndarray, "future r n"]) -> Law:
        gains = extended_gains(self.gains, rows)
        return SingleModePredictor(plant, gains, self.mode, allow_unstable=True)

    def spread(
        self, step: float, known: Known, W: Float[np.ndarray, "*mode n n"]
    ) -> Float[np.ndarray, "case input future n n"]:
        from deadtime.laws.spread import held_spread

        return held_spread(self.plant, known, W)  # of every mode, as `horizons` has them
