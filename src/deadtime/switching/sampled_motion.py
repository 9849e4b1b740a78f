"""Motion under a rule that can only be asked: crossings are looked for at samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deadtime.switching.motion import Arrival, Chatter, Motion, Move

_SHARP = 1e-15  # of the time from the last crossing, or the piece's start, to the sample after it


@dataclass(frozen=True, eq=False)
class SampledMotion(Motion):
    """Motion under a rule that can only be asked for the mode of a state; places are modes.

    The rule is asked at `samples` instants of every piece, and again after every crossing; a
    change between two of them is bisected. What enters and leaves a mode between two samples is
    missed.
    """

    mode_at: Callable[[np.ndarray], int]
    A: Float[np.ndarray, "mode n n"]
    B: Float[np.ndarray, "mode n m"]
    lengths: Float[np.ndarray, " length"]
    Phi: Float[np.ndarray, "mode length sample n n"]
    Gamma: Float[np.ndarray, "mode length sample n m"]

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
        return cls(mode_at, A, B, np.array(lengths), Phi, Gamma)

    def place_of(self, x: np.ndarray) -> int:
        return self.mode_at(x)

    def mode_of(self, place: int) -> int:
        return place

    def _change(self, points: np.ndarray, mode: int) -> int:
        """Index of the first point that the rule puts into another mode; −1 if none."""
        mode_at = self.mode_at
        for i, point in enumerate(points):
            if mode_at(point) != mode:
                return i
        return -1

    def _flow(self, mode: int, x: np.ndarray, u: np.ndarray, tau: float) -> np.ndarray:
        from deadtime.exponential import held

        Phi, Gamma = held(self.A[mode], self.B[mode], tau)
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
            found = self.mode_at(there)
            if found == mode:
                low = middle
            else:
                high, state, new = middle, there, found
        return high, state, new

    def advance(self, kind: int, x: np.ndarray, place: int, u: np.ndarray) -> Move:
        from deadtime.switching.crossings import INSTANT, MOST

        length = float(self.lengths[kind])
        times: list[float] = []
        modes = [place]
        start, rest = 0.0, length
        Phi, Gamma = self.Phi[place, kind], self.Gamma[place, kind]
        samples = Phi.shape[0]
        while True:
            mode = modes[-1]
            points = Phi @ x + Gamma @ u
            change = self._change(points, mode)
            if change < 0:
                return Move(points[-1], mode, np.array(times), np.array(modes[1:]), None)
            low, high = rest * change / samples, rest * (change + 1) / samples
            s, x, entered = self._crossing(mode, x, u, low, high)
            start = min(start + s, length)
            rest = length - start
            back = len(times) > 0 and entered == modes[-2] and start - times[-1] <= INSTANT * length
            if back or len(times) == MOST:
                if back:
                    times.pop()
                    modes.pop()
                chatter = Chatter.found(start, mode, entered, back, length)
                held = modes[-1]
                end = self._flow(held, x, u, rest)
                return Move(end, held, np.array(times), np.array(modes[1:]), chatter)
            times.append(start)
            modes.append(entered)
            Phi, Gamma = _to_samples(self.A[entered], self.B[entered], rest, samples)

    def hold(self, kind: int, x: np.ndarray, place: int, u: np.ndarray) -> np.ndarray:
        return self.Phi[place, kind, -1] @ x + self.Gamma[place, kind, -1] @ u

    def follow(self, kinds: np.ndarray, inputs: np.ndarray, x: np.ndarray) -> Arrival:
        from deadtime.switching.crossings import frozen_path

        mode, p = self.place_of(x), 0
        while p < kinds.size:
            path = frozen_path(self.Phi[mode], self.Gamma[mode], kinds[p:], inputs[p:], x)
            pieces, samples, n = path.shape
            change = self._change(path.reshape(pieces * samples, n), mode)
            if change < 0:
                return Arrival(path[-1, -1], mode, None)
            before = change // samples
            p += before
            start = path[before - 1, -1] if before else x
            move = self.advance(int(kinds[p]), start, mode, inputs[p])
            if move.chatter is not None:
                earlier = float(self.lengths[kinds[:p]].sum())
                chatter = move.chatter._replace(time=move.chatter.time + earlier)
                return Arrival(move.x, move.place, chatter)
            x, mode, p = move.x, move.place, p + 1
        return Arrival(x, mode, None)


def _to_samples(
    A: np.ndarray, B: np.ndarray, length: float, samples: int
) -> tuple[np.ndarray, np.ndarray]:
    """Φ and Γ from the start of a piece to each of its samples."""
    from deadtime.exponential import held

    pairs = [held(A, B, length * (i + 1) / samples) for i in range(samples)]
    return np.array([Phi for Phi, _ in pairs]), np.array([Gamma for _, Gamma in pairs])
