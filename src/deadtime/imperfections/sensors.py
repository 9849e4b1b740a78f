"""Sensors: noise, lost and late samples, late and wrong modes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from deadtime.base.checks import count
from deadtime.base.errors import ArgumentError
from deadtime.imperfections.base import SensorImperfection, Sizes, per_signal, probability_of
from deadtime.imperfections.heard import Additive, Draw, Heard, Relaying

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
class Dropout(Relaying, SensorImperfection):
    """Lost samples: the law learns neither x nor σ, and its last input is held.

    A law that measures outputs goes on instead: its observer predicts.

    Parameters
    ----------
    probability : float
        Of each sample, independently.
    """

    probability: float

    def relay(self, heard: Heard, sizes: Sizes, rng: np.random.Generator) -> Heard:
        p = probability_of("Dropout.probability", self.probability)
        each = np.arange(len(heard.noise))
        return heard.at(np.where(rng.random(each.size) < p, -1, each))


@dataclass(frozen=True)
class LateSamples(Relaying, SensorImperfection):
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

    def relay(self, heard: Heard, sizes: Sizes, rng: np.random.Generator) -> Heard:
        late = count("LateSamples.periods", self.periods)
        p = probability_of("LateSamples.probability", self.probability)
        each = np.arange(len(heard.noise))
        delayed = rng.random(each.size) < p
        newest = np.where(delayed, -1, each)
        # Of those that are due at a sample its own is newer, where that is there.
        due = each[: max(0, each.size - late)]
        newest[late:] = np.maximum(newest[late:], np.where(delayed[: due.size], due, -1))
        return heard.at(np.maximum.accumulate(newest))


@dataclass(frozen=True)
class ModeDelay(Relaying, SensorImperfection):
    """Late mode detection: the law is told the mode of some samples ago.

    Parameters
    ----------
    periods : int
        How late, in periods.
    """

    periods: int

    def relay(self, heard: Heard, sizes: Sizes, rng: np.random.Generator) -> Heard:
        periods = count("ModeDelay.periods", self.periods)
        if periods > _MOST:
            raise ArgumentError(f"ModeDelay.periods must be at most {_MOST:,}, got {periods}.")
        then = np.maximum(np.arange(len(heard.noise)) - periods, 0)
        return heard._replace(mode_of=heard.mode_of[then], named=heard.named[then])


@dataclass(frozen=True)
class WrongMode(Relaying, SensorImperfection):
    """Wrong mode detection: the law is told another mode, any with equal probability.

    Parameters
    ----------
    probability : float
        Of each sample, independently.
    """

    probability: float

    def relay(self, heard: Heard, sizes: Sizes, rng: np.random.Generator) -> Heard:
        p, samples = probability_of("WrongMode.probability", self.probability), len(heard.noise)
        others = max(1, sizes.modes - 1)
        drawn = rng.random((samples, min(others, 2)))  # of two modes there is no choice to draw
        wrong, other = drawn[:, 0] < p, np.zeros(samples, np.int64)
        if others > 1:
            other = (drawn[:, 1] * others).astype(np.int64)
        if sizes.modes == 1:
            return heard
        named = other[:, None] + (other[:, None] >= heard.named)
        return heard._replace(named=np.where(wrong[:, None], named, heard.named))
