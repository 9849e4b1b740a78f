"""Motion under a switching rule: among regions with known boundaries, and by samples of a function.

With known boundaries every crossing is found, with proof. Under a rule that is a function,
crossings are searched at samples.
"""

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
    Beside,
    Chatter,
    Leg,
    Motion,
    Move,
    most_crossings,
    round_off,
)


class Regions(NamedTuple):
    """Regions, each where all of its xᵀQx + row·x − offset are ≤ 0.

    forms : the Q; (0, n, n) if all boundaries are planes
    first : the first boundary of each region, then the number of boundaries
    modes : the mode of each region
    """

    forms: Float[np.ndarray, "form n n"]
    rows: Float[np.ndarray, "row n"]
    offsets: Float[np.ndarray, " row"]
    first: Int[np.ndarray, " region+1"]
    modes: Int[np.ndarray, " region"]


@dataclass(frozen=True, eq=False)
class RegionMotion(Motion):
    """Motion among regions with proved crossings, see `deadtime.switching.rules.crossings`.

    The arrays are those of `crossings.advance`, in units of the states in which the modes are
    balanced. The units are powers of two, so that scaling is exact.
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
        """The motion among regions; `regions_of` returns the regions of given states.

        The boundaries do not depend on the last `unseen` states. These keep their units, and their
        round-off is that of the largest state.
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
        # All read-only, and so of one type: the kernels are compiled once for all rules.
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
        return tuple(self.regions)  # a named tuple has another type in Numba

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

    def follow(self, kinds: np.ndarray, inputs: np.ndarray, x: np.ndarray, mode: int) -> Move:
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
        return Move(z * self.unit, region, _beside(*beside), [], chatter)

    def along(self, leg: Leg, u: np.ndarray, tau: float) -> np.ndarray:
        from deadtime.numerics.exponential import discretise
        from deadtime.switching.rules.boundaries import slide

        z, mode = leg.x / self.unit, self.mode_of(leg.place)
        if leg.beside is None:
            Phi, Gamma = discretise(self.plant[0][mode], self.plant[1][mode], tau)
            return self.unit * (Phi @ z + Gamma @ u)
        between = leg.place, *leg.beside
        # A copy is writable, as in `advance`: for a read-only u all would be compiled again.
        return self.unit * slide(self.plant, self._regions, between, z, u.copy(), tau)[0]

    def leads_on(self, x: np.ndarray, beside: Beside, u: np.ndarray) -> bool:
        from deadtime.switching.rules.boundaries import slope

        boundaries, mode = self._regions[:3], self.mode_of(beside.place)
        ahead, doubt = slope(self.plant, mode, boundaries, beside.boundary, x / self.unit, u.copy())
        return ahead > doubt


def _beside(place: int, boundary: int) -> Beside | None:
    return None if place < 0 else Beside(place, boundary)


