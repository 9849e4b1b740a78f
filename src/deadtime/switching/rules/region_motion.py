"""Motion among regions whose boundaries are known: every crossing is found, by proof."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import read_only
from deadtime.base.errors import ArgumentError
from deadtime.switching.rules.motion import (
    ROUND_OFF,
    Arrival,
    Beside,
    Chatter,
    Leg,
    Motion,
    Move,
    most_crossings,
    round_off,
)


class Regions(NamedTuple):
    """Regions in which all of their own xᵀQx + row·x − offset are ≤ 0.

    forms : the Q, or (0, n, n) where the boundaries are planes
    first : where the boundaries of each region start, and how many there are
    modes : of each region
    """

    forms: Float[np.ndarray, "form n n"]
    rows: Float[np.ndarray, "row n"]
    offsets: Float[np.ndarray, " row"]
    first: Int[np.ndarray, " region+1"]
    modes: Int[np.ndarray, " region"]


@dataclass(frozen=True, eq=False)
class RegionMotion(Motion):
    """Motion among regions: crossings are found by proof, see `deadtime.switching.rules.crossings`.

    The arrays are those of `crossings.advance`, in the units of the states in which the modes
    are balanced (powers of two, so that the change costs no accuracy).
    """

    regions_of: Callable[[np.ndarray], np.ndarray]
    unit: Float[np.ndarray, " n"]
    plant: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
    regions: Regions
    lengths: Float[np.ndarray, " length"]
    Phi: Float[np.ndarray, "length mode n n"]
    Gamma: Float[np.ndarray, "length mode n m"]
    bend: Float[np.ndarray, "length mode row 3"]
    most: Int[np.ndarray, " length"]

    @classmethod
    def of(
        cls,
        regions_of: Callable[[np.ndarray], np.ndarray],
        A: Float[np.ndarray, "mode n n"],
        B: Float[np.ndarray, "mode n m"],
        regions: Regions,
        lengths: tuple[float, ...],
        unseen: int = 0,
    ) -> RegionMotion:
        """The motion among regions, `regions_of` saying which of them hold given states.

        No boundary knows of the last `unseen` states: these keep their units, and are known as well
        as the largest of all.
        """
        from deadtime.numerics.exponential import balance, discretise_modes
        from deadtime.switching.rules.crossings import MOST_PARTS

        seen = A.shape[1] - unseen
        unit = np.append(balance(np.abs(A[:, :seen, :seen]).sum(axis=0)), np.ones(unseen))
        A, B = A * unit / unit[:, None], B / unit[:, None]
        rate, longest = float(np.abs(A).sum(axis=2).max()), max(lengths)
        if not rate * longest <= 0.25 * MOST_PARTS:
            raise ArgumentError(
                f"step must be short enough to follow the plant to a rule's boundaries: |A|·step = "
                f"{rate * longest:.3g}, at most {0.25 * MOST_PARTS:.0f} is possible; shorten it, "
                "or measure states in other units."
            )
        forms, rows = regions.forms * unit * unit[:, None], regions.rows * unit
        # All read-only: one type for the compiled functions, whatever the rule.
        scaled = Regions(*(read_only(part) for part in (forms, rows, *regions[2:])))
        tables = [discretise_modes(A, B, length) for length in lengths]
        M, N = round_off(A, B, max(lengths))
        M[:, seen:] = ROUND_OFF
        return cls(
            regions_of,
            unit,
            (A, B, M, N),
            scaled,
            np.array(lengths),
            np.stack([Phi for Phi, _ in tables]),
            np.stack([Gamma for _, Gamma in tables]),
            np.stack([_bend(A, scaled, length) for length in lengths]),
            np.array([most_crossings(A, length) for length in lengths]),
        )

    @property
    def _regions(self) -> tuple[np.ndarray, ...]:
        return tuple(self.regions)

    def place_of(self, x: np.ndarray) -> int:
        return int(self.regions_of(x[None])[0])

    def mode_of(self, place: int) -> int:
        return int(self.regions.modes[place])

    def _chatter(self, kind: int, why: int, time: float, place: int, other: int) -> Chatter:
        from deadtime.switching.rules.crossings import PILED_UP

        mode, beyond = self.mode_of(place), self.mode_of(other)
        if why == PILED_UP:
            length, most = float(self.lengths[kind]), int(self.most[kind])
            return Chatter.pile_up(time, mode, beyond, length, most)
        return Chatter.stray(time, mode, beyond)

    def advance(
        self, kind: int, x: np.ndarray, place: int, u: np.ndarray, beside: Beside | None = None
    ) -> Move:
        from deadtime.switching.rules.crossings import advance, room

        most, legs = int(self.most[kind]), room(int(self.most[kind]), x.size)
        tables = self.Phi[kind], self.Gamma[kind], self.bend[kind]
        piece = float(self.lengths[kind]), *tables, most
        start = x / self.unit, u, place, (-1, -1) if beside is None else tuple(beside)
        z, region, along, count, (why, time, other) = advance(
            self.plant, self._regions, piece, *start, legs
        )
        chatter = self._chatter(kind, why, time, region, other) if why else None
        parts = zip(*(part[:count].tolist() for part in legs), strict=True)
        run = [Leg(t, y * self.unit, r, _beside(*rest)) for t, y, r, *rest in parts]
        if not (run and run[0].time == 0.0):
            run.insert(0, Leg(0.0, x, place))
        return Move(z * self.unit, region, _beside(*along), run, chatter)

    def hold(self, kind: int, x: np.ndarray, place: int, u: np.ndarray) -> np.ndarray:
        mode = self.mode_of(place)
        return self.unit * (self.Phi[kind, mode] @ (x / self.unit) + self.Gamma[kind, mode] @ u)

    def follow(self, kinds: np.ndarray, inputs: np.ndarray, x: np.ndarray, mode: int) -> Arrival:
        from deadtime.switching.rules.crossings import follow, region_of_mode

        pieces = self.lengths, self.Phi, self.Gamma, self.bend, self.most
        start = x / self.unit
        begin = region_of_mode(self.plant, self._regions, start, self.place_of(x), mode)
        z, region, beside, (piece, why, time, place, other) = follow(
            self.plant, self._regions, pieces, kinds, inputs, start, begin
        )
        chatter = None
        if piece >= 0:
            chatter = self._chatter(int(kinds[piece]), why, time, place, other)
            earlier = float(self.lengths[kinds[:piece]].sum())
            chatter = chatter._replace(time=chatter.time + earlier)
        return Arrival(z * self.unit, region, _beside(*beside), chatter)

    def along(self, leg: Leg, u: np.ndarray, tau: float) -> np.ndarray:
        from deadtime.numerics.exponential import discretise
        from deadtime.switching.rules.boundaries import slide

        z, mode = leg.x / self.unit, self.mode_of(leg.place)
        if leg.beside is None:
            Phi, Gamma = discretise(self.plant[0][mode], self.plant[1][mode], tau)
            return self.unit * (Phi @ z + Gamma @ u)
        between = leg.place, *leg.beside
        # A copy can be written to, as what moves has it: for one that cannot all is compiled anew.
        return self.unit * slide(self.plant, self._regions, between, z, u.copy(), tau)[0]

    def leads_on(self, x: np.ndarray, beside: Beside, u: np.ndarray) -> bool:
        from deadtime.switching.rules.boundaries import slope

        boundaries, mode = self._regions[:3], self.mode_of(beside.place)
        ahead, doubt = slope(self.plant, mode, boundaries, beside.boundary, x / self.unit, u.copy())
        return ahead > doubt


def _beside(place: int, boundary: int) -> Beside | None:
    return None if place < 0 else Beside(place, boundary)


def _bend(A: np.ndarray, regions: Regions, tau: float) -> Float[np.ndarray, "mode row 3"]:
    """By how much a g may rise above its chord over τ: |v|(b₀ + b₁|v| + b₂|x|), v = A x + B u.

    It is τ² |g''|/8. With G ≥ |e^{As}|, x'' = A x', |x'| ≤ G|v| and |x(s)| ≤ |x| + τ G|v|, a row
    has |g''| ≤ |row A| G |v|, and a form, q the sum of its |Q_ab|, has
    |g''| = 2|x'ᵀQx' + xᵀQx''| ≤ 2q (G²|v|² + (|x| + τ G|v|) G|A||v|).
    """
    from deadtime.switching.rules.crossings import growth

    bend = np.zeros((A.shape[0], regions.offsets.size, 3))
    for i, A_i in enumerate(A):
        G, size = growth(A_i, tau), np.abs(A_i).sum(axis=1).max()
        bend[i, :, 0] = G * np.abs(regions.rows @ A_i).sum(axis=1)
        if regions.forms.size:
            q = 2.0 * np.abs(regions.forms).sum(axis=(1, 2))
            bend[i, :, 1] = q * G * G * (1.0 + tau * size)
            bend[i, :, 2] = q * G * size
    return tau**2 / 8.0 * bend
