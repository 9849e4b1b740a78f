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
from deadtime.imperfections import Disturbance, Sizes, Stacked
from deadtime.imperfections.base import Piece
from deadtime.plant import SampledPlant
from deadtime.plant.pieces import PieceTable
from deadtime.plant.steps import Cuts

_SINGULAR = 1e-8  # of a piece


class Forcing:
    """What the disturbances of a run draw, and how to read it along the plant's modes.

    They are drawn for the stretches of a period, which are the same time in all modes (the plant is
    `SampledPlant.cut_alike`). A switch to a mode that reads its inputs with other delays cuts a
    stretch into pieces: the force that adds as much as was drawn is held over all of them.
    """

    def __init__(
        self,
        sampled: SampledPlant,
        steps: int,
        disturbances: Sequence[tuple[Disturbance, np.random.Generator]],
    ) -> None:
        plant = self._plant = sampled.plant
        self._step, self._sizes = sampled.step, Sizes.of(plant, sampled.step)
        self._starts = np.array([part.start for part in sampled.stretches(0)])
        # Of two stretches at least, so that a seed draws the same numbers for every delay.
        lengths = [part.stop - part.start for part in sampled.stretches(0)] + [0.0]
        lengths = tuple(lengths[: max(2, len(lengths) - 1)])
        self._kinds = [force for force, _ in disturbances]
        self._draws = [force.draws(self._sizes, lengths, steps, rng) for force, rng in disturbances]
        held = [sampled.stretches(mode) for mode in range(plant.modes)]
        self._first = np.cumsum([0, *map(len, held)])
        self._held = [
            [(A, part.stop - part.start)]
            for A, parts in zip(plant.A, held, strict=True)
            for part in parts
        ]
        self._of_held = self._maps(self._held)

    def along(
        self, table: PieceTable, cuts: Cuts
    ) -> tuple[Float[np.ndarray, "piece n"], Float[np.ndarray, "piece n"]]:
        """ξ and d over the pieces of a known signal."""
        A, shift = self._plant.A, np.zeros((table.entry.size, self._plant.states))
        period, entry = table.period, table.entry
        place = np.searchsorted(self._starts, table.start[entry], "right") - 1
        # The entries of modes held come first.
        cut = [table.parts(e, cuts) for e in range(len(self._held), table.mode.size)]
        own = [[(A[i], b - a) for i, a, b in e] for e in cut]
        # A piece that goes on in a stretch has the force of the one that begins it.
        goes_on = np.append(False, (np.diff(period) == 0) & (np.diff(place) == 0))
        head = np.maximum.accumulate(np.where(goes_on, 0, np.arange(entry.size)))
        whole, first = [list(parts) for parts in own], len(self._held)
        for q in np.flatnonzero(goes_on):
            whole[entry[head[q]] - first] += own[entry[q] - first]
        spreads, inverse = self._maps(self._held + whole)
        for spread, draws in zip(spreads, self._draws, strict=True):
            shift += np.einsum("qnr,qr->qn", spread[entry[head]], draws[period, place])
        force = np.einsum("qij,qj->qi", inverse[entry[head]], shift)
        shared = np.unique(head[goes_on])
        parts = np.flatnonzero(np.isin(head, shared))
        if parts.size:
            Gamma = self._pushed(*_stacked([own[entry[q] - first] for q in parts]))
            shift[parts] = np.einsum("qij,qj->qi", Gamma, force[parts])
        return shift, force

    def of_mode(self, k: int, piece: int, mode: int) -> Float[np.ndarray, " n"]:
        """d over a stretch that starts in a mode; a switch within it leaves d as it is."""
        (spreads, inverse), entry = self._of_held, self._first[mode] + piece
        pairs = zip(spreads, self._draws, strict=True)
        shift = np.sum([spread[entry] @ draws[k, piece] for spread, draws in pairs], axis=0)
        return inverse[entry] @ shift

    def _maps(self, entries: list[list[Piece]]) -> tuple[list[np.ndarray], np.ndarray]:
        """How each disturbance's numbers become ξ over every entry, and Γ_I⁻¹."""
        A, tau = _stacked(entries)
        spreads = [
            force.spreads(self._sizes, A, tau)
            if isinstance(force, Stacked)
            else np.stack([force.spread(self._sizes, pieces) for pieces in entries])
            for force in self._kinds
        ]
        return spreads, self._inverse(A, tau)

    def _pushed(self, A: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """Γ_I of every entry."""
        from deadtime.numerics.exponential import discretise_each

        Gamma, unit = np.zeros((len(A), *A.shape[2:])), np.eye(A.shape[2])
        unit = np.broadcast_to(unit, Gamma.shape)
        for i in range(tau.shape[1]):
            Phi, own = discretise_each(*map(read_only, (A[:, i], unit, tau[:, i])))
            Gamma = Phi @ Gamma + own
        return Gamma

    def _inverse(self, A: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """Γ_I⁻¹ of every entry, 0 where it takes no time."""
        Gamma, total = self._pushed(A, tau), tau.sum(axis=1)
        size = np.abs(np.linalg.eigvals(Gamma)).min(axis=1)
        if not (size[total > 0.0] > _SINGULAR * total[total > 0.0]).all():
            raise ArgumentError(
                f"step = {self._step:g} s is too long for disturbances: a mode of the plant "
                "oscillates a whole number of times within it; shorten it."
            )
        inverse = np.zeros(Gamma.shape)
        inverse[total > 0.0] = np.linalg.inv(Gamma[total > 0.0])
        return inverse


def _stacked(entries: list[list[Piece]]) -> tuple[np.ndarray, np.ndarray]:
    """A (entries, pieces, n, n) and seconds (entries, pieces) of entries, 0 for fewer pieces."""
    n, longest = len(entries[0][0][0]), max(map(len, entries))
    A, tau = np.zeros((len(entries), longest, n, n)), np.zeros((len(entries), longest))
    for entry, pieces in enumerate(entries):
        for i, (matrix, seconds) in enumerate(pieces):
            A[entry, i], tau[entry, i] = matrix, seconds
    return A, tau
