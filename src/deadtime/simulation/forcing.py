"""The disturbances of one run: how they push the state over each phase of each step.

They are drawn before the run, for they do not depend on it. Over a phase, a disturbance adds ξ to
the state; the constant force d = Γ_I⁻¹ ξ with Γ_I = ∫₀^τ e^{As} ds adds as much, and is what a
record evaluates between the ends of phases: an input beside u.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import read_only
from deadtime.base.errors import ArgumentError
from deadtime.imperfections import Disturbance, Sizes
from deadtime.plant import SwitchedSystem, Window
from deadtime.simulation.record import PhaseTable
from deadtime.switching.grid import Cuts

_SINGULAR = 1e-8  # of a phase


class Forcing:
    """What the disturbances of a run draw, and how to read it along the plant's modes."""

    def __init__(
        self,
        plant: SwitchedSystem,
        window: Window,
        steps: int,
        disturbances: Sequence[tuple[Disturbance, np.random.Generator]],
    ) -> None:
        self._plant, self._window = plant, window
        self._sizes = Sizes.of(plant, window.step)
        self._lengths = window.phase, window.step - window.phase
        self._kinds = [one for one, _ in disturbances]
        self._draws = [
            one.draws(self._sizes, self._lengths, steps, rng) for one, rng in disturbances
        ]
        self._uncut = [[self._spreads([(A, length)]) for length in self._lengths] for A in plant.A]

    def along(
        self, table: PhaseTable, cuts: Cuts
    ) -> tuple[Float[np.ndarray, "step 2 n"], Float[np.ndarray, "step 2 n"]]:
        """ξ and d over the phases of a known signal."""
        total, n = table.index.shape[0], self._plant.states
        shift, force = np.zeros((2, total, 2, n))
        for entry in range(table.mode.size):
            k, f = np.nonzero(table.index == entry)
            if k.size:
                spreads, inverse = self._entry(entry, table, cuts)
                for spread, draws in zip(spreads, self._draws, strict=True):
                    shift[k, f] += draws[k, f] @ spread.T
                force[k, f] = shift[k, f] @ inverse.T
        return shift, force

    def of_mode(self, k: int, phase: int, mode: int) -> Float[np.ndarray, " n"]:
        """d over a phase that starts in a mode; a switch within it leaves d as it is."""
        spreads, inverse = self._uncut[mode][phase]
        pairs = zip(spreads, self._draws, strict=True)
        return inverse @ np.sum([spread @ draws[k, phase] for spread, draws in pairs], axis=0)

    def _entry(
        self, entry: int, table: PhaseTable, cuts: Cuts
    ) -> tuple[list[np.ndarray], np.ndarray]:
        if entry < 2 * self._plant.modes:
            return self._uncut[entry // 2][entry % 2]
        first, stop = table.first[entry], table.stop[entry]
        early = cuts.offset[first] < self._window.phase
        now, end = (0.0, self._window.phase) if early else (self._window.phase, self._window.step)
        mode, pieces = table.mode[entry], []
        for p in range(first, stop):
            pieces.append((self._plant.A[mode], cuts.offset[p] - now))
            now, mode = cuts.offset[p], cuts.mode[p + 1]
        return self._spreads([*pieces, (self._plant.A[mode], end - now)])

    def _spreads(
        self, pieces: list[tuple[np.ndarray, float]]
    ) -> tuple[list[np.ndarray], np.ndarray]:
        """How each disturbance's numbers become ξ over these pieces, and Γ_I⁻¹."""
        from deadtime.numerics.exponential import held, multiply

        n = self._plant.states
        Gamma = np.zeros((n, n))
        for A, tau in pieces:
            Phi, own = held(read_only(A), read_only(np.eye(n)), tau)
            Gamma = multiply(Phi, Gamma) + own
        total = sum(tau for _, tau in pieces)
        if total == 0.0:
            inverse = np.zeros((n, n))
        elif np.abs(np.linalg.eigvals(Gamma)).min() > _SINGULAR * total:
            inverse = np.linalg.inv(Gamma)
        else:
            raise ArgumentError(
                f"step = {self._window.step:g} s is too long for disturbances: a mode of the plant "
                "oscillates a whole number of times within it; shorten it."
            )
        return [one.spread(self._sizes, pieces) for one in self._kinds], inverse
