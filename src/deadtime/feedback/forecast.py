"""Forecast: a law's belief as branches, signals that its model may follow, in the ideal loop.

Along each branch, a signal that is followed for sure, u is the exact feedback: what is sent at t is
first read at

    t + θ_j,   θ_j = min {θ ≥ 0: θ ≥ D_i,j},   i the branch's system at t + θ,

and the branch's part of u_j(t) is K_i,j x̂(t + θ_j), x̂ predicted from x(t) under the inputs in
flight and, from where an input is read that is still to be sent, under its own feedback K x̂.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deadtime.feedback.functional import Functional, LoopSpeeds, fastest_rate
from deadtime.plant import SwitchedSystem
from deadtime.switching import SwitchingSignal


@dataclass(frozen=True, eq=False)
class Forecast:
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
    ) -> Forecast:
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
    ) -> Forecast:
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

    @property
    def reaches(self) -> Float[np.ndarray, " reach"]:
        """How long ago what a prediction reads was sent, at the most: its delays, seconds."""
        return np.unique(self.delays)

    def speeds(self, plant: SwitchedSystem) -> LoopSpeeds:
        """How fast the loop with a plant is."""
        A, B = np.concatenate((plant.A, self.A)), np.concatenate((plant.B, self.B))
        gains = np.abs(self.gains).sum(axis=0)
        rate = fastest_rate(A, B, gains)
        jumps = {float(end): rate for end in np.unique(self.delays)}
        # In a system an input is in flight on when another one has arrived, which it then moves.
        K = gains.max(axis=0)
        for own, B_i in zip(self.delays, np.abs(self.B), strict=True):
            for j, k in zip(*np.nonzero(own[:, None] < own), strict=True):
                end = float(own[k] - own[j])
                jumps[end] = max(jumps.get(end, 0.0), float(K[j] @ B_i[:, k]))
        # Weights are bounds: of several delays 1e-10 moves a run by 2e-12, and takes several times
        # as long. At the ends of a segment u is extrapolated, which wants it shorter.
        return LoopSpeeds(1.5 * rate, rate, jumps, 1e-15 if self.reaches.size == 1 else 1e-7)
