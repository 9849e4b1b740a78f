"""The disturbances of one run: how they push the state over each piece of each period.

They are drawn before the run, for they do not depend on it. Over a piece, a disturbance adds ξ to
the state; the constant force d = Γ_I⁻¹ ξ with Γ_I = ∫₀^τ e^{As} ds adds as much, and is what a
record evaluates between the ends of pieces: an input beside u.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.imperfections import Disturbance, Sizes, Stacked
from deadtime.imperfections.disturbances import DrawnDisturbance
from deadtime.numerics.covariance import accumulate, rates
from deadtime.plant import SampledPlant
from deadtime.plant.discretisation import Cuts
from deadtime.plant.pieces import PieceTable

Drawn = Sequence[tuple[Disturbance, np.random.Generator]]  # disturbances and their streams
_SINGULAR = 1e-8  # of a piece: Γ_I with a smaller eigenvalue is not inverted


class Forcing:
    """The draws of a run's disturbances, read along the plant's modes.

    `through` (modes, n, f) multiplies the forces in dx/dt: first the identity, for d, then a column
    for each disturbance whose force depends on the mode, which is multiplied by 1 while it acts.

    Draws belong to the stretches of a period, which have the same times in all modes (the plant is
    `SampledPlant.cut_alike`). A switch to a mode that reads its inputs with other delays cuts a
    stretch into pieces: the force that adds the ξ drawn is held over all of them.
    """

    def __init__(self, sampled: SampledPlant, steps: int, disturbances: Drawn) -> None:
        plant = self._plant = sampled.plant
        self._step, self._sizes = sampled.step, Sizes.of(plant, sampled.step)
        self._starts = np.array([part.start for part in sampled.stretches(0)])
        lengths = lengths_of(sampled)
        drawn = [(each, each.draws(self._sizes, lengths, steps, rng)) for each, rng in disturbances]
        by_mode = [force.force_by_mode(self._sizes) for force, _ in drawn]
        parted = list(zip(drawn, by_mode, strict=True))
        self._kinds = [force for (force, _), c in parted if c is None]
        self._draws = [draws for (_, draws), c in parted if c is None]
        self._offsets = [(force, draws) for (force, draws), c in parted if c is not None]
        columns = [c[:, :, None] for c in by_mode if c is not None]
        unit = np.broadcast_to(np.eye(plant.states), plant.A.shape)
        self.through = np.concatenate((unit, *columns), axis=2)
        held = [sampled.stretches(mode) for mode in range(plant.modes)]
        self._first = np.cumsum([0, *map(len, held)])
        self._held = [
            [(mode, part.stop - part.start)] for mode, parts in enumerate(held) for part in parts
        ]

    @cached_property
    def _maps_of_held(self) -> tuple[list[np.ndarray], np.ndarray]:
        return self._maps(self._held)

    def along(
        self, table: PieceTable, cuts: Cuts
    ) -> tuple[Float[np.ndarray, "piece n"], Float[np.ndarray, "piece f"]]:
        """ξ and the forces, d and the activity of forces by mode, over the pieces of a signal."""
        shift = np.zeros((table.entry.size, self._plant.states))
        period, entry = table.period, table.entry
        place = np.searchsorted(self._starts, table.start[entry], "right") - 1
        # The entries of modes held come first: in `own` they are left out.
        cut = [table.parts(e, cuts) for e in range(len(self._held), table.mode.size)]
        own = [[(i, b - a) for i, a, b in e] for e in cut]
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
            # The head's force is held over all pieces of its stretch, each by its own Γ.
            Gamma = pushed_over(self._plant.A, *_stacked([own[entry[q] - first] for q in parts]))
            shift[parts] = np.einsum("qij,qj->qi", Gamma, force[parts])
        for kind, draws in self._offsets:
            spread = spread_over(kind, self._sizes, self._plant.A, *_stacked(self._held + own))
            active = draws[period, place]
            shift += np.einsum("qnr,qr->qn", spread[entry], active)
            force = np.hstack((force, active))
        return shift, force

    def of_mode(self, k: int, piece: int, mode: int) -> Float[np.ndarray, " f"]:
        """The force over a stretch that starts in a mode; a switch within it leaves d as it is."""
        (spreads, inverse), entry = self._maps_of_held, self._first[mode] + piece
        shift = np.zeros(self._plant.states)
        for spread, draws in zip(spreads, self._draws, strict=True):
            shift += spread[entry] @ draws[k, piece]
        active = [draws[k, piece] for _, draws in self._offsets]
        return np.concatenate((inverse[entry] @ shift, *active))

    def _maps(self, entries: list[list[tuple[int, float]]]) -> tuple[list[np.ndarray], np.ndarray]:
        """The map from each disturbance's draws to ξ over every entry, and Γ_I⁻¹."""
        mode, tau = _stacked(entries)
        A = self._plant.A
        spreads = [spread_over(force, self._sizes, A, mode, tau) for force in self._kinds]
        return spreads, force_over(A, mode, tau, self._step)


