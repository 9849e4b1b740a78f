"""The past inputs of a controller, and what a row of the table makes of them."""

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
        """As if all inputs had been 0."""
        for name in self.arrays:
            getattr(self, name)[...] = 0

    def push(self, u: Float[np.ndarray, " m"]) -> None:
        """u becomes the latest input."""
        from deadtime.controller.past_input_sums import push

        push(u, self.place, self.ring)

    @property
    def recent(self) -> Float[np.ndarray, "N m"]:
        """The last N inputs, the oldest first; a view that changes."""
        return self.ring[self.place[0] :][: self.table.taps]

    def row(self, row: int, x: Float[np.ndarray, " n"], u: Float[np.ndarray, " m"]) -> None:
        """Write the input that the row asks for into u."""
        from deadtime.controller.past_input_sums import dense_row

        dense_row(self.table.state_gain[row], self.G[row], x, self.place, self.ring, u)

    def mean(
        self,
        share: Float[np.ndarray, " row"],
        x: Float[np.ndarray, " n"],
        u: Float[np.ndarray, " m"],
    ) -> None:
        """Write into u the inputs that the rows ask for, weighed by their shares."""
        from deadtime.controller.past_input_sums import mean_of_dense

        mean_of_dense(self.table.state_gain, self.G, share, x, self.place, self.ring, u)

    def snapshot(self) -> dict[str, Any]:
        """Copies of everything that changes."""
        return {name: getattr(self, name).copy() for name in self.arrays}

    def load(self, saved: dict[str, Any]) -> None:
        """The opposite of `snapshot`."""
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
        # Half a window, so that it never reaches into more than three blocks.
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
        accumulate(
            u,
            self.place,
            self.ring,
            self.factor.S,
            self.steps,
            self.power,
            self.sums,
            self.partial,
            self.spare,
        )

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
        """q, which all rows read."""
        from deadtime.controller.past_input_sums import window_sum

        window_sum(
            self.window,
            self.place,
            self.whole,
            self.power,
            self.sums,
            self.partial,
            self.spare,
            self.q,
        )


def past_inputs(table: Feedback) -> DensePast:
    """The quicker of the two for a table."""
    if table.factor is None or table.taps <= FEW:
        return DensePast(table)
    return FactoredPast(table, table.factor)
