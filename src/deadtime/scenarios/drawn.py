"""What imperfections draw in many scenarios: at once where they can, run by run where not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deadtime.imperfections import Heard, Imperfection, Relaying, Sizes, TimingImperfection
from deadtime.imperfections.base import Drawing, DrawnTiming
from deadtime.imperfections.heard import DrawnRelaying, relayed
from deadtime.numerics.pcg import Streams
from deadtime.scenarios.source import scenario_seeds
from deadtime.simulation.compiled import lags_of


@dataclass(frozen=True, eq=False)
class InManyRuns:
    """An imperfection in many scenarios, with the stream of each."""

    one: Imperfection
    streams: Streams

    def room(self, sizes: Sizes, samples: int, scenarios: int) -> np.ndarray:
        """Memory for what it draws in so many scenarios, to be used again for the next ones.

        Fresh memory would cost as much as drawing.
        """
        return np.empty((scenarios, self._count(sizes, samples) or 0))

    def is_fixed(self, sizes: Sizes, samples: int) -> bool:
        """Whether it does the same in all scenarios."""
        return self._count(sizes, samples) == 0

    def _count(self, sizes: Sizes, samples: int) -> int | None:
        return self.one.count(sizes, samples) if isinstance(self.one, Drawing) else None

    def numbers(self, first: int, room: np.ndarray) -> np.ndarray:
        """What it draws in the scenarios from `first` on, (scenario, count), (1, 0) for nothing."""
        if room.size == 0:
            return room[:1]
        assert isinstance(self.one, Drawing)
        self.streams.draw(first, self.one.normal, room)
        return room

    def relay(self, first: int, room: np.ndarray, heard: Heard, sizes: Sizes) -> Heard:
        """What is heard through a sensor in the scenarios from `first` on."""
        one, runs = self.one, len(room)
        if isinstance(one, DrawnRelaying) and _as_we_wrote_it(one, DrawnRelaying, "relay"):
            return one.relay_from(self.numbers(first, room), heard, sizes)
        assert isinstance(one, Relaying)
        pairs = zip(heard.each(runs), self.streams.generators(first, runs), strict=True)
        each = [relayed(one, run, sizes, rng) for run, rng in pairs]
        return Heard(*map(np.stack, zip(*each, strict=True)))

    def lags(self, first: int, room: np.ndarray, sizes: Sizes, samples: int) -> np.ndarray:
        """How long before each sample x is measured, (scenario or 1, sample or 1), seconds."""
        one, runs = self.one, len(room)
        if isinstance(one, DrawnTiming) and _as_we_wrote_it(one, DrawnTiming, "lags"):
            return one.lags_from(self.numbers(first, room), sizes, samples)
        assert isinstance(one, TimingImperfection)
        each = [lags_of(one, sizes, samples, rng) for rng in self.streams.generators(first, runs)]
        return np.stack(each)


def _as_we_wrote_it(one: Imperfection, base: type, method: str) -> bool:
    """Whether it answers for many runs what it does for one; others' answers are checked singly."""
    own = type(one)
    return own.__module__.startswith("deadtime.") and getattr(own, method) is getattr(base, method)


def in_many_runs(
    imperfections: Sequence[Imperfection], kind: type, seed: int, first: int, count: int
) -> list[InManyRuns]:
    """Those of a kind, in their order, in the scenarios first, …, first + count − 1 of a seed."""
    seeds, names = scenario_seeds(seed, first, count), [type(one).__name__ for one in imperfections]
    return [
        InManyRuns(one, Streams(seeds, name, names[:place].count(name)))
        for place, (one, name) in enumerate(zip(imperfections, names, strict=True))
        if isinstance(one, kind)
    ]
