"""Functional: a law as windows on the past inputs, with gains by the mode in force or for all.

It is the ideal form of a law that believes in no particular switch, as `Forecast` is of laws that
do; it is filled by `deadtime.laws.tables.windows` and `deadtime.laws.tables.passage_windows`.
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


class LoopSpeeds(NamedTuple):
    """How fast an ideal loop is, bounds in 1/s.

    fastest : of all that the loop does between jumps
    arriving : what it makes, in u, of a jump of u that arrives
    windows : what the law makes of one that enters or leaves a window, by the seconds to there
    faint : the weight below which jumps that are passed on do not count
    """

    fastest: float
    arriving: float
    windows: dict[float, float]
    faint: float


@dataclass(frozen=True, eq=False)
class Functional(Frozen):
    """u(t) = F_c x(t) + Σ_p C_c,p ∫ e^{S_p (τ − α_p)} R_p u(t − τ) dτ, τ from α_p to β_p.

    c is the row that applies at t. Immutable.

    Attributes
    ----------
    F : (rows, m, n)
        Gain of the state.
    C : (rows, windows, m, q), S : (windows, q, q), R : (windows, q, m)
        Of the windows p.
    near : (windows,), far : (windows,)
        0 ≤ α_p < β_p, seconds.
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
        """State feedback u = K_c x: of its one window nothing is left."""
        (rows, m, n), none = K.shape, np.zeros(1)
        nothing = np.zeros((rows, 1, m, n)), np.zeros((1, n, n)), np.zeros((1, n, m))
        return cls(K, *nothing, none, none, row)

    @property
    def breaks(self) -> Float[np.ndarray, " break"]:
        """Times at which what is believed changes: none."""
        return np.empty(0)

    @property
    def settled(self) -> Functional:
        """The law once the last mode of the signal has lasted."""
        return self

    @property
    def reaches(self) -> Float[np.ndarray, " reach"]:
        """How long ago what the law reads was sent, where that begins and ends, seconds."""
        return np.unique(np.append(self.near, self.far))

    @cached_property
    def leaving(self) -> Float[np.ndarray, "window q m"]:
        """e^{S (β − α)} R."""
        from deadtime.numerics.exponential import discretise_all

        which = np.arange(self.near.size)
        return discretise_all(self.S, self.R, which, self.far - self.near)[0] @ self.R

    def speeds(self, plant: SwitchedSystem) -> LoopSpeeds:
        """How fast the loop with a plant is.

        What leaves a window is what arrives, with the opposite sign, where a law predicts: only one
        that does not feels all that arrives.
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
