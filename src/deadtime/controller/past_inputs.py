"""The past inputs of a controller, multiplied by rows of its table."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jaxtyping import Float

from deadtime.feedback import Factor, Feedback

FEW = 32  # taps up to which a dense row is as quick as a factorised one


class DensePast:
    """The last N inputs in a ring; a row is one sum over all of them."""

    arrays = ("ring", "place")

    def __init__(self, table: Feedback) -> None:
        taps, m = table.input_gain.shape[1:3]
        self.table = table
        self.ring = np.zeros((2 * taps, m))
        self.place = np.zeros(3, np.int64)
        self.G = np.ascontiguousarray(table.oldest_first)

    def clear(self) -> None:
        """Set all inputs to 0."""
        for name in self.arrays:
            getattr(self, name)[...] = 0

    def push(self, u: Float[np.ndarray, " m"]) -> None:
        """Add u as the latest input."""
        from deadtime.controller.past_input_sums import push

        push(u, self.place, self.ring)

    @property
    def recent(self) -> Float[np.ndarray, "N m"]:
        """The last N inputs, the oldest first; a view that changes."""
        return self.ring[self.place[0] :][: self.table.taps]

    def row(self, row: int, x: Float[np.ndarray, " n"], u: Float[np.ndarray, " m"]) -> None:
        """Write the command of a row into u."""
        from deadtime.controller.past_input_sums import dense_row

        dense_row(self.table.state_gain[row], self.G[row], x, self.place, self.ring, u)

    def mean(
        self,
        share: Float[np.ndarray, " row"],
        x: Float[np.ndarray, " n"],
        u: Float[np.ndarray, " m"],
    ) -> None:
        """Write into u the mean of the rows' commands by their weights."""
        from deadtime.controller.past_input_sums import mean_of_dense

        mean_of_dense(self.table.state_gain, self.G, share, x, self.place, self.ring, u)

    def snapshot(self) -> dict[str, Any]:
        """Copies of the state."""
        return {name: getattr(self, name).copy() for name in self.arrays}

    def load(self, saved: dict[str, Any]) -> None:
        """Restore a `snapshot`."""
        for name in self.arrays:
            getattr(self, name)[...] = saved[name]


class FactoredPast(DensePast):
    """The last N inputs in a ring, with block sums for a factorised table of many taps."""

    arrays = ("ring", "place", "power", "sums", "partial")

    def __init__(self, table: Feedback, factor: Factor) -> None:
        taps, m = table.taps, table.input_gain.shape[2]
        self.table, self.factor = table, factor
        self.ring = np.zeros((2 * taps, m))
        self.place = np.zeros(3, np.int64)
        q, self.window = len(factor.S), taps - 1
        # Half a window: then it covers parts of three blocks at most.
        block = math.ceil(self.window / 2)
        self.steps = np.empty((block, q, m))
        column = factor.input
        for i in range(block):
            self.steps[i] = column
            column = factor.S @ column
        self.whole = np.linalg.matrix_power(factor.S, block)
        self.power = np.eye(q)
        self.sums = np.zeros((2, q))
        self.partial = np.zeros((2, block + 1, q))
        self.spare, self.q = np.zeros((q, q)), np.zeros(q)

    def clear(self) -> None:
        super().clear()
        np.fill_diagonal(self.power, 1.0)

    def push(self, u: Float[np.ndarray, " m"]) -> None:
        from deadtime.controller.past_input_sums import accumulate

        super().push(u)
        fixed, sums = (self.factor.S, self.steps), (self.power, self.sums, self.partial)
        accumulate(u, self.place, self.ring, *fixed, *sums, self.spare)

    def row(self, row: int, x: Float[np.ndarray, " n"], u: Float[np.ndarray, " m"]) -> None:
        from deadtime.controller.past_input_sums import factored_row

        self._sum_window()
        F, H, last = self.table.state_gain[row], self.factor.H[row], self.factor.last[row]
        factored_row(F, H, last, x, self.q, self.place, self.ring, u)

    def mean(
        self,
        share: Float[np.ndarray, " row"],
        x: Float[np.ndarray, " n"],
        u: Float[np.ndarray, " m"],
    ) -> None:
        from deadtime.controller.past_input_sums import mean_of_factored

        self._sum_window()
        F, H, last = self.table.state_gain, self.factor.H, self.factor.last
        mean_of_factored(F, H, last, share, x, self.q, self.place, self.ring, u)

    def _sum_window(self) -> None:
        """Compute q, which all rows multiply."""
        from deadtime.controller.past_input_sums import window_sum

        sums = self.power, self.sums, self.partial
        window_sum(self.window, self.place, self.whole, *sums, self.spare, self.q)


def past_inputs(table: Feedback) -> DensePast:
    """The faster of the two for a table."""
    if table.factor is None or table.taps <= FEW:
        return DensePast(table)
    return FactoredPast(table, table.factor)
