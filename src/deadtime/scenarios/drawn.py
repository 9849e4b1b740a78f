"""Numbers that imperfections draw in many scenarios, at once where they can, else run by run.

Threads use their memory again: to get new memory costs more than to write into it.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import DTypeLike

from deadtime.imperfections import (
    Disturbance,
    Imperfection,
    ReceivedData,
    Relaying,
    Sizes,
    TimingImperfection,
)
from deadtime.imperfections.base import Drawing, DrawnTiming
from deadtime.imperfections.disturbances import DrawnDisturbance
from deadtime.imperfections.received import DrawnRelaying, relayed
from deadtime.loop.received_samples import lags_of
from deadtime.numerics.generators import Streams
from deadtime.scenarios.source import scenario_seeds


class Rooms(threading.local):
    """Arrays by name, each thread its own; an array is valid until its name is used again.

    Examples
    --------
    >>> rooms = Rooms()
    >>> numbers = rooms.of("numbers", (2, 3))
    >>> rooms.of("numbers", (5,)).shape, np.shares_memory(numbers, rooms.of("numbers", (5,)))
    ((5,), True)
    """

    def __init__(self) -> None:
        self._kept: dict[Hashable, np.ndarray] = {}
        self._inner: dict[Hashable, Rooms] = {}

    def under(self, name: Hashable) -> Rooms:
        """Further arrays, with names of their own."""
        return self._inner.setdefault(name, Rooms())

    def of(
        self, name: Hashable, shape: tuple[int, ...], kind: DTypeLike = np.float64
    ) -> np.ndarray:
        """An array with arbitrary content; a name has one kind of numbers."""
        size, kept = math.prod(shape), self._kept.get(name)
        if kept is None or kept.size < size:
            kept = self._kept[name] = np.empty(size, kind)
        return kept[:size].reshape(shape)


class RunLength(NamedTuple):
    """Periods of the batch, and those over which a single run moves its plant: it draws for all."""

    periods: int
    moved: int


@dataclass(frozen=True, eq=False)
class InManyRuns:
    """An imperfection in many scenarios, with the stream of each.

    Its draws lie in `rooms`, under its name, until it draws again.
    """

    one: Imperfection
    streams: Streams
    rooms: Rooms = field(default_factory=Rooms)
    name: Hashable = ""

    def room(self, sizes: Sizes, samples: int, scenarios: int) -> np.ndarray:
        """Memory for its draws in so many scenarios."""
        shape = scenarios, self._count(sizes, samples) or 0
        return self.rooms.of((self.name, "numbers"), shape)

    def is_fixed(self, sizes: Sizes, samples: int) -> bool:
        """Whether it draws nothing."""
        return self._count(sizes, samples) == 0

    def _count(self, sizes: Sizes, samples: int) -> int | None:
        return self.one.count(sizes, samples) if isinstance(self.one, Drawing) else None

    def numbers(self, first: int, room: np.ndarray) -> np.ndarray:
        """Its draws in the scenarios from `first` on, (scenario, count), or (1, 0) for none."""
        if room.size == 0:
            return room[:1]
        assert isinstance(self.one, Drawing)
        self.streams.draw(first, self.one.normal, room)
        return room

    def relay(
        self, first: int, room: np.ndarray, received: ReceivedData, sizes: Sizes
    ) -> ReceivedData:
        """The measurements received through a sensor in the scenarios from `first` on."""
        one, runs = self.one, len(room)
        if isinstance(one, DrawnRelaying) and _as_we_wrote_it(one, DrawnRelaying, "relay"):
            return one.relay_from(self.numbers(first, room), received, sizes)
        assert isinstance(one, Relaying)
        pairs = zip(received.each(runs), self.streams.generators(first, runs), strict=True)
        each = [relayed(one, run, sizes, rng) for run, rng in pairs]
        return ReceivedData(*map(np.stack, zip(*each, strict=True)))

    def draws(
        self, first: int, runs: int, sizes: Sizes, lengths: tuple[float, ...], run: RunLength
    ) -> np.ndarray:
        """The draws of a disturbance in the scenarios from `first` on, (stretch, one, period, r).

        The axis of scenarios has length 1 where all draw the same; stretches of length 0 are left
        out.
        """
        one, there = self.one, [i for i, length in enumerate(lengths) if length > 0.0]
        if isinstance(one, DrawnDisturbance) and type(one).__module__.startswith("deadtime."):
            before, each = one.counts(sizes)
            shape = len(there), runs, before + each * run.periods
            numbers = self.rooms.of((self.name, "numbers"), shape)
            for i, room in zip(there, numbers, strict=True):
                self._of_stretch(i).draw(first, True, room)
            room_for = partial(self.rooms.of, (self.name, "draws"))
            some = tuple(lengths[i] for i in there)
            return one.draws_from(numbers, sizes, some, run.periods, room_for)
        assert isinstance(one, Disturbance)
        each = [
            one.draws(sizes, lengths, run.moved, rng)[: run.periods, there]
            for rng in self.streams.generators(first, runs)
        ]
        return np.ascontiguousarray(np.stack(each).transpose(2, 0, 1, 3))

    def _of_stretch(self, stretch: int) -> Streams:
        """The streams of a stretch: their own, or what they spawn."""
        if stretch not in self._streams:
            more = self.streams if stretch == 0 else self.streams.spawned_as(stretch - 1)
            self._streams[stretch] = more
        return self._streams[stretch]

    @cached_property
    def _streams(self) -> dict[int, Streams]:
        return {}

    def lags(self, first: int, room: np.ndarray, sizes: Sizes, samples: int) -> np.ndarray:
        """How long before each sample x is measured, (scenario or 1, sample or 1), seconds."""
        one, runs = self.one, len(room)
        if isinstance(one, DrawnTiming) and _as_we_wrote_it(one, DrawnTiming, "lags"):
            return one.lags_from(self.numbers(first, room), sizes, samples)
        assert isinstance(one, TimingImperfection)
        each = [lags_of(one, sizes, samples, rng) for rng in self.streams.generators(first, runs)]
        return np.stack(each)


def _as_we_wrote_it(one: Imperfection, base: type, method: str) -> bool:
    """Whether its method for many runs equals the one for a single run, as for deadtime's own.

    A subclass of the user may change one of the two: its runs are drawn, and checked, one by one.
    """
    own = type(one)
    return own.__module__.startswith("deadtime.") and getattr(own, method) is getattr(base, method)


def in_many_runs(
    imperfections: Sequence[Imperfection],
    kind: type,
    seed: int,
    first: int,
    count: int,
    rooms: Rooms | None = None,
) -> list[InManyRuns]:
    """The imperfections of a kind, in scenarios first, …, first + count − 1 of a seed."""
    rooms = Rooms() if rooms is None else rooms
    seeds, names = scenario_seeds(seed, first, count), [type(one).__name__ for one in imperfections]
    return [
        InManyRuns(one, Streams(seeds, name, names[:place].count(name)), rooms, place)
        for place, (one, name) in enumerate(zip(imperfections, names, strict=True))
        if isinstance(one, kind)
    ]
