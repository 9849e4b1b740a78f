"""Outlook: a law's belief as branches, where the inputs or modes of its model have several delays.

It is the twin of `Forecast` for several delays. Along each branch, a signal that is followed for
sure, u is the exact feedback: what is sent at t is first read at

    t + θ_j,   θ_j = min {θ ≥ 0: θ ≥ D_i,j},   i the branch's system at t + θ,

and the branch's part of u_j(t) is K_i,j x̂(t + θ_j), x̂ predicted from x(t) under the inputs in
flight and, from where an input is read that is still to be sent, under its own feedback K x̂.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deadtime.feedback.functional import Functional
from deadtime.plant import SwitchedSystem
from deadtime.switching import SwitchingSignal


@dataclass(frozen=True, eq=False)
class Outlook:
    """A law's belief as branches (immutable).

    Attributes
    ----------
    A : (systems, n, n), B : (systems, n, m), delays : (systems, m)
        The model's modes, and systems that may follow after them.
    gains : (branches, systems, m, n)
        K_i of every branch.
    weights : (branches,)
        By which the branches are added up.
    breaks : (count,)
        Times at which what is believed changes.
    signals : callable
        From a time t to what the branches believe at it: start times, increasing, and the system
        from there on, both (branches, parts); the first part has begun at t, and the last has no
        end.
    settled : Functional
        The same law once the last mode of the signal has lasted.
    """

    A: Float[np.ndarray, "system n n"]
    B: Float[np.ndarray, "system n m"]
    delays: Float[np.ndarray, "system m"]
    gains: Float[np.ndarray, "branch system m n"]
    weights: Float[np.ndarray, " branch"]
    breaks: Float[np.ndarray, " break"]
    signals: Callable[[float], tuple[np.ndarray, np.ndarray]]
    settled: Functional

    @classmethod
    def foreseeing(
        cls,
        plant: SwitchedSystem,
        K: Float[np.ndarray, "mode m n"],
        signal: SwitchingSignal,
        settled: Functional,
    ) -> Outlook:
        """The belief in a signal that is known."""
        starts, modes, longest = signal.times, signal.modes, plant.longest_delay

        def signals(t: float) -> tuple[np.ndarray, np.ndarray]:
            first = int(np.searchsorted(starts, t, "right")) - 1
            last = int(np.searchsorted(starts, t + 2.0 * longest, "right"))
            part = slice(max(first, 0), max(last, 1))
            return starts[None, part].copy(), modes[None, part].astype(np.int64)

        systems = plant.A, plant.B, plant.delays
        return cls(*systems, K[None], np.ones(1), starts[1:], signals, settled)

    @classmethod
    def dwelling(
        cls,
        plant: SwitchedSystem,
        after: SwitchedSystem,
        K: Float[np.ndarray, "system m n"],
        weights: Float[np.ndarray, " system"],
        dwell_time: float,
        signal: SwitchingSignal,
        settled: Functional,
    ) -> Outlook:
        """The belief that the mode is held for its dwell time, then each system of `after`.

        `K` and `weights` are those of these systems; a branch has the gain of its last throughout.
        """
        modes, branches = plant.modes, after.modes
        follows = modes + np.arange(branches)

        def signals(t: float) -> tuple[np.ndarray, np.ndarray]:
            now = np.array([t])
            until = float(signal.last_switch(now)[0]) + dwell_time
            starts = np.tile([min(t, until) - 1.0, until], (branches, 1))
            here = np.full(branches, int(signal(now)[0]))
            return starts, np.stack((here, follows), axis=1)

        return cls(
            np.concatenate((plant.A, after.A)),
            np.concatenate((plant.B, after.B)),
            np.concatenate((plant.delays, after.delays)),
            np.repeat(K[:, None], modes + branches, axis=1),
            weights,
            np.append(signal.times[1:], signal.last_switch(signal.times) + dwell_time),
            signals,
            settled,
        )
