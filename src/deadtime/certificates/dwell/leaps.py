"""Stretches of periods from node to node as matrices in floats, for the search.

See `proof.transitions.NodeStretch`. The matrix of a stretch is the product over its periods, at a
few instants of the switch; the proof covers the other instants.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from deadtime.certificates.dwell.centre import loop_matrix
from deadtime.certificates.proof.evidence import Setting
from deadtime.certificates.proof.transitions import NodeStretch, Transition

Node = tuple[int, int]  # (place: mode and lost samples, which knot)


@dataclass(frozen=True, eq=False)
class Leap:
    """A stretch at one instant of its switch: ξ after it is M ξ."""

    stretch: NodeStretch
    M: np.ndarray
    setting: Setting

    @property
    def here(self) -> Node:
        """The node it starts from."""
        step = self.stretch.step
        return self.setting.transitions.place(step.mode, step.lost), self.stretch.knot

    @property
    def there(self) -> Node:
        """The node it ends at."""
        step = self.stretch.step
        place = self.setting.transitions.place(step.after, step.next_lost)
        return place, self.stretch.next_knot

    def in_units(self, rho: float, units: np.ndarray, mu: float = 1.0) -> np.ndarray:
        """M in other units of ξ, divided by ρ to the power of its periods and by the rise of V."""
        factor = rho**-self.stretch.periods
        periods = self.setting.periods_per_switch
        if periods is not None:
            factor *= mu ** (0.5 * float(1 / periods - self.stretch.step.switches))
        return units[:, None] * self.M / units * factor


class Leaps:
    """The leaps of one setting; products of full steps are kept."""

    def __init__(self, setting: Setting) -> None:
        self.setting = setting
        self.known: dict[tuple[int, int, int], np.ndarray] = {}
        self.followed: dict[tuple[int, tuple[int, ...]], np.ndarray] = {}

    def of(self, stretch: NodeStretch, instants: tuple[float, ...] | None = None) -> list[Leap]:
        """Leaps for switches at these fractions of the period, by default at both ends."""
        step = stretch.step
        before = self.full(step.mode, step.age - stretch.waits, step.age)
        after = self._following(step, stretch.follows)
        steps = plant_rows(self.setting, step, instants or step.instants)
        periods = [loop_matrix(self.setting, E, step.row) for E in steps]
        return [Leap(stretch, after @ M @ before, self.setting) for M in periods]

    def full(self, mode: int, start: int, end: int) -> np.ndarray:
        """The product of the full steps from one age to another, by halves."""
        key = mode, start, end
        if key not in self.known:
            if end == start:
                product = np.eye(self.setting.order)
            elif end == start + 1:
                product = self._step(mode, self.setting.transitions.row(mode, start))
            else:
                middle = (start + end) // 2
                product = self.full(mode, middle, end) @ self.full(mode, start, middle)
            self.known[key] = product
        return self.known[key]

    def _following(self, step: Transition, follows: int) -> np.ndarray:
        """The product of the full steps after a step; the first ones have rows of the old mode."""
        rows = tuple(self.setting.transitions.rows_after(step, follows))
        if not rows:
            return self.full(step.after, 0, follows)
        key = step.after, rows
        if key not in self.followed:
            product = np.eye(self.setting.order)
            for row in rows:
                product = self._step(step.after, row) @ product
            self.followed[key] = product
        return self.full(step.after, len(rows), follows) @ self.followed[key]

    def _step(self, mode: int, row: int) -> np.ndarray:
        E = plant_rows(self.setting, Transition(mode, 0, row, mode, 0), (0.0,))[0]
        return loop_matrix(self.setting, E, row)


def plant_rows(setting: Setting, step: Transition, instants: tuple[float, ...]) -> np.ndarray:
    """E (samples, n, k) of a step that switches at these fractions of the period.

    At all corners of the polytope, and at the ends of ranges of delays.
    """
    family: Any = setting.family
    rows = []
    for instant in sorted(set(instants)):
        # The first order of events that contains the instant: at a border both have the same step.
        for order in family.orders(step.mode, step.within):
            share = family.shares(order, (instant, instant))
            if share is not None:
                rows.append(family.corners(order, np.array([0.5 * sum(share)])))
                break
    return np.concatenate(rows)
