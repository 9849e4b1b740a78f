"""Forecast: what a law believes in continuous time, the ideal loop's twin of `Feedback`.

A law updated continuously is a sum over branches, each a future of the switching signal,

    u(t) = Σ_b K_b(t) P_b(t),

where P_b(t) is the state at t + D of the law's model if it starts from x(t), takes the inputs
in the pipe, and follows the branch. A branch follows the path first, up to the time `until`,
then stays in its own system for ever. So a law that forecasts no switching has until = −∞, the
oracle follows its signal throughout, and a law with D = 0 predicts nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True, eq=False)
class Forecast:
    """A law's belief as branches (immutable).

    Attributes
    ----------
    A : (systems, n, n), B : (systems, n, m)
        The model's modes, and fictitious systems after them.
    lead : float
        How far the law predicts, seconds: the model's delay, or 0.
    branches : (branches,) int
        The system in which each branch ends.
    breaks : (count,)
        Times at which the path switches or `until` jumps.
    gains : callable
        From times (T,) to K_b, shape (T, branches, m, n).
    path : callable
        From times (T,) to the system that a branch follows there, while it follows the path.
    until : callable
        From times t (T,) to the time up to which a forecast made at t follows the path.
    """

    A: Float[np.ndarray, "system n n"]
    B: Float[np.ndarray, "system n m"]
    lead: float
    branches: Int[np.ndarray, " branch"]
    breaks: Float[np.ndarray, " break"]
    gains: Callable[[np.ndarray], np.ndarray]
    path: Callable[[np.ndarray], np.ndarray]
    until: Callable[[np.ndarray], np.ndarray]

    @classmethod
    def frozen(
        cls,
        A: Float[np.ndarray, "system n n"],
        B: Float[np.ndarray, "system n m"],
        K: Float[np.ndarray, "system m n"],
        lead: float,
    ) -> Forecast:
        """One branch per system, each for ever, with the (weighted) gain of that system."""
        return cls(
            A,
            B,
            lead,
            np.arange(A.shape[0]),
            np.empty(0),
            lambda times: np.broadcast_to(K, (times.size, *K.shape)),
            lambda times: np.zeros(times.size, np.int64),
            lambda times: np.full(times.size, -np.inf),
        )
