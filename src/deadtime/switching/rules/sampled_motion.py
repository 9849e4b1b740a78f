"""Motion under a rule that can only be asked: crossings are looked for at samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deadtime.switching.rules.motion import (
    Arrival,
    Beside,
    Chatter,
    Leg,
    Motion,
    Move,
    most_crossings,
    round_off,
)

_SHARP = 1e-15  # of the time from the last crossing, or the piece's start, to the sample after it
_ASIDE = (1e-8, 1e-6, 1e-4, 1e-2)  # of a piece: how far along a field to ask for the mode


@dataclass(frozen=True, eq=False)
class SampledMotion(Motion):
    """Motion under a rule that can only be asked for the mode of a state; places are modes.

    The rule is asked at `samples` instants of every piece, and again after every crossing; a
    change between two of them is bisected. What enters and leaves a mode between two samples is
    missed. Only a sample that is in another mode together with its surroundings, as wide as its
    round-off, tells of a change.
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
        """The modes of the states that are as far from x as its round-off in `mode`."""
        M, N = self.noise
        spread = np.diag(M[mode] @ np.abs(x) + N[mode] @ np.abs(u))
        return {self.mode_at(y) for y in np.concatenate((x + spread, x - spread))}

    def _change(self, points: np.ndarray, inputs: np.ndarray, mode: int) -> int:
        """Index of the first point that is surely in another mode; −1 if none.

        Each row of inputs leads to as many points.
        """
        mode_at, each = self.mode_at, len(points) // len(inputs)
        for i, point in enumerate(points):
            if mode_at(point) != mode and mode not in self._around(mode, point, inputs[i // each]):
                return i
        return -1

    def _facing(self, mode: int, other: int, x: np.ndarray, u: np.ndarray) -> bool:
        """Whether both modes point at their boundary at x, surely.

        The mode before the crossing leads into the other and comes from itself, and so does the
        other; asked so close that round-off leaves no doubt.
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
        """The right end of the bracket in (low, high] of a change, and state and mode there."""
        state = self._flow(mode, x, u, high)
        new = self.mode_at(state)
        sharp = _SHARP * high
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
                return Move(points[-1], mode, None, legs, None)
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

    def follow(self, kinds: np.ndarray, inputs: np.ndarray, x: np.ndarray, mode: int) -> Arrival:
        from deadtime.switching.rules.crossings import path_in_modes

        mode, p = self.place_of(x), 0  # a function decides on boundaries, too
        while p < kinds.size:
            path = path_in_modes(self.Phi[mode], self.Gamma[mode], kinds[p:], inputs[p:], x)
            pieces, samples, n = path.shape
            change = self._change(path.reshape(pieces * samples, n), inputs[p:], mode)
            if change < 0:
                return Arrival(path[-1, -1], mode, None, None)
            before = change // samples
            p += before
            start = path[before - 1, -1] if before else x
            move = self.advance(int(kinds[p]), start, mode, inputs[p])
            if move.chatter is not None:
                earlier = float(self.lengths[kinds[:p]].sum())
                chatter = move.chatter._replace(time=move.chatter.time + earlier)
                return Arrival(move.x, move.place, None, chatter)
            x, mode, p = move.x, move.place, p + 1
        return Arrival(x, mode, None, None)

    def along(self, leg: Leg, u: np.ndarray, tau: float) -> np.ndarray:
        return self._flow(leg.place, leg.x, u, tau)

    def leads_on(self, x: np.ndarray, beside: Beside, u: np.ndarray) -> bool:
        return False  # never asked: here nothing slides


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
    """`round_off`, found in the units of the states in which the modes are balanced."""
    from deadtime.numerics.exponential import balance

    unit = balance(np.abs(A).sum(axis=0))
    back = unit[:, None]
    M, N = round_off(A * unit / back, B / back, max(lengths))
    return M * back / unit, N * back
