"""The paper's law: the average of the modes' exact predictor feedbacks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import real_array, require_probabilities, require_shape
from deadtime.feedback import Feedback
from deadtime.feedback.law import Law, check_dwell_time
from deadtime.feedback.prediction_rows import extended_gains
from deadtime.gains.state_feedback import check_gains
from deadtime.laws.constant_forecast import ConstantForecast, Future
from deadtime.plant import SwitchedSystem


@dataclass(frozen=True, eq=False, init=False, repr=False)
class AveragedPredictor(ConstantForecast):
    r"""Average of exact predictor feedbacks: the mode is constant and unknown.

    .. math::

        u(t) = \sum_i w_i K_i P_i(t),
        \quad P_i(t) = e^{A_i D} x(t) + \int_{t-D}^{t} e^{A_i (t - \theta)} B_i u(\theta) \, d\theta

    With a dwell time :math:`\tau_d` the current mode is held for the rest of it:
    :math:`P_i` is then the state at :math:`t + D` of the model that stays in :math:`\sigma(t)` for
    max(0, :math:`\tau_d` − age) seconds and then in mode i.

    Parameters
    ----------
    plant : SwitchedSystem
        The law's model.
    gains : array_like, shape (modes, m, n)
        :math:`K_i` of :math:`u = +K_i x`.
    weights : array_like, shape (modes,), optional
        Probability :math:`w_i` of each mode, at least 0, summing to 1; equal by default.
    dwell_time : float, optional
        :math:`\tau_d` > 0, seconds: the least time that the plant stays in a mode.
    allow_unstable : bool
        Accept gains that leave some :math:`A_i + B_i K_i` unstable.

    Raises
    ------
    ArgumentError
        If the gains do not fit the plant or the weights are not probabilities.

    References
    ----------
    arXiv 2503.08446, equations (2), (3); (3) prints :math:`e^{A(t-s)}` where
    :math:`e^{A(t-\theta)}` is meant. The dwell time: arXiv 2506.03908.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> law = dt.AveragedPredictor(problem.plant, problem.gains)
    >>> law.digital(0.01).state_gain.round(3)
    array([[[-109.874,  -89.816]]])
    """

    plant: SwitchedSystem
    gains: Float[np.ndarray, "mode m n"]
    weights: Float[np.ndarray, " mode"]
    dwell_time: float | None
    allow_unstable: bool
    tuned: bool

    def __init__(
        self,
        plant: SwitchedSystem,
        gains: ArrayLike,
        weights: ArrayLike | None = None,
        dwell_time: float | None = None,
        *,
        allow_unstable: bool = False,
    ) -> None:
        modes = plant.modes
        gains = check_gains(plant, gains, allow_unstable)
        given = np.full(modes, 1.0 / modes) if weights is None else weights
        weights = real_array("weights", given, "(modes,)", 1)
        require_shape("weights", weights, (modes,), "(modes,)")
        require_probabilities("weights", weights)
        vars(self).update(
            plant=plant,
            gains=gains,
            weights=weights,
            dwell_time=check_dwell_time(dwell_time),
            allow_unstable=allow_unstable,
            tuned=False,
        )

    @classmethod
    def minimax(
        cls,
        plant: SwitchedSystem,
        gains: ArrayLike,
        step: float = 0.01,
        *,
        common_gain: bool = False,
        dwell_time: float | None = None,
        allow_unstable: bool = False,
    ) -> AveragedPredictor:
        r"""The averaged law whose weights minimise the growth rate of the worst constant mode.

        .. math::

            \min_w \max_i g_i(w)

        over the weights :math:`w` and, on request, over one gain for all modes with
        :math:`|K| \le 2 \max_i |K_i|`; :math:`g_i` is ``growth_rate(plant, law, i, step)``. The
        weights alone improve the worst mode and change little on signals that switch. A common gain
        helps if the averaged loop is unstable in some mode, and costs performance otherwise.

        Parameters
        ----------
        plant, gains, dwell_time, allow_unstable
            As for the law itself.
        step : float
            Sampling period at which growth is measured, in seconds.
        common_gain : bool
            Replace the gains by one K for all modes; the search starts at :math:`\sum_i w_i K_i`.

        Raises
        ------
        InfeasibleError
            If no common gain was found that leaves every :math:`A_i + B_i K` stable.

        Returns
        -------
        AveragedPredictor
            With these weights and gains.

        Examples
        --------
        >>> import deadtime as dt
        >>> plant = dt.problems.paper().plant
        >>> gains = dt.place(plant, [-1, -2])
        >>> law = dt.AveragedPredictor.minimax(plant, gains, step=0.05)
        >>> law.label, law.weights.round(2)
        ('averaged, minimax', array([0.42, 0.58]))
        """
        from deadtime.laws.minimax import minimax

        def tables(K: np.ndarray, weights: np.ndarray, period: float, /) -> Feedback:
            return cls(plant, K, weights, allow_unstable=True).digital(period)

        weights, gains, _ = minimax(tables, plant, gains, step, common_gain, allow_unstable)
        law = cls(plant, gains, weights, dwell_time, allow_unstable=allow_unstable)
        vars(law).update(tuned=True)  # for its label only
        return law

    @property
    def label(self) -> str:
        notes = ["minimax"] * self.tuned + ["dwell-aware"] * (self.dwell_time is not None)
        return ", ".join(["averaged", *notes])

    @property
    def _future(self) -> Future:
        return self.plant, self.gains, self.weights

    def extend(self, plant: SwitchedSystem, rows: Float[np.ndarray, "future r n"]) -> Law:
        gains = extended_gains(self.gains, rows)
        return AveragedPredictor(plant, gains, self.weights, self.dwell_time, allow_unstable=True)
