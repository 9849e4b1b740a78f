"""The disturbances of one run: how they push the state over each piece of each period.

They are drawn before the run, for they do not depend on it. Over a piece, a disturbance adds ξ to
the state; the constant force d = Γ_I⁻¹ ξ with Γ_I = ∫₀^τ e^{As} ds adds as much, and is what a
record evaluates between the ends of pieces: an input beside u.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import read_only
from deadtime.base.errors import ArgumentError
from deadtime.imperfections import Disturbance, Sizes
from deadtime.plant import SampledPlant
from deadtime.plant.pieces import PieceTable
from deadtime.plant.steps import Cuts

_SINGULAR = 1e-8  # of a piece


class Forcing:
    """What the disturbances of a run draw, and how to read it along the plant's modes."""

    def __init__(
        self,
        sampled: SampledPlant,
        steps: int,
        disturbances: Sequence[tuple[Disturbance, np.random.Generator]],
    ) -> None:
        plant = self._plant = sampled.plant
        self._step, self._sizes = sampled.step, Sizes.of(plant, sampled.step)
        # Of two stretches at least, so that a seed draws the same numbers for every delay.
        lengths = [part.stop - part.start for part in sampled.stretches(0)] + [0.0]
        lengths = tuple(lengths[: max(2, len(lengths) - 1)])
        self._kinds = [force for force, _ in disturbances]
        self._draws = [force.draws(self._sizes, lengths, steps, rng) for force, rng in disturbances]
        self._held = [
            [self._spreads([(A, part.stop - part.start)]) for part in sampled.stretches(mode)]
            for mode, A in enumerate(plant.A)
        ]

    def along(
        self, table: PieceTable, cuts: Cuts
    ) -> tuple[Float[np.ndarray, "piece n"], Float[np.ndarray, "piece n"]]:
        """ξ and d over the pieces of a known signal."""
        shift, force = np.zeros((2, table.entry.size, self._plant.states))
        period = table.period
        place = np.arange(period.size) - table.first[period]
        entries = self._entries(table, cuts)
        for entry in np.unique(table.entry):
            of = table.entry == entry
            spreads, inverse = entries[entry]
            for spread, draws in zip(spreads, self._draws, strict=True):
                shift[of] += draws[period[of], place[of]] @ spread.T
            force[of] = shift[of] @ inverse.T
        return shift, force

    def of_mode(self, k: int, piece: int, mode: int) -> Float[np.ndarray, " n"]:
        """d over a piece that starts in a mode; a switch within it leaves d as it is."""
        spreads, inverse = self._held[mode][piece]
        pairs = zip(spreads, self._draws, strict=True)
        return inverse @ np.sum([spread @ draws[k, piece] for spread, draws in pairs], axis=0)

    def _entries(self, table: PieceTable, cuts: Cuts) -> list[tuple[list[np.ndarray], np.ndarray]]:
        """What the numbers of every entry become; those of modes held come first."""
        held = [piece for pieces in self._held for piece in pieces]
        cut = [table.parts(entry, cuts) for entry in range(len(held), table.mode.size)]
        A = self._plant.A
        return held + [self._spreads([(A[i], b - a) for i, a, b in parts]) for parts in cut]

    def _spreads(
        self, pieces: list[tuple[np.ndarray, float]]
    ) -> tuple[list[np.ndarray], np.ndarray]:
        """How each disturbance's numbers become ξ over these pieces, and Γ_I⁻¹."""
        from deadtime.numerics.exponential import discretise, multiply

        n = self._plant.states
        Gamma = np.zeros((n, n))
        for A, tau in pieces:
            Phi, own = discretise(read_only(A), read_only(np.eye(n)), tau)
            Gamma = multiply(Phi, Gamma) + own
        total = sum(tau for _, tau in pieces)
        if total == 0.0:
            inverse = np.zeros((n, n))
        elif np.abs(np.linalg.eigvals(Gamma)).min() > _SINGULAR * total:
            inverse = np.linalg.inv(Gamma)
        else:
            raise ArgumentError(
                f"step = {self._step:g} s is too long for disturbances: a mode of the plant "
                "oscillates a whole number of times within it; shorten it."
            )
        return [force.spread(self._sizes, pieces) for force in self._kinds], inverse
