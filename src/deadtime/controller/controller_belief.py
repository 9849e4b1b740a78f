"""The belief of a controller whose law reads no mode, but how likely each is."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from deadtime.controller.past_inputs import DensePast
from deadtime.feedback import Feedback
from deadtime.feedback.bank import BankForm
from deadtime.feedback.belief import Belief
from deadtime.loop.running_belief import running_belief


class ModeBelief:
    """A mode filter that runs on the inputs as applied, and its shares of the rows of a table.

    Attributes
    ----------
    running : deadtime.loop.running_belief.RunningBelief
    form, bank : Belief, BankForm or None
        The filter as data; `bank` where it is told outputs.
    """

    def __init__(self, form: Belief | BankForm, table: Feedback) -> None:
        self.running = running_belief(form, len(table.state_gain))
        self._gains, (_, m, n) = table.state_gain, table.state_gain.shape
        self.form, self.bank = self.running.form, self.running.bank
        # In period k the model reads u_{k−N}, so at sample k + 1 one input more than a law does.
        self._count = int(self.running.form.lag.max()) + 1
        self._ring = np.zeros((2 * self._count, m))
        self._place, self._zero = np.zeros(3, np.int64), np.zeros(n)

    def begin(self) -> None:
        """Start anew; the inputs before are pushed afterwards."""
        self.running.begin()
        self._ring[:], self._place[:] = 0.0, 0

    def push(self, u: Float[np.ndarray, " m"]) -> None:
        """u, as applied, becomes the latest input."""
        from deadtime.controller.past_input_sums import push

        push(u, self._place, self._ring)

    @property
    def inputs(self) -> Float[np.ndarray, "lag m"]:
        """The last inputs as applied, the oldest first; a view that changes."""
        return self._ring[self._place[0] :][: self._count]

    def see(self, x: Float[np.ndarray, " n_or_p"]) -> None:
        """One sample; what is not finite is missing."""
        self.running.see(x, self._ring, int(self._place[0]) + self._count - 1)

    def ask(self, past: DensePast, x: np.ndarray, u: Float[np.ndarray, " m"]) -> None:
        """Write into u the mean of the rows' inputs."""
        running, share = self.running, self.running.share()
        if self.bank is None:
            past.mean(share, x, u)
            return
        past.mean(share, self._zero, u)
        u += np.einsum("c,cma,ca->m", share, self._gains, running.states(len(self._gains)))

    def known(self, rows: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The share of every row, the state that it is given, and the covariance of that."""
        running = self.running
        return running.share().copy(), running.states(rows), running.covariances(rows)

    def snapshot(self) -> dict[str, Any]:
        """Copies of everything that changes."""
        own = {"belief_inputs": self._ring.copy(), "belief_place": self._place.copy()}
        return self.running.snapshot() | own

    def load(self, saved: dict[str, Any], begun: bool) -> None:
        """The opposite of `snapshot`; `ArgumentError` where the belief is none."""
        self.running.load(saved)
        self.running.begun = begun
        self._ring[:], self._place[:] = saved["belief_inputs"], saved["belief_place"]
