"""Motion among polyhedra: every crossing is found, by proof."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from deadtime.switching.motion import Arrival, Chatter, Motion, Move, most_crossings, round_off


@dataclass(frozen=True, eq=False)
class PolyhedralMotion(Motion):
    """Motion among polyhedra: crossings are found by proof, see `deadtime.switching.crossings`.

    The arrays are those of `crossings.advance`, in the units of the states in which the modes
    are balanced (powers of two, so that the change costs no accuracy).
    """

    regions_of: Callable[[np.ndarray], np.ndarray]
    unit: Float[np.ndarray, " n"]
    A: Float[np.ndarray, "mode n n"]
    B: Float[np.ndarray, "mode n m"]
    rows: Float[np.ndarray, "row n"]
    offsets: Float[np.ndarray, " row"]
    modes: Int[np.ndarray, " region"]
    first: Int[np.ndarray, " region+1"]
    noise: tuple[Float[np.ndarray, "mode n n"], Float[np.ndarray, "mode n m"]]
    lengths: Float[np.ndarray, " length"]
    Phi: Float[np.ndarray, "length mode n n"]
    Gamma: Float[np.ndarray, "length mode n m"]
    bend: Float[np.ndarray, "length mode row"]
    most: Int[np.ndarray, " length"]

    @classmethod
    def of(
        cls,
        regions_of: Callable[[np.ndarray], np.ndarray],
        A: Float[np.ndarray, "mode n n"],
        B: Float[np.ndarray, "mode n m"],
        polyhedra: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
        lengths: tuple[float, ...],
    ) -> PolyhedralMotion:
        """The motion among polyhedra given as rows, offsets, first rows and modes."""
        from deadtime.exponential import balance, held_modes
        from deadtime.switching.crossings import growth

        rows, offsets, first, modes = polyhedra
        unit = balance(np.abs(A).sum(axis=0))
        A, B = A * unit / unit[:, None], B / unit[:, None]
        scaled = rows * unit
        tables = [held_modes(A, B, length) for length in lengths]
        # |g''| ≤ |row A| |e^{As}| |v|, and g rises above its chord by at most τ² |g''|/8.
        rise = [[length**2 / 8.0 * growth(A_i, length) for A_i in A] for length in lengths]
        steep = np.abs(np.einsum("rk,ikl->irl", scaled, A)).sum(axis=2)
        bend = np.array(rise)[:, :, None] * steep
        return cls(
            regions_of,
            unit,
            A,
            B,
            scaled,
            offsets,
            modes,
            first,
            round_off(A, B, max(lengths)),
            np.array(lengths),
            np.stack([Phi for Phi, _ in tables]),
            np.stack([Gamma for _, Gamma in tables]),
            bend,
            np.array([most_crossings(A, length) for length in lengths]),
        )

    @property
    def _plant(self) -> tuple[np.ndarray, ...]:
        return self.A, self.B, *self.noise

    @property
    def _regions(self) -> tuple[np.ndarray, ...]:
        return self.rows, self.offsets, self.first, self.modes

    def place_of(self, x: np.ndarray) -> int:
        return int(self.regions_of(x[None])[0])

    def mode_of(self, place: int) -> int:
        return int(self.modes[place])

    def _chatter(self, kind: int, time: float, mode: int, other: int, facing: bool) -> Chatter:
        length, most = float(self.lengths[kind]), int(self.most[kind])
        if facing:
            return Chatter.facing(time, mode, other, length)
        return Chatter.piled_up(time, mode, other, length, most)

    def advance(self, kind: int, x: np.ndarray, place: int, u: np.ndarray) -> Move:
        from deadtime.switching.crossings import advance

        most = int(self.most[kind])
        at, to = np.empty(most), np.empty(most, np.int64)
        piece = float(self.lengths[kind]), self.Phi[kind], self.Gamma[kind], self.bend[kind]
        z, region, switches, time, other, facing = advance(
            self._plant, self._regions, piece, x / self.unit, u, place, at, to
        )
        chatter = None
        if time >= 0.0:
            chatter = self._chatter(kind, time, self.mode_of(region), other, facing)
        return Move(z * self.unit, region, at[:switches], to[:switches], chatter)

    def hold(self, kind: int, x: np.ndarray, place: int, u: np.ndarray) -> np.ndarray:
        mode = self.modes[place]
        return self.unit * (self.Phi[kind, mode] @ (x / self.unit) + self.Gamma[kind, mode] @ u)

    def follow(self, kinds: np.ndarray, inputs: np.ndarray, x: np.ndarray) -> Arrival:
        from deadtime.switching.crossings import follow

        pieces = self.lengths, self.Phi, self.Gamma, self.bend, self.most
        start = x / self.unit
        z, region, piece, time, mode, other, facing = follow(
            self._plant, self._regions, pieces, kinds, inputs, start, self.place_of(x)
        )
        chatter = None
        if piece >= 0:
            chatter = self._chatter(int(kinds[piece]), time, mode, other, facing)
            earlier = float(self.lengths[kinds[:piece]].sum())
            chatter = chatter._replace(time=chatter.time + earlier)
        return Arrival(z * self.unit, region, chatter)
