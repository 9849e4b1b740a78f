"""Sensors: noise, lost and late samples, late and wrong modes."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from deadtime.base.checks import count
from deadtime.base.errors import ArgumentError
from deadtime.imperfections.base import (
    Additive,
    Draw,
    Seen,
    Sense,
    SensorImperfection,
    Sizes,
    per_signal,
    probability_of,
)

_MOST = 10**9  # periods


@dataclass(frozen=True)
class Noise(Additive, SensorImperfection):
    """White measurement noise: x + ν, ν normal, independent from sample to sample.

    Parameters
    ----------
    std : array_like
        Standard deviation, a scalar or shape (n,), in the states' units; (p,) for a law that
        measures outputs.
    """

    std: ArrayLike

    def sampler(self, sizes: Sizes, rng: np.random.Generator) -> Draw:
        std = per_signal("Noise.std", self.std, sizes.states)
        if (std < 0.0).any():
            raise ArgumentError(f"Noise.std must be ≥ 0, got {std.tolist()}.")
        return lambda count: std * rng.standard_normal((count, sizes.states))


@dataclass(frozen=True)
class Dropout(SensorImperfection):
    """Lost samples: the law learns neither x nor σ, and its last input is held.

    A law that measures outputs goes on instead: its observer predicts.

    Parameters
    ----------
    probability : float
        Of each sample, independently.
    """

    probability: float

    def sensor(self, sizes: Sizes, rng: np.random.Generator) -> Sense:
        p, nothing = (
            probability_of("Dropout.probability", self.probability),
            np.full(sizes.states, math.nan),
        )
        return lambda seen: Seen(nothing, -1) if rng.random() < p else seen


@dataclass(frozen=True)
class LateSamples(SensorImperfection):
    """Samples that come late: the law uses the newest that has arrived, as if it were fresh.

    Parameters
    ----------
    periods : int
        How late, in periods.
    probability : float
        Of each sample, independently; 1 for a constant measurement delay.
    """

    periods: int
    probability: float = 1.0

    def sensor(self, sizes: Sizes, rng: np.random.Generator) -> Sense:
        late = count("LateSamples.periods", self.periods)
        p = probability_of("LateSamples.probability", self.probability)
        on_their_way: deque[tuple[int, int, Seen]] = deque()
        newest, now = (-1, Seen(np.full(sizes.states, math.nan), -1)), 0

        def sense(seen: Seen) -> Seen:
            nonlocal newest, now
            arrival = now + late if rng.random() < p else now
            on_their_way.append((arrival, now, seen))
            for entry in [one for one in on_their_way if one[0] <= now]:
                on_their_way.remove(entry)
                if entry[1] > newest[0]:
                    newest = entry[1:]
            now += 1
            return newest[1]

        return sense


@dataclass(frozen=True)
class ModeDelay(SensorImperfection):
    """Late mode detection: the law is told the mode of some samples ago.

    Parameters
    ----------
    periods : int
        How late, in periods.
    """

    periods: int

    def sensor(self, sizes: Sizes, rng: np.random.Generator) -> Sense:
        periods = count("ModeDelay.periods", self.periods)
        if periods > _MOST:
            raise ArgumentError(f"ModeDelay.periods must be at most {_MOST:,}, got {periods}.")
        modes: deque[int] = deque(maxlen=periods + 1)

        def sense(seen: Seen) -> Seen:
            modes.append(seen.mode)
            return Seen(seen.x, modes[0])

        return sense


@dataclass(frozen=True)
class WrongMode(SensorImperfection):
    """Wrong mode detection: the law is told another mode, any with equal probability.

    Parameters
    ----------
    probability : float
        Of each sample, independently.
    """

    probability: float

    def sensor(self, sizes: Sizes, rng: np.random.Generator) -> Sense:
        p = probability_of("WrongMode.probability", self.probability)

        def sense(seen: Seen) -> Seen:
            wrong, other = rng.random() < p, int(rng.integers(max(1, sizes.modes - 1)))
            if not wrong or seen.mode < 0 or sizes.modes == 1:
                return seen
            return Seen(seen.x, other + (other >= seen.mode))

        return sense
