"""The paper's law: the average of the modes' exact predictor feedbacks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.checks import real_array, shaped
from deadtime.errors import ArgumentError
from deadtime.feedback import Feedback
from deadtime.forecast import Forecast
from deadtime.laws.base import TableLaw, checked_gains
from deadtime.plant import SwitchedSystem
from deadtime.switching import SwitchingSignal


@dataclass(frozen=True, eq=False, init=False, repr=False)
class AveragedPredictor(TableLaw):
    """Average of exact predictor feedbacks: the mode never changes, but which one is not known.

        u(t) = Σ_i w_i K_i P_i(t),    P_i(t) = e^{A_i D} x(t) + ∫_{t−D}^{t} e^{A_i(t−θ)} B_i u(θ) dθ

    Parameters
    ----------
    plant : SwitchedSystem
        The law's model.
    gains : array_like, shape (modes, m, n)
        K_i of u = +K_i x.
    weights : array_like, shape (modes,), optional
        Probability w_i of each mode, ≥ 0, summing to 1; equal by default.
    allow_unstable : bool
        Accept gains that leave some A_i + B_i K_i unstable.

    Raises
    ------
    ArgumentError
        If the gains do not fit the plant or the weights are not probabilities.

    References
    ----------
    arXiv 2503.08446, equations (2), (3); (3) prints e^{A(t−s)} where e^{A(t−θ)} is meant.

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
    allow_unstable: bool

    def __init__(
        self,
        plant: SwitchedSystem,
        gains: ArrayLike,
        weights: ArrayLike | None = None,
        *,
        allow_unstable: bool = False,
    ) -> None:
        modes = plant.modes
        gains = checked_gains(plant, gains, allow_unstable)
        given = np.full(modes, 1.0 / modes) if weights is None else weights
        weights = real_array("weights", given, "(modes,)", 1)
        shaped("weights", weights, (modes,), "(modes,)")
        if weights.min() < 0.0 or abs(weights.sum() - 1.0) > 1e-9:
            raise ArgumentError(
                f"weights must be ≥ 0 and sum to 1, got {weights.tolist()} with sum "
                f"{weights.sum():.10g}: divide them by their sum."
            )
        vars(self).update(plant=plant, gains=gains, weights=weights, allow_unstable=allow_unstable)

    @property
    def label(self) -> str:
        return "averaged"

    def digital(
        self, step: float, signal: SwitchingSignal | None = None, steps: int | None = None
    ) -> Feedback:
        from deadtime.laws.frozen import frozen_table

        plant = self.plant
        return frozen_table(plant.A, plant.B, self.gains, self.weights, self.window(step))

    def ideal(self, signal: SwitchingSignal, horizon: float) -> Forecast:
        plant = self.plant
        weighted = self.weights[:, None, None] * self.gains
        return Forecast.frozen(plant.A, plant.B, weighted, plant.delay)
