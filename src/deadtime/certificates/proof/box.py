"""The steps of a plant whose delays each range in an interval of their own.

Over a period input c of mode i acts by its sample of lag N until φ and by that of lag N − 1 from
then on, φ in [φ_low, φ_high] whatever the others are. As the plant is linear, the columns of E that
input c reads depend on its own delays only, so E is put together input by input and the order of
different inputs' arrivals does not matter. With a switch from i to j at s, input c goes through

    i, lag N_i  until  τ₁ = min(s, φ_i);    i, lag N_i − 1  until  s;
    j, lag N_j  until  τ₂ = max(s, φ_j);    j, lag N_j − 1  until  h,

and E is smooth in s, τ₁ and τ₂:

    0        τ₁            s        τ₂              h
    |- i, N_i -|- i, N_i − 1 -|- j, N_j -|- j, N_j − 1 -|

The ends of all intervals cut the period in parts, in which the switch falls at s = a + u (b − a).
Over one part every τ has one of three forms, f in [0, 1]:

    the interval before it:    τ₁ = φ,    τ₂ = s,
    the interval after it:     τ₁ = s,    τ₂ = φ,    φ = φ_low + f (φ_high − φ_low),
    or around it:              τ₁ = φ_low + f (s − φ_low),    τ₂ = s + f (φ_high − s),

and the last two reach every possible min(s, φ) and max(s, φ), for s on either side of φ. Floats
decide which of the three is taken; a ball, `TimeNumbers.room`, covers the error of the first two.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.certificates.proof.family import ROUND_OFF, DelayInterval, Steps
from deadtime.plant.plant_set import PlantSet

TOLERANCE = 1e-9  # of a period: marks closer than this are one
# Directions of a cell: the instant of the switch, the polytope, and from here on the delays.
U, POLYTOPE, FIRST = 0, 1, 2


class Order(NamedTuple):
    """A step from a mode to another, its switch in one part of the period; (0, h) for a full one.

    The ends of the part are seconds.
    """

    mode: int
    after: int
    start: float
    stop: float


class InputPiece(NamedTuple):
    """A constant piece of an input within a period.

    The mode, the lag, the end (None: the end of the period), and the derivatives of the end by u
    and the delays, by direction.
    """

    mode: int
    lag: int
    end: Any
    moves: dict[int, Any]


@dataclass(frozen=True, eq=False)
class TimeNumbers:
    """Arithmetic of times: floats for a search, balls for a proof.

    Attributes
    ----------
    number : callable
        A float, exactly.
    phases : callable
        φ_low and φ_high of an interval.
    step : number
        h.
    room : callable
        (a, sign): the interval from 0 to sign · max(0, a); 0 in floats.
    """

    number: Callable[[float], Any]
    phases: Callable[[DelayInterval], tuple[Any, Any]]
    step: Any
    room: Callable[[Any, int], Any]


@dataclass(frozen=True, eq=False)
class Box(Steps):
    """Steps of a plant with each of its delays in an interval, by mode and input."""

    intervals: tuple[tuple[DelayInterval, ...], ...]

    @classmethod
    def of(cls, plants: PlantSet, delays: np.ndarray, step: float) -> Box:
        """The box between the lower and the upper delays, (2, modes, m)."""
        pairs = delays.transpose(1, 2, 0).tolist()
        intervals = tuple(
            tuple(DelayInterval.of(low, high, step) for low, high in row) for row in pairs
        )
        return cls(plants, step, intervals)

    @property
    def ranges(self) -> bool:
        """Whether a delay has a range."""
        return any(one.ranges for row in self.intervals for one in row)

    @property
    def count(self) -> int:
        """N of the longest delay."""
        return max(one.count for row in self.intervals for one in row)

    def _received(self) -> set[tuple[int, int]]:
        # With φ_low = h the delay is N whole periods, and lag N − 1 never acts.
        return {
            (lag, c)
            for row in self.intervals
            for c, one in enumerate(row)
            for lag in ((one.count,) if one.low == self.step else (one.count, one.count - 1))
        }

    @property
    def sound(self) -> bool:
        """Whether all φ lie in a period."""
        return all(0.0 <= one.low <= one.high <= self.step for row in self.intervals for one in row)

    def orders(self, mode: int, after: int) -> list[Order]:
        """The parts of the period that the switch may fall in; all of it for a full step."""
        if mode == after:
            return [Order(mode, after, 0.0, self.step)]
        marks, near = [0.0], TOLERANCE * self.step
        # Ends close to a neighbour are dropped: u of such a part would divide by almost 0.
        ends = {x for i in (mode, after) for one in self.intervals[i] for x in (one.low, one.high)}
        for x in sorted(ends):
            if x - marks[-1] > near and self.step - x > near:
                marks.append(x)
        return [Order(mode, after, a, b) for a, b in pairwise([*marks, self.step])]

    def moving(self, order: Order) -> list[tuple[int, int]]:
        """The delays that a step depends on, (mode, input); directions count on from `FIRST`."""
        i, j, a, b = order
        near = TOLERANCE * self.step
        found = []
        for mode in dict.fromkeys((i, j)):
            for c, one in enumerate(self.intervals[mode]):
                # The switch comes before φ of the first mode, or after φ of the second one.
                unread = i != j and (b <= one.low + near if mode == i else a >= one.high - near)
                if one.ranges and not unread:
                    found.append((mode, c))
        return found

    def shares(
        self, order: Order, instants: tuple[float, float] = (0.0, 1.0)
    ) -> tuple[float, float] | None:
        """The range of u that holds all switches between two fractions of the period, if any."""
        if order.mode == order.after:
            return 0.0, 1.0
        width = order.stop - order.start
        least, most = ((part * self.step - order.start) / width for part in instants)
        # Outwards by more than the rounding error: neighbouring parts overlap and leave no gap.
        wrong = ROUND_OFF + 8.0 * float(np.spacing(self.step)) / width
        least, most = least - wrong, most + wrong
        return (max(0.0, least), min(1.0, most)) if least <= 1.0 and most >= 0.0 else None

    def instant(self, order: Order, u: float) -> float:
        """The fraction of the period at which a switch at u falls."""
        return (order.start + u * (order.stop - order.start)) / self.step

    def place(self, mode: int, after: int, instant: float) -> tuple[Order, float]:
        """The part of the period, and u, of a switch at a fraction of it."""
        orders, s = self.orders(mode, after), instant * self.step
        order = next((one for one in orders if s <= one.stop), orders[-1])
        return order, (s - order.start) / (order.stop - order.start)

    def pieces(
        self, order: Order, c: int, clock: TimeNumbers, u: Any, f: list[Any]
    ) -> list[InputPiece]:
        """The pieces of input c over a step in order of time, at u and at the f of `moving`."""
        directions = {at: k for k, at in enumerate(self.moving(order), FIRST)}
        i, j, a, b = order
        first, last = self.intervals[i][c], self.intervals[j][c]
        if i == j:
            return self._own(first, i, *_phase(first, clock, directions.get((i, c)), f))
        near, start = TOLERANCE * self.step, clock.number(a)
        width = (clock.step if b == self.step else clock.number(b)) - start
        s, by_u = start + u * width, {U: width}
        low, high = clock.phases(first)
        # τ₁ = min(s, φ). `room` widens it by as much as the part exceeds φ_low, in balls.
        if b <= first.low + near:
            before = s + clock.room(start + width - low, -1), by_u
        elif a >= first.high - near:
            phase, moves = _phase(first, clock, directions.get((i, c)), f)
            before = phase + clock.room(high - start, -1), moves
        else:
            k = directions[i, c]
            part = f[k - FIRST]
            before = low + part * (s - low), {U: part * width, k: s - low}
        low, high = clock.phases(last)  # τ₂ = max(s, φ), by the same three forms
        if a >= last.high - near:
            later = s + clock.room(high - start, 1), by_u
        elif b <= last.low + near:
            phase, moves = _phase(last, clock, directions.get((j, c)), f)
            later = phase + clock.room(start + width - low, 1), moves
        else:
            k = directions[j, c]
            part = f[k - FIRST]
            later = s + part * (high - s), {U: (1 - part) * width, k: high - s}
        head = self._own(first, i, *before)
        return [*head[:-1], InputPiece(i, head[-1].lag, s, by_u), *self._own(last, j, *later)]

    def _own(
        self, one: DelayInterval, mode: int, end: Any, moves: dict[int, Any]
    ) -> list[InputPiece]:
        """Lag N until an instant, then N − 1; N alone where the delay fills the period."""
        if one.low == self.step:
            return [InputPiece(mode, one.count, None, {})]
        return [InputPiece(mode, one.count, end, moves), InputPiece(mode, one.count - 1, None, {})]

    def generator(self, mode: int, c: int, lag: int) -> Float[np.ndarray, "vertex k k"]:
        """[[A, b_c in the column of this lag], [0, 0]] of every corner, over x and its reads."""
        return self.arranged(self.plants.entries(mode), c, lag)

    def arranged(self, entries: np.ndarray, c: int, lag: int) -> Float[np.ndarray, "number k k"]:
        """`generator` of each [A B] (number, n, n + m)."""
        n, own = self.states, [lag for lag, j in self.reads if j == c]
        result = np.zeros((len(entries), n + len(own), n + len(own)))
        result[:, :n, :n] = entries[:, :, :n]
        result[:, :n, n + own.index(lag)] = entries[:, :, n + c]
        return result

    def columns(self, c: int) -> list[int]:
        """Where the reads of input c are among the columns of E."""
        return [self.states + at for at, (_, j) in enumerate(self.reads) if j == c]

    def sample(
        self,
        order: Order,
        u: float = 0.0,
        f: float | tuple[float, ...] = 0.0,
        weights: np.ndarray | None = None,
    ) -> Float[np.ndarray, "n k"]:
        """The plant's rows E of x⁺ = E y at one point of the parameters, in floating point."""
        from deadtime.numerics.exponential import discretise

        weights = self._weights(weights)
        floats = TimeNumbers(float, lambda d: (d.low, d.high), self.step, lambda a, sign: 0.0)
        A, B = (np.tensordot(weights, M, 1) for M in (self.plants.A, self.plants.B))
        places = list(f) if isinstance(f, tuple) else [f] * len(self.moving(order))
        n = self.states
        result = np.zeros((n, n + len(self.reads)))
        for c in range(self.plants.sizes[2]):
            now, E = 0.0, np.eye(n, n + len(self.reads))
            for piece in self.pieces(order, c, floats, u, places):
                end = self.step if piece.end is None else piece.end
                Phi, Gamma = discretise(A[piece.mode], B[piece.mode][:, c : c + 1], end - now)
                now, E = end, Phi @ E
                E[:, n + self.reads.index((piece.lag, c))] += Gamma[:, 0]
            # The columns of x are the same for every input, so each may overwrite the last.
            result[:, :n], result[:, self.columns(c)] = E[:, :n], E[:, self.columns(c)]
        return result

    def switches(self, order: Order) -> bool:
        """Whether a step has a switch; a full step has none."""
        return order.mode != order.after

    def ends(self, order: Order) -> list[tuple[float, ...]]:
        """The corners of the delays that a step depends on."""
        return list(product((0.0, 1.0), repeat=len(self.moving(order))))


def _phase(
    one: DelayInterval, clock: TimeNumbers, direction: int | None, f: list[Any]
) -> tuple[Any, dict[int, Any]]:
    low, high = clock.phases(one)
    if direction is None:
        return low, {}
    return low + f[direction - FIRST] * (high - low), {direction: high - low}
