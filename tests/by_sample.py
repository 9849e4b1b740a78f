"""The library's sensors as a user would write them, sample by sample: a second method.

Beside one of these the law is called once a period, and so is every other imperfection.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from deadtime.imperfections import (
    Dropout,
    Imperfection,
    LateSamples,
    ModeDelay,
    Noise,
    Seen,
    SensorImperfection,
    WrongMode,
)


def noise(kind, sizes, rng):
    std = np.broadcast_to(kind.std, sizes.states)
    return lambda seen: Seen(seen.x + std * rng.standard_normal(sizes.states), seen.mode)


def dropout(kind, sizes, rng):
    nothing = Seen(np.full(sizes.states, math.nan), -1)
    return lambda seen: nothing if rng.random() < kind.probability else seen


def late_samples(kind, sizes, rng):
    on_their_way = deque()
    newest, now = (-1, Seen(np.full(sizes.states, math.nan), -1)), 0

    def sense(seen):
        nonlocal newest, now
        arrival = now + kind.periods if rng.random() < kind.probability else now
        on_their_way.append((arrival, now, seen))
        for entry in [one for one in on_their_way if one[0] <= now]:
            on_their_way.remove(entry)
            if entry[1] > newest[0]:
                newest = entry[1:]
        now += 1
        return newest[1]

    return sense


def mode_delay(kind, sizes, rng):
    modes = deque(maxlen=kind.periods + 1)

    def sense(seen):
        modes.append(seen.mode)
        return Seen(seen.x, modes[0])

    return sense


def wrong_mode(kind, sizes, rng):
    def sense(seen):
        wrong, others = rng.random() < kind.probability, max(1, sizes.modes - 1)
        other = 0 if others == 1 else int(rng.random() * others)
        if not wrong or seen.mode < 0 or sizes.modes == 1:
            return seen
        return Seen(seen.x, other + (other >= seen.mode))

    return sense


SENSORS = {
    Noise: noise,
    Dropout: dropout,
    LateSamples: late_samples,
    ModeDelay: mode_delay,
    WrongMode: wrong_mode,
}


@dataclass(frozen=True)
class BySample(SensorImperfection):
    """What a sensor of the library does, by a function that is called once a sample."""

    kind: Imperfection

    def sensor(self, sizes, rng):
        return SENSORS[type(self.kind)](self.kind, sizes, rng)


def by_sample(kind):
    """A sensor as a user would write it; any other imperfection as it is."""
    return BySample(kind) if type(kind) in SENSORS else kind
