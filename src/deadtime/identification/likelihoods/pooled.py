"""What a period is like within which the mode changes: one model for all modes.

No unknown is in it, so that such periods tell where a switch was and nothing of the plant, as where
modes are logged.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.identification.log.recording import Part
from deadtime.identification.regression import log_density
from deadtime.identification.transition import plain_transitions
from deadtime.identification.uneven import node_rows


class PooledRegression(NamedTuple):
    """Of even rows a regression, in the cells that its inputs have, (m,).

    constant : whether its last column is a constant term's
    """

    P: Float[np.ndarray, "n r"]
    S: Float[np.ndarray, "n n"]
    cells: Int[np.ndarray, " m"]
    constant: bool

    def density(self, part: Part, k: Int[np.ndarray, " period"]) -> Float[np.ndarray, " period"]:
        """The log density of periods k of a part."""
        return log_density(cell_rows(part, k, self.cells, self.constant), self.P, self.S)


class PooledPlant(NamedTuple):
    """Of uneven rows a plant of one mode: A, B (with a constant term as its last column), delays.

    S : what a period of `step` adds
    """

    A: Float[np.ndarray, "n n"]
    B: Float[np.ndarray, "n acting"]
    delays: Float[np.ndarray, " m"]
    S: Float[np.ndarray, "n n"]
    nodes: Float[np.ndarray, " node"]
    step: float

    def density(self, part: Part, k: Int[np.ndarray, " period"]) -> Float[np.ndarray, " period"]:
        """The log density of periods k of a part."""
        n, m, count = len(self.A), self.delays.size, self.nodes.size
        constant = self.B.shape[1] > m
        z = node_rows(part, k, self.delays, self.nodes, self.step, constant)
        Phi, W = plain_transitions(self.A[None], self.nodes)
        flat = (np.moveaxis(one[0], 0, 1).reshape(n, -1) for one in (Phi, W @ self.B))
        P = np.hstack((*flat, np.zeros((n, count * m))))
        return log_density(z, P, self.S)


Pooled = PooledRegression | PooledPlant


def cell_rows(
    part: Part, k: Int[np.ndarray, " period"], cells: Int[np.ndarray, " m"], constant: bool
) -> Float[np.ndarray, "period z"]:
    """z = (x_{k+1}, x_k, u_{k−N}, u_{k−N+1}), N the cell of each input; and 1 for a constant."""
    column = np.arange(cells.size)
    read = [part.input[np.maximum(k[:, None] - lag, 0), column] for lag in (cells, cells - 1)]
    ones = np.ones((k.size, int(constant)))
    return np.hstack((part.output[k + 1], part.output[k], *read, ones))
