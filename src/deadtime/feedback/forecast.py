"""Forecast: what a law believes in continuous time, the ideal loop's twin of `Feedback`.

A law updated continuously is a sum over branches, each a future of the switching signal,

    u(t) = Σ_b K_b(t) P_b(t),

where P_b(t) is the state at t + D of the law's model if it starts from x(t), takes the inputs
in flight, and follows the branch. (A law may predict more than the state: its systems then
have q ≥ n states and start from L x(t), L the `lift`.) A branch follows the path first, up to
the time `until`, then holds its own system. The path is the signal itself for a law
that foresees it, and otherwise the mode in which the forecast is made. So a law that forecasts
no switching has until = −∞, a dwell-aware one the end of the guaranteed dwell, the oracle
foresees its signal throughout, and a law with D = 0 predicts nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from deadtime.plant import SwitchedSystem
from deadtime.switching import SwitchingSignal


@dataclass(frozen=True, eq=False)
class Forecast:
    """A law's belief as branches (immutable).

    Attributes
    ----------
    A : (systems, q, q), B : (systems, q, m)
        The model's modes, and fictitious systems after them.
    lead : float
        How far the law predicts, seconds: the model's delay, or 0.
    branches : (branches,) int
        The system in which each branch ends.
    breaks : (count,)
        Times at which the path switches or `until` jumps.
    gains : callable
        From times (T,) to K_b, shape (T, branches, m, q).
    path : callable
        From times (T,) to the system that is active there.
    until : callable
        From times t (T,) to the time up to which a forecast made at t follows the path.
    foresees : bool
        Whether the path at a later time is the system active then, or the one active now.
    lift : (q, n) or None
        L; None for systems in the plant's own states.
    """

    A: Float[np.ndarray, "system q q"]
    B: Float[np.ndarray, "system q m"]
    lead: float
    branches: Int[np.ndarray, " branch"]
    breaks: Float[np.ndarray, " break"]
    gains: Callable[[np.ndarray], np.ndarray]
    path: Callable[[np.ndarray], np.ndarray]
    until: Callable[[np.ndarray], np.ndarray]
    foresees: bool = False
    lift: Float[np.ndarray, "q n"] | None = None

    @classmethod
    def constant(
        cls,
        A: Float[np.ndarray, "system n n"],
        B: Float[np.ndarray, "system n m"],
        K: Float[np.ndarray, "system m n"],
        lead: float,
    ) -> Forecast:
        """The forecast of constant modes: a branch per system, with its (weighted) gain."""
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

    @classmethod
    def dwelling(
        cls,
        plant: SwitchedSystem,
        after: tuple[np.ndarray, np.ndarray, np.ndarray],
        dwell_time: float,
        signal: SwitchingSignal,
    ) -> Forecast:
        """The forecast that the mode is held for its dwell time, then the systems `after`.

        `after` are the A, B and (weighted) K of these systems, as in `constant`.
        """
        A, B, K = after
        return cls(
            np.concatenate((plant.A, A)),
            np.concatenate((plant.B, B)),
            plant.delay,
            plant.modes + np.arange(A.shape[0]),
            signal.last_switch(signal.times) + dwell_time,
            lambda times: np.broadcast_to(K, (times.size, *K.shape)),
            signal,
            lambda times: signal.last_switch(times) + dwell_time,
        )
