"""Laws in continuous time: `Functional`, windows on the past inputs, and `Forecast`, branches.

A `Functional` is a law that assumes no particular switch, with gains by the mode in force or
for all; `deadtime.laws.tables.windows` fills it. A `Forecast` has branches, weighted signals that
its model may follow. Along a branch u is the exact feedback for its signal: the input computed at t
is first read at

    t + θ_j,   θ_j = min {θ ≥ 0: θ ≥ D_i,j},   i the branch's system at t + θ,

and the branch's part of u_j(t) is K_i,j x̂(t + θ_j), x̂ predicted from x(t) under the inputs in
flight and, from where an input is read that is not yet computed, under its own feedback K x̂.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.frozen import Frozen
from deadtime.plant import SwitchedSystem
from deadtime.switching import SwitchingSignal


class LoopSpeeds(NamedTuple):
    """How fast an ideal loop is, bounds in 1/s.

    fastest : of the motion between jumps
    arriving : the jump of u in answer to a unit jump that arrives at the plant
    windows : likewise for a unit jump that enters or leaves a window, by its age there in seconds
    faint : the weight below which propagated jumps are ignored
    """

    fastest: float
    arriving: float
    windows: dict[float, float]
    faint: float


@dataclass(frozen=True, eq=False)
class Functional(Frozen):
    r"""A law in continuous time: feedback of the state and of windows of past inputs.

    :math:`u(t) = F_c x(t) + \sum_p C_{c,p} \int_{\alpha_p}^{\beta_p} e^{S_p (\tau - \alpha_p)} R_p
    u(t - \tau) \, d\tau`.

    c is the row that applies at t. Immutable.

    Attributes
    ----------
    F : (rows, m, n)
        Gain of the state.
    C : (rows, windows, m, q), S : (windows, q, q), R : (windows, q, m)
        Of the windows p.
    near : (windows,), far : (windows,)
        :math:`0 \le \alpha_p < \beta_p`, seconds.
    row : callable
        From times (T,) to the rows that apply there; where it changes the signal switches.
    """

    F: Float[np.ndarray, "row m n"]
    C: Float[np.ndarray, "row window m q"]
    S: Float[np.ndarray, "window q q"]
    R: Float[np.ndarray, "window q m"]
    near: Float[np.ndarray, " window"]
    far: Float[np.ndarray, " window"]
    row: Callable[[Float[np.ndarray, " T"]], Int[np.ndarray, " T"]]

    @classmethod
    def of_state(
        cls,
        K: Float[np.ndarray, "row m n"],
        row: Callable[[Float[np.ndarray, " T"]], Int[np.ndarray, " T"]],
    ) -> Functional:
        """State feedback :math:`u = K_c x`, with one empty window."""
        (rows, m, n), none = K.shape, np.zeros(1)
        nothing = np.zeros((rows, 1, m, n)), np.zeros((1, n, n)), np.zeros((1, n, m))
        return cls(K, *nothing, none, none, row)

    @property
    def breaks(self) -> Float[np.ndarray, " break"]:
        """Times at which the forecast changes: none."""
        return np.empty(0)

    @property
    def settled(self) -> Functional:
        """The law once the last mode of the signal has lasted."""
        return self

    @property
    def reaches(self) -> Float[np.ndarray, " reach"]:
        """Ages of past inputs at which a window begins or ends, seconds."""
        return np.unique(np.append(self.near, self.far))

    @cached_property
    def leaving(self) -> Float[np.ndarray, "window q m"]:
        """e^{S (β − α)} R."""
        from deadtime.numerics.exponential import discretise_all

        which = np.arange(self.near.size)
        return discretise_all(self.S, self.R, which, self.far - self.near)[0] @ self.R

    def speeds(self, plant: SwitchedSystem) -> LoopSpeeds:
        """How fast the loop with a plant is.

        In a predictor a jump that leaves a window cancels its arrival at the plant; only a law
        without prediction answers to the whole jump.
        """
        enter, ends = 0.0, dict[float, float]()
        for p, (near, far) in enumerate(zip(self.near.tolist(), self.far.tolist(), strict=True)):
            jump, left = (_largest(self.C[:, p] @ X[p]) for X in (self.R, self.leaving))
            enter += jump * (near == 0.0)
            for end, size in ((near, jump), (far, left)):
                ends[end] = ends.get(end, 0.0) + size
        ends.pop(0.0, None)
        none = np.zeros((1, plant.inputs, plant.states))
        if self.S.shape[1] == plant.states:
            free = fastest_rate(np.concatenate((plant.A, self.S)), plant.B, none)
        else:
            unfed = np.zeros((1, *self.C.shape[2:]))
            free = max(fastest_rate(plant.A, plant.B, none), fastest_rate(self.S, self.R, unfed))
        arriving = _largest(self.F[:, None] @ plant.B)
        return LoopSpeeds(free + (enter or arriving), arriving, ends, 1e-15)


def fastest_rate(A: np.ndarray, B: np.ndarray, K: np.ndarray) -> float:
    """A bound of |A| + |B||K| for any of the A, the B and the K ≥ 0, in balanced states, 1/s."""
    from deadtime.numerics.exponential import balance

    t = balance(np.abs(A).max(axis=0) + np.abs(B).max(axis=0) @ K.max(axis=0))
    free, fed, gain = (
        np.linalg.norm(M, 2, axis=(1, 2)).max()
        for M in (A * t / t[:, None], np.abs(B) / t[:, None], K * t)
    )
    return float(free + fed * gain)


def _largest(matrices: np.ndarray) -> float:
    """The largest of their 2-norms."""
    return float(np.linalg.norm(matrices, 2, axis=(-2, -1)).max())


@dataclass(frozen=True, eq=False)
class Forecast:
    """A law's forecast as branches (immutable).

    Attributes
    ----------
    A : (systems, n, n), B : (systems, n, m), delays : (systems, m)
        The model's modes, and systems that may follow after them.
    gains : (branches, systems, m, n)
        K_i of every branch.
    weights : (branches,)
        Weights of the branches in the sum u.
    breaks : (count,)
        Times at which the forecast changes.
    signals : callable
        From a time t to the forecast of each branch at it: start times, increasing, and the system
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
    def with_preview(
        cls,
        plant: SwitchedSystem,
        K: Float[np.ndarray, "mode m n"],
        signal: SwitchingSignal,
        settled: Functional,
    ) -> Forecast:
        """The forecast of a known signal."""
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
        """The forecast that the mode is held for its dwell time, then each system of `after`.

        `K` and `weights` are those of these systems; a branch has the gain of its last throughout.
        """
        modes, branches = plant.modes, after.modes
        follows = modes + np.arange(branches)

        def signals(t: float) -> tuple[np.ndarray, np.ndarray]:
            now = np.array([t])
            until = float(signal.last_switch(now)[0]) + dwell_time
            # The first part must have begun at t: any earlier time will do.
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
        """Ages of the oldest inputs that a prediction reads: its delays, seconds."""
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
        # as long. At the ends of a segment u is extrapolated, which needs shorter segments.
        return LoopSpeeds(1.5 * rate, rate, jumps, 1e-15 if self.reaches.size == 1 else 1e-7)
