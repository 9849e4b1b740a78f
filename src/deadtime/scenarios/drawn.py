"""What imperfections draw in many scenarios: at once where they can, run by run where not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deadtime.imperfections import Heard, Imperfection, Relaying, Sizes
from deadtime.imperfections.base import Drawing
from deadtime.imperfections.heard import DrawnRelaying, relayed
from deadtime.numerics.pcg import Streams
from deadtime.scenarios.source import scenario_seeds


@dataclass(frozen=True, eq=False)
class InManyRuns:
    """An imperfection in many scenarios, with the stream of each."""

    one: Imperfection
    streams: Streams

    def room(self, sizes: Sizes, samples: int, scenarios: int) -> np.ndarray:
        """Memory for what it draws in so many scenarios, to be used again for the next ones.

        Fresh memory would cost as much as drawing.
        """
        count = self.one.count(sizes, samples) if isinstance(self.one, Drawing) else 0
        return np.empty((scenarios, count))

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
        if isinstance(one, DrawnRelaying):
            return one.relay_from(self.numbers(first, room), heard, sizes)
        assert isinstance(one, Relaying)
        pairs = zip(heard.each(runs), self.streams.generators(first, runs), strict=True)
        each = [relayed(one, run, sizes, rng) for run, rng in pairs]
        return Heard(*map(np.stack, zip(*each, strict=True)))


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