def lengths_of(sampled: SampledPlant) -> tuple[float, ...]:
    """Lengths of the stretches of a period, seconds, for which disturbances draw.

    At least two, the second of length 0 if need be: a seed draws the same numbers for every delay.
    """
    lengths = [part.stop - part.start for part in sampled.stretches(0)]
    return tuple([*lengths, 0.0][: max(2, len(lengths))])


def spread_over(
    force: Disturbance, sizes: Sizes, A: np.ndarray, mode: np.ndarray, tau: np.ndarray
) -> Float[np.ndarray, "count n r"]:
    """The map from a disturbance's draws to ξ over many stretches.

    Each has tau (count, pieces) seconds, 0 for no piece, in a mode (count, pieces).
    """
    if isinstance(force, DrawnDisturbance):
        return force.spreads_in(sizes, A, mode, tau)
    if isinstance(force, Stacked):
        return force.spreads(sizes, A[mode], tau)
    pieces = [
        [(A[i], float(t)) for i, t in zip(*each, strict=True) if t > 0.0]
        for each in zip(mode, tau, strict=True)
    ]
    return np.stack([force.spread(sizes, each) for each in pieces])


def pushed_over(A: np.ndarray, mode: np.ndarray, tau: np.ndarray) -> Float[np.ndarray, "count n n"]:
    """Γ_I over many stretches, given as above."""
    modes, n, _ = A.shape
    joint = np.zeros((modes, 2 * n, 2 * n))
    joint[:, :n, :n], joint[:, :n, n:] = A, np.eye(n)
    return accumulate(joint, None, rates(A), mode, tau)[0][:, :n, n:]


def force_over(
    A: np.ndarray, mode: np.ndarray, tau: np.ndarray, step: float
) -> Float[np.ndarray, "count n n"]:
    """Γ_I⁻¹ over many stretches, from ξ to d, 0 where one takes no time; the others as above."""
    Gamma, total = pushed_over(A, mode, tau), tau.sum(axis=1)
    # No eigenvalues are needed for short pieces: in balanced units |Γ_I/τ − I| ≤ (e^s − 1)/s − 1
    # < 1 for s = |A|τ ≤ 1, so that Γ_I is regular.
    if rates(np.abs(A).sum(axis=0)[None])[0] * total.max() > 1.0:
        size = np.abs(np.linalg.eigvals(Gamma)).min(axis=1)
        if not (size[total > 0.0] > _SINGULAR * total[total > 0.0]).all():
            raise ArgumentError(
                f"step = {step:g} s is too long for disturbances: a mode of the plant "
                "oscillates a whole number of times within it; shorten it."
            )
    inverse = np.zeros(Gamma.shape)
    inverse[total > 0.0] = np.linalg.inv(Gamma[total > 0.0])
    return inverse


def _stacked(entries: list[list[tuple[int, float]]]) -> tuple[np.ndarray, np.ndarray]:
    """Modes and seconds (entries, pieces) of entries, 0 s for fewer pieces."""
    shape = len(entries), max(map(len, entries))
    mode, tau = np.zeros(shape, np.int64), np.zeros(shape)
    for entry, pieces in enumerate(entries):
        for i, (of, seconds) in enumerate(pieces):
            mode[entry, i], tau[entry, i] = of, seconds
    return mode, tau
