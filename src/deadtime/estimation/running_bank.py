"""A bank of Kalman filters, one per mode, and the belief over the modes: what `OutputModeFilter`
runs.

A period begins in mode i and ends in j. With x̂_i, P_i the mean and covariance of x_{k−1} given i,

    x̄_ij = M x̂_i + the inputs,    P̄_ij = M P_i Mᵀ + (Δ P_i Δᵀ + d dᵀ)/12 + Q_ij,

Q_ij what noise adds, M = Φ_i and Δ = d = 0 where modes change at samples; where they change
anywhere M is the mean of Φ_i and Φ_j, Δ their difference and d that of their predictions, and P̄_ij
has the variance about the line of these as well. Each pair is corrected by y_k with C_j, the
density of y_k weighs it, and what ends in the same mode is merged into one normal density.
(docs/theory/mode-filter.md; signs and lags are those of `deadtime.feedback.belief`; the steps are
`estimation/bank_kernel.py`.)
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from deadtime.feedback.bank import BankForm, BankState
from deadtime.feedback.belief import BeliefState


class RunningBank:
    """A bank that runs: `begin` at the first sample, then `advance` once a period.

    Attributes
    ----------
    x : (modes, n)
        E[x_k | the mode is i, all that was seen], as of the last sample; a view that changes.
    P : (modes, n, n)
        The covariance about it.
    state : BeliefState
        The belief, in `state.now`.
    """

    def __init__(self, form: BankForm, rows: int) -> None:
        self.form, self.all = form, BankState.of(form, rows)

    @property
    def x(self) -> Float[np.ndarray, "mode n"]:
        return self.all.x

    @property
    def P(self) -> Float[np.ndarray, "mode n n"]:
        return self.all.P

    @property
    def state(self) -> BeliefState:
        return self.all.chain

    @property
    def mean(self) -> Float[np.ndarray, " n"]:
        """x̂_k, whatever the mode."""
        return self.state.now.sum(axis=1) @ self.x

    def begin(self, y: Float[np.ndarray, " p"]) -> None:
        """The first sample: what y_0 says of x_0, and of the mode where C depends on it."""
        from deadtime.estimation.bank_kernel import begin_bank

        begin_bank(self.form, self.all, np.array(y, float))

    def advance(
        self, y: Float[np.ndarray, " p"], told: Float[np.ndarray, "past m"], row: int
    ) -> None:
        """One period: y_k at its end, and the inputs, u_{k−1} in row `row` of `told`."""
        from deadtime.estimation.bank_kernel import advance_bank

        advance_bank(self.form, self.all, np.array(y, float), told, row)
