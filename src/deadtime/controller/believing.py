"""The belief of a controller whose law reads no mode, but how likely each is."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.controller.past_inputs import DensePast
from deadtime.estimation import BeliefPredictor
from deadtime.estimation.filter_arguments import belief_of
from deadtime.feedback import Feedback
from deadtime.feedback.belief import BeliefState


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

    def __init__(self, law: BeliefPredictor, table: Feedback) -> None:
        self.form = law.belief_of(table)
        _, _, n, m = self.form.Gamma.shape
        self._state = BeliefState.of(self.form, len(table.state_gain), 1)
        self.now, self.weight = self._state.now, self._state.weight
        # In period k the model reads u_{k−N}, so at sample k + 1 one input more than a law does.
        self._count = int(self.form.lag.max()) + 1
        self._ring, self._place = np.zeros((2 * self._count, m)), np.zeros(3, np.int64)
        self._before, self._x = np.full((2, n), math.nan)

    def begin(self) -> None:
        """Start anew; the inputs before are pushed afterwards."""
        self.now[:] = self.form.start
        self._ring[:], self._place[:], self._before[:] = 0.0, 0, math.nan

    def push(self, u: Float[np.ndarray, " m"]) -> None:
        """u, as applied, becomes the latest input."""
        from deadtime.controller.kernel import push

        push(u, self._place, self._ring)

    @property
    def inputs(self) -> Float[np.ndarray, "lag m"]:
        """The last inputs as applied, the oldest first; a view that changes."""
        return self._ring[self._place[0] :][: self._count]

    def require(self, belief: ArrayLike) -> Float[np.ndarray, "mode age"]:
        """Probabilities that are given from elsewhere, or an error that says why they are none."""
        return belief_of("belief", belief, self.now)

    def see(self, x: Float[np.ndarray, " n"], begun: bool) -> None:
        """Follow the period that ended, once one has; an x that is not finite is missing."""
        from deadtime.estimation.belief_kernel import advance_belief

        self._x[:] = x  # rows of one array: a compiled step has one type to know
        if begun:
            row = int(self._place[0]) + self._count - 1
            advance_belief(self.form, self._state, self._before, self._x, self._ring, row)
        self._before[:] = self._x

    def ask(self, past: DensePast, x: Float[np.ndarray, " n"], u: Float[np.ndarray, " m"]) -> None:
        """Write into u the mean of the rows' inputs."""
        from deadtime.estimation.belief_kernel import share_rows

        share_rows(self._state)
        past.mean(self.weight, x, u)

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