def _bend(A: np.ndarray, regions: Regions, tau: float) -> Float[np.ndarray, "mode row 3"]:
    """b with |v|(b₀ + b₁|v| + b₂|x|) above the excess of g over its chord over τ, v = A x + B u.

    The excess is at most τ² |g''|/8. With G ≥ |e^{As}|, x'' = A x', |x'| ≤ G|v| and
    |x(s)| ≤ |x| + τ G|v|, a row has |g''| ≤ |row A| G |v|, and a form, q the sum of its |Q_ab|, has
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


_SHARP = 1e-15  # of the bracket's right end, to which a crossing is bisected
_ASIDE = (1e-8, 1e-6, 1e-4, 1e-2)  # distances along a field, in lengths of a piece


@dataclass(frozen=True, eq=False)
class SampledMotion(Motion):
    """Motion under a rule that is a function; places are modes.

    The rule is evaluated at `samples` instants of every piece, and again after every crossing; a
    change between two of them is bisected. A stay in a mode between two samples is missed. A sample
    counts as a change if it and its neighbourhood, as wide as its round-off, are in another mode.
    """

    mode_at: Callable[[np.ndarray], int]
    A: Float[np.ndarray, "mode n n"]
    B: Float[np.ndarray, "mode n m"]
    lengths: Float[np.ndarray, " length"]
    Phi: Float[np.ndarray, "mode length sample n n"]
    Gamma: Float[np.ndarray, "mode length sample n m"]
    noise: tuple[Float[np.ndarray, "mode n n"], Float[np.ndarray, "mode n m"]]

    @classmethod
    def of(
        cls,
        mode_at: Callable[[np.ndarray], int],
        A: Float[np.ndarray, "mode n n"],
        B: Float[np.ndarray, "mode n m"],
        samples: int,
        lengths: tuple[float, ...],
    ) -> SampledMotion:
        tables = [[_to_samples(A[i], B[i], t, samples) for t in lengths] for i in range(len(A))]
        Phi = np.array([[Phi for Phi, _ in row] for row in tables])
        Gamma = np.array([[Gamma for _, Gamma in row] for row in tables])
        return cls(mode_at, A, B, np.array(lengths), Phi, Gamma, _balanced_noise(A, B, lengths))

    def place_of(self, x: np.ndarray) -> int:
        return self.mode_at(x)

    def mode_of(self, place: int) -> int:
        return place

    def _around(self, mode: int, x: np.ndarray, u: np.ndarray) -> set[int]:
        """The modes of states at the distance of the round-off of x in `mode`."""
        M, N = self.noise
        spread = np.diag(M[mode] @ np.abs(x) + N[mode] @ np.abs(u))
        return {self.mode_at(y) for y in np.concatenate((x + spread, x - spread))}

    def _change(self, points: np.ndarray, inputs: np.ndarray, mode: int) -> int:
        """Index of the first point in another mode beyond round-off; −1 if none.

        Each row of inputs has the same number of points.
        """
        mode_at, each = self.mode_at, len(points) // len(inputs)
        for i, point in enumerate(points):
            if mode_at(point) != mode and mode not in self._around(mode, point, inputs[i // each]):
                return i
        return -1

    def _facing(self, mode: int, other: int, x: np.ndarray, u: np.ndarray) -> bool:
        """Whether both modes' fields point at their boundary at x.

        Then the state is in the other mode ahead along the first field and in the first mode behind
        it, and conversely. The nearest such states are taken that are clear of round-off.
        """
        fields = [self.A[i] @ x + self.B[i] @ u for i in (mode, other)]
        for share in _ASIDE:
            ahead = [share * float(self.lengths.max()) * field for field in fields]
            around = [self._around(mode, x + side, u) for a in ahead for side in (a, -a)]
            if all(len(modes) == 1 for modes in around):
                return around == [{other}, {mode}, {mode}, {other}]
        return False

    def _flow(self, mode: int, x: np.ndarray, u: np.ndarray, tau: float) -> np.ndarray:
        from deadtime.numerics.exponential import discretise

        Phi, Gamma = discretise(self.A[mode], self.B[mode], tau)
        return Phi @ x + Gamma @ u

    def _crossing(
        self, mode: int, x: np.ndarray, u: np.ndarray, low: float, high: float
    ) -> tuple[float, np.ndarray, int]:
        """The right end of the bracket of a change in (low, high], with state and mode there."""
        state = self._flow(mode, x, u, high)
        new = self.mode_at(state)
        sharp = _SHARP * high  # relative: a crossing soon after the start has its digits, too
        while high - low > sharp:
            middle = 0.5 * (low + high)
            there = self._flow(mode, x, u, middle)
            mode_there = self.mode_at(there)
            if mode_there == mode:
                low = middle
            else:
                high, state, new = middle, there, mode_there
        return high, state, new

    def advance(
        self, kind: int, x: np.ndarray, place: int, u: np.ndarray, beside: Beside | None = None
    ) -> Move:
        length = float(self.lengths[kind])
        most = most_crossings(self.A, length)
        legs = [Leg(0.0, x, place)]
        mode = place
        start, rest = 0.0, length
        Phi, Gamma = self.Phi[place, kind], self.Gamma[place, kind]
        samples = Phi.shape[0]
        while True:
            points = Phi @ x + Gamma @ u
            change = self._change(points, u[None], mode)
            if change < 0:
                return Move(points[-1], mode, None, legs)
            low, high = rest * change / samples, rest * (change + 1) / samples
            s, x, entered = self._crossing(mode, x, u, low, high)
            start = min(start + s, length)
            rest = length - start
            facing = self._facing(mode, entered, x, u)
            if facing or len(legs) > most:
                chatter = (
                    Chatter.facing(start, mode, entered, length)
                    if facing
                    else Chatter.pile_up(start, mode, entered, length, most)
                )
                end = self._flow(mode, x, u, rest)
                return Move(end, mode, None, legs, chatter)
            mode = entered
            legs.append(Leg(start, x, mode))
            Phi, Gamma = _to_samples(self.A[entered], self.B[entered], rest, samples)

    def hold(self, kind: int, x: np.ndarray, place: int, u: np.ndarray) -> np.ndarray:
        return self.Phi[place, kind, -1] @ x + self.Gamma[place, kind, -1] @ u

    def follow(self, kinds: np.ndarray, inputs: np.ndarray, x: np.ndarray, mode: int) -> Move:
        from deadtime.switching.rules.crossings import path_in_modes

        mode, p = self.place_of(x), 0  # a function determines the mode also on a boundary
        while p < kinds.size:
            path = path_in_modes(self.Phi[mode], self.Gamma[mode], kinds[p:], inputs[p:], x)
            pieces, samples, n = path.shape
            change = self._change(path.reshape(pieces * samples, n), inputs[p:], mode)
            if change < 0:
                return Move(path[-1, -1], mode, None, [])
            before = change // samples
            p += before
            start = path[before - 1, -1] if before else x
            move = self.advance(int(kinds[p]), start, mode, inputs[p])
            if move.chatter is not None:
                earlier = float(self.lengths[kinds[:p]].sum())
                chatter = move.chatter._replace(time=move.chatter.time + earlier)
                return Move(move.x, move.place, None, [], chatter)
            x, mode, p = move.x, move.place, p + 1
        return Move(x, mode, None, [])

    def along(self, leg: Leg, u: np.ndarray, tau: float) -> np.ndarray:
        return self._flow(leg.place, leg.x, u, tau)

    def leads_on(self, x: np.ndarray, beside: Beside, u: np.ndarray) -> bool:
        return False  # nothing slides under a function


def _to_samples(
    A: np.ndarray, B: np.ndarray, length: float, samples: int
) -> tuple[np.ndarray, np.ndarray]:
    """Φ and Γ from the start of a piece to each of its samples."""
    from deadtime.numerics.exponential import discretise

    pairs = [discretise(A, B, length * (i + 1) / samples) for i in range(samples)]
    return np.array([Phi for Phi, _ in pairs]), np.array([Gamma for _, Gamma in pairs])


def _balanced_noise(
    A: np.ndarray, B: np.ndarray, lengths: tuple[float, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """`round_off`, computed in units of the states in which the modes are balanced."""
    from deadtime.numerics.exponential import balance

    unit = balance(np.abs(A).sum(axis=0))
    back = unit[:, None]
    M, N = round_off(A * unit / back, B / back, max(lengths))
    return M * back / unit, N * back
