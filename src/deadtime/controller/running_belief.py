"""The belief of a controller whose law reads no mode, but how likely each is."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.errors import ArgumentError
from deadtime.controller.past_inputs import DensePast
from deadtime.estimation import BeliefPredictor, OutputModeFilter
from deadtime.estimation.filter_arguments import belief_of
from deadtime.feedback import Feedback
from deadtime.feedback.bank import BankForm, BankState
from deadtime.feedback.belief import Belief, BeliefState


class ModeBelief:
    """A mode filter that runs on the inputs as applied, and its shares of the rows of a table.

    Attributes
    ----------
    form : Belief
        The filter as data.
    now : (modes, ages)
        The belief at the last sample; a view that changes.
    weight : (rows,)
        The share of every row of the table; a view that changes.
    """

    def __init__(self, form: Belief, rows: int) -> None:
        self.form = form
        _, _, n, m = form.Gamma.shape
        self._state = BeliefState.of(form, rows, 1)
        self.now, self.weight = self._state.now, self._state.weight
        # In period k the model reads u_{k−N}, so at sample k + 1 one input more than a law does.
        self._count = int(form.lag.max()) + 1
        self._ring, self._place = np.zeros((2 * self._count, m)), np.zeros(3, np.int64)
        self._before, self._x = np.full((2, n), math.nan)

    def begin(self) -> None:
        """Start anew; the inputs before are pushed afterwards."""
        self.now[:] = self.form.start
        self._ring[:], self._place[:], self._before[:] = 0.0, 0, math.nan

    def push(self, u: Float[np.ndarray, " m"]) -> None:
        """u, as applied, becomes the latest input."""
        from deadtime.controller.past_input_sums import push

        push(u, self._place, self._ring)

    @property
    def inputs(self) -> Float[np.ndarray, "lag m"]:
        """The last inputs as applied, the oldest first; a view that changes."""
        return self._ring[self._place[0] :][: self._count]

    @property
    def latest(self) -> int:
        """The row of the ring that the latest input is in, the older ones before it."""
        return int(self._place[0]) + self._count - 1

    def require(self, belief: ArrayLike) -> Float[np.ndarray, "mode age"]:
        """Probabilities that are given from elsewhere, or an error that says why they are none."""
        return belief_of("belief", belief, self.now)

    def see(self, x: Float[np.ndarray, " n"], begun: bool) -> None:
        """Follow the period that ended, once one has; an x that is not finite is missing."""
        from deadtime.estimation.belief_kernel import advance_belief

        self._x[:] = x  # rows of one array: a compiled step has one type to know
        if begun:
            advance_belief(self.form, self._state, self._before, self._x, self._ring, self.latest)
        self._before[:] = self._x

    def usable(self, x: Float[np.ndarray, " n"]) -> bool:
        """Whether the law has an answer where this is seen."""
        return bool(np.isfinite(x).all())

    def ask(self, past: DensePast, x: Float[np.ndarray, " n"], u: Float[np.ndarray, " m"]) -> None:
        """Write into u the mean of the rows' inputs."""
        from deadtime.estimation.belief_kernel import share_rows

        share_rows(self._state)
        past.mean(self.weight, x, u)

    def known(self, rows: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The share of every row, the state that it is given, and the covariance of that."""
        from deadtime.estimation.belief_kernel import share_rows

        share_rows(self._state)
        n = self._before.size
        return self.weight.copy(), np.tile(self._before, (rows, 1)), np.zeros((rows, n, n))

    def snapshot(self) -> dict[str, Any]:
        """Copies of everything that changes."""
        return {
            "belief": self.now.copy(),
            "belief_x": self._before.copy(),
            "belief_inputs": self._ring.copy(),
            "belief_place": self._place.copy(),
        }

    def load(self, saved: dict[str, Any]) -> None:
        """The opposite of `snapshot`; `ArgumentError` where the belief is none."""
        belief_of("state['belief']", saved["belief"], self.now)
        self.now[:] = saved["belief"]  # not divided by its sum: to the last bit
        self._before[:] = saved["belief_x"]
        self._ring[:], self._place[:] = saved["belief_inputs"], saved["belief_place"]


class OutputBelief(ModeBelief):
    """The same from outputs: a bank of Kalman filters, each row on the estimate of its mode.

    Attributes
    ----------
    bank : BankForm
    """

    def __init__(self, bank: BankForm, gains: Float[np.ndarray, "row m n"]) -> None:
        super().__init__(bank.chain, len(gains))
        self.bank, self._gains = bank, gains
        self._all = BankState.of(bank, len(gains))._replace(chain=self._state)
        self._zero, self._y = np.zeros(gains.shape[2]), np.empty(bank.variance.size)

    def begin(self) -> None:
        super().begin()
        self._all.x[:], self._all.P[:] = self.bank.estimate, self.bank.covariance

    def see(self, x: Float[np.ndarray, " p"], begun: bool) -> None:
        """Follow the period that ended, once one has; outputs that are not finite are missing."""
        from deadtime.estimation.bank_kernel import advance_bank, begin_bank

        self._y[:] = x
        if begun:
            advance_bank(self.bank, self._all, self._y, self._ring, self.latest)
        else:
            begin_bank(self.bank, self._all, self._y)

    def usable(self, x: Float[np.ndarray, " p"]) -> bool:
        return True  # over an output that is missing the filters predict

    def ask(self, past: DensePast, x: Float[np.ndarray, " p"], u: Float[np.ndarray, " m"]) -> None:
        super().ask(past, self._zero, u)
        estimates = np.repeat(self._all.x, len(self._gains) // len(self._all.x), axis=0)
        u += np.einsum("c,cma,ca->m", self.weight, self._gains, estimates)

    def known(self, rows: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        share, _, _ = super().known(rows)
        each = rows // len(self._all.x)
        return share, np.repeat(self._all.x, each, axis=0), np.repeat(self._all.P, each, axis=0)

    def snapshot(self) -> dict[str, Any]:
        own = {"belief_estimates": self._all.x.copy(), "belief_covariances": self._all.P.copy()}
        return super().snapshot() | own

    def load(self, saved: dict[str, Any]) -> None:
        P = np.asarray(saved["belief_covariances"], float)
        variance = np.diagonal(P, axis1=1, axis2=2)
        if (P.swapaxes(1, 2) != P).any() or variance.min() < 0.0:
            raise ArgumentError(
                "state['belief_covariances'] must be symmetric, their diagonals ≥ 0: pass what "
                "`Controller.state` gave."
            )
        super().load(saved)
        self._all.x[:], self._all.P[:] = saved["belief_estimates"], P


def believing_of(law: BeliefPredictor, table: Feedback) -> ModeBelief:
    """What a controller of a law on a belief keeps of it."""
    if isinstance(law.filter, OutputModeFilter):
        return OutputBelief(law.filter.bank(table.ages), table.state_gain)
    return ModeBelief(law.belief_of(table), len(table.state_gain))
