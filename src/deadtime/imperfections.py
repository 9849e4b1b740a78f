"""What sensors and actuators do to a law: noise, lost and late samples, limits.

A run takes a list of imperfections (`simulate(..., imperfections=[...], seed=0)`), applied in the
order of the list: those of the sensor to what the law is told of x(t_k) and σ(t_k), those of the
actuator to what it asks for. All act at the samples, so the plant between them stays exact. Each
draws from a stream of its own, made from the seed, its kind and how many of its kind come before:
adding one changes nothing that the others draw.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from deadtime.checks import count, instance, number, real_array, shaped
from deadtime.errors import ArgumentError


class Sizes(NamedTuple):
    """What an imperfection must know of its loop; the step in seconds."""

    modes: int
    states: int
    inputs: int
    step: float


class Seen(NamedTuple):
    """What reaches the law at a sample; x is NaN where nothing did."""

    x: np.ndarray
    mode: int


Sense = Callable[[Seen], Seen]
Act = Callable[[np.ndarray, np.ndarray], np.ndarray]  # from u_k as asked and u_{k−1} as applied


class Imperfection(ABC):
    """Something between the law and its plant."""

    kind: ClassVar[int]


class SensorImperfection(Imperfection):
    """Changes what the law is told."""

    @abstractmethod
    def sensor(self, sizes: Sizes, rng: np.random.Generator) -> Sense:
        """A function to be called once a sample, with a memory of its own."""


class ActuatorImperfection(Imperfection):
    """Changes what the plant is given."""

    @abstractmethod
    def actuator(self, sizes: Sizes) -> Act:
        """A function to be called once a sample."""


@dataclass(frozen=True)
class Noise(SensorImperfection):
    """White measurement noise: x + ν, ν normal, independent from sample to sample.

    Parameters
    ----------
    std : array_like
        Standard deviation, a scalar or shape (n,), in the states' units.
    """

    kind: ClassVar[int] = 1
    std: ArrayLike

    def sensor(self, sizes: Sizes, rng: np.random.Generator) -> Sense:
        std = _per_signal("Noise.std", self.std, sizes.states)
        if (std < 0.0).any():
            raise ArgumentError(f"Noise.std must be ≥ 0, got {std.tolist()}.")
        return lambda seen: Seen(seen.x + std * rng.standard_normal(sizes.states), seen.mode)


@dataclass(frozen=True)
class Dropout(SensorImperfection):
    """Lost samples: the law learns neither x nor σ, and its last input is held.

    Parameters
    ----------
    probability : float
        Of each sample, independently.
    """

    kind: ClassVar[int] = 2
    probability: float

    def sensor(self, sizes: Sizes, rng: np.random.Generator) -> Sense:
        p, nothing = (
            _probability("Dropout.probability", self.probability),
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

    kind: ClassVar[int] = 3
    periods: int
    probability: float = 1.0

    def sensor(self, sizes: Sizes, rng: np.random.Generator) -> Sense:
        late = count("LateSamples.periods", self.periods)
        p = _probability("LateSamples.probability", self.probability)
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

    kind: ClassVar[int] = 4
    periods: int

    def sensor(self, sizes: Sizes, rng: np.random.Generator) -> Sense:
        modes: deque[int] = deque(maxlen=count("ModeDelay.periods", self.periods) + 1)

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

    kind: ClassVar[int] = 5
    probability: float

    def sensor(self, sizes: Sizes, rng: np.random.Generator) -> Sense:
        p = _probability("WrongMode.probability", self.probability)

        def sense(seen: Seen) -> Seen:
            wrong, other = rng.random() < p, int(rng.integers(max(1, sizes.modes - 1)))
            if not wrong or seen.mode < 0 or sizes.modes == 1:
                return seen
            return Seen(seen.x, other + (other >= seen.mode))

        return sense


@dataclass(frozen=True)
class Saturation(ActuatorImperfection):
    """Inputs are clipped to [low, high].

    Parameters
    ----------
    low, high : array_like
        Scalars or shape (m,), low < high.
    """

    kind: ClassVar[int] = 6
    low: ArrayLike
    high: ArrayLike

    def actuator(self, sizes: Sizes) -> Act:
        low = _per_signal("Saturation.low", self.low, sizes.inputs)
        high = _per_signal("Saturation.high", self.high, sizes.inputs)
        if (low >= high).any():
            raise ArgumentError(
                f"Saturation must have low < high, got {low.tolist()} and {high.tolist()}."
            )
        return lambda asked, before: np.clip(asked, low, high)


@dataclass(frozen=True)
class RateLimit(ActuatorImperfection):
    """Inputs change by at most `rate`·step from one period to the next.

    Parameters
    ----------
    rate : array_like
        Units of the input per second, a scalar or shape (m,).
    """

    kind: ClassVar[int] = 7
    rate: ArrayLike

    def actuator(self, sizes: Sizes) -> Act:
        most = _per_signal("RateLimit.rate", self.rate, sizes.inputs) * sizes.step
        if (most <= 0.0).any():
            raise ArgumentError(f"RateLimit.rate must be positive, got {self.rate}.")
        return lambda asked, before: np.clip(asked, before - most, before + most)


def streams(imperfections: Sequence[Imperfection], seed: int) -> list[np.random.Generator]:
    """A generator for each, which the presence of the others does not change."""
    seen: dict[int, int] = {}
    result = []
    for one in imperfections:
        instance("imperfections", one, Imperfection)
        place = seen.get(one.kind, 0)
        seen[one.kind] = place + 1
        result.append(np.random.default_rng(np.random.SeedSequence([seed, one.kind, place])))
    return result


def _per_signal(name: str, value: ArrayLike, size: int) -> np.ndarray:
    array = np.asarray(value, dtype=float)
    whole = np.full(size, array) if array.ndim == 0 else array
    return shaped(name, real_array(name, whole, "(size,)", 1), (size,), "(size,)")


def _probability(name: str, value: float) -> float:
    p = number(name, value)
    if not 0.0 <= p <= 1.0:
        raise ArgumentError(f"{name} must be in [0, 1], got {p:g}.")
    return p
