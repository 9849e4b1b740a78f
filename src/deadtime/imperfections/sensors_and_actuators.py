"""Imperfections of sensors (noise; lost, late, wrong samples; timing), and limits of actuators."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from deadtime.base.checks import as_floats, bound, count as whole, not_nan, positive, read_only
from deadtime.base.errors import ArgumentError
from deadtime.imperfections.base import (
    ActuatorImperfection,
    DrawnTiming,
    Imperfection,
    Limiting,
    Limits,
    SensorImperfection,
    Sizes,
    once,
    per_signal,
    probability_of,
)
from deadtime.imperfections.received import Additive, Draw, DrawnRelaying, ReceivedData
from deadtime.numerics.kernels import kernel
from deadtime.numerics.numbers import where

_MOST = 10**9  # periods


@dataclass(frozen=True)
class Noise(DrawnRelaying, Additive, SensorImperfection):
    """White measurement noise: x + ν, ν normal, independent from sample to sample.

    Parameters
    ----------
    std : array_like
        Standard deviation, a scalar or shape (n,), in the units of the states; (p,) for a law that
        measures outputs.
    """

    normal: ClassVar[bool] = True
    words: ClassVar[str] = "noise (std {std})"
    std: ArrayLike

    def count(self, sizes: Sizes, samples: int) -> int:
        return samples * sizes.states

    def relay_from(self, numbers: np.ndarray, received: ReceivedData, sizes: Sizes) -> ReceivedData:
        std, before = self._check(sizes.states), received.noise
        whole = *before.shape[:-2], received.samples, sizes.states
        before = np.broadcast_to(before, whole).reshape(*before.shape[:-2], -1)
        with np.errstate(over="ignore", invalid="ignore"):
            # In place, because the numbers of many runs are a large array, and by rows of
            # samples · n entries, because NumPy is slow along short rows.
            numbers *= np.tile(std, received.samples)
            numbers += before
        return received._replace(noise=numbers.reshape(*numbers.shape[:-1], *whole[-2:]))

    def sampler(self, sizes: Sizes, rng: np.random.Generator) -> Draw:
        std = self._check(sizes.states)
        return lambda count: std * rng.standard_normal((count, sizes.states))

    @once
    def _check(self, n: int) -> np.ndarray:
        std = per_signal("Noise.std", self.std, n)
        if (std < 0.0).any():
            raise ArgumentError(f"Noise.std must be ≥ 0, got {std.tolist()}.")
        return std


@dataclass(frozen=True)
class Dropout(DrawnRelaying, SensorImperfection):
    """Lost samples: neither x nor σ is received, and the last input is held.

    With a law that measures outputs the observer predicts instead.

    Parameters
    ----------
    probability : float
        Of each sample, independently.
    """

    words: ClassVar[str] = "dropout (probability {probability})"
    probability: float

    def count(self, sizes: Sizes, samples: int) -> int:
        return samples

    def relay_from(self, numbers: np.ndarray, received: ReceivedData, sizes: Sizes) -> ReceivedData:
        p = probability_of("Dropout.probability", self.probability)
        return received.at(np.where(numbers < p, -1, np.arange(received.samples)))


@dataclass(frozen=True)
class LateSamples(DrawnRelaying, SensorImperfection):
    """Late samples: the law uses the newest sample that has arrived, as if it were current.

    Parameters
    ----------
    periods : int
        Delay of a late sample, in periods.
    probability : float
        Of each sample, independently; 1 for a constant measurement delay.
    """

    words: ClassVar[str] = "late samples (periods {periods}, probability {probability})"
    periods: int
    probability: float = 1.0

    def count(self, sizes: Sizes, samples: int) -> int:
        return samples

    def relay_from(self, numbers: np.ndarray, received: ReceivedData, sizes: Sizes) -> ReceivedData:
        late = whole("LateSamples.periods", self.periods)
        p = probability_of("LateSamples.probability", self.probability)
        each, delayed = np.arange(received.samples), numbers < p
        newest = np.where(delayed, -1, each)
        # Arriving at sample k: k itself unless it is late, and k − late if that one was late.
        due = each[: max(0, each.size - late)]
        came = np.where(delayed[..., : due.size], due, -1)
        newest[..., late:] = np.maximum(newest[..., late:], came)
        return received.at(np.maximum.accumulate(newest, axis=-1))


@dataclass(frozen=True)
class ModeDelay(DrawnRelaying, SensorImperfection):
    """Mode detection delay: the reported mode is that of some samples ago.

    Parameters
    ----------
    periods : int
        The delay, in periods.
    """

    words: ClassVar[str] = "mode detection delay (periods {periods})"
    periods: int

    def count(self, sizes: Sizes, samples: int) -> int:
        return 0

    def relay_from(self, numbers: np.ndarray, received: ReceivedData, sizes: Sizes) -> ReceivedData:
        periods = whole("ModeDelay.periods", self.periods)
        if periods > _MOST:
            raise ArgumentError(f"ModeDelay.periods must be at most {_MOST:,}, got {periods}.")
        return received.with_modes_of(np.maximum(np.arange(received.samples) - periods, 0))


@dataclass(frozen=True)
class WrongMode(DrawnRelaying, SensorImperfection):
    """Wrong mode detection: another mode is reported, each with equal probability.

    Parameters
    ----------
    probability : float
        Of each sample, independently.
    """

    words: ClassVar[str] = "wrong mode (probability {probability})"
    probability: float

    def count(self, sizes: Sizes, samples: int) -> int:
        return samples * (2 if sizes.modes > 2 else 1)  # with two modes only one is wrong

    def relay_from(self, numbers: np.ndarray, received: ReceivedData, sizes: Sizes) -> ReceivedData:
        p, others = probability_of("WrongMode.probability", self.probability), sizes.modes - 1
        if others == 0:
            return received
        drawn = numbers.reshape(*numbers.shape[:-1], received.samples, 2 if others > 1 else 1)
        wrong, other = drawn[..., 0] < p, np.zeros((), np.int64)
        if others > 1:
            other = (drawn[..., 1] * others).astype(np.int64)
        named = np.empty((*wrong.shape, sizes.modes), np.int64)
        for mode in range(sizes.modes):
            taken = received.named[..., mode]
            # `other` counts the modes without the reported one.
            named[..., mode] = np.where(wrong, other + (other >= taken), taken)
        return received._replace(named=named)


@dataclass(frozen=True)
class MeasurementDelay(DrawnTiming):
    """Measurement delay: x(t_k − d) is received at t_k, nothing before t = d; the mode in time.

    A law whose model has the delay D + d compensates for it: its prediction starts d earlier.

    Parameters
    ----------
    delay : float
        d > 0, seconds, any fraction of the step.
    """

    waits: ClassVar[bool] = True
    words: ClassVar[str] = "measurement delay ({delay} s)"
    delay: float

    def count(self, sizes: Sizes, samples: int) -> int:
        return 0

    def lags_from(self, numbers: np.ndarray, sizes: Sizes, samples: int) -> np.ndarray:
        delay = positive("MeasurementDelay.delay", self.delay)
        return np.full((*numbers.shape[:-1], 1), delay)


@dataclass(frozen=True)
class Jitter(DrawnTiming):
    """Jitter: samples are taken up to `most` seconds early, uniformly, and used as if on time.

    The first sample is taken at time 0.

    Parameters
    ----------
    most : float
        0 < most ≤ step, seconds; beyond a period, samples are late: `LateSamples`.
    """

    waits: ClassVar[bool] = False
    words: ClassVar[str] = "jitter (up to {most} s early)"
    most: float

    def count(self, sizes: Sizes, samples: int) -> int:
        return samples

    def lags_from(self, numbers: np.ndarray, sizes: Sizes, samples: int) -> np.ndarray:
        most = positive("Jitter.most", self.most)
        if most > sizes.step * (1.0 + 1e-9):
            raise ArgumentError(
                f"Jitter.most must be at most one period, {sizes.step:g} s, got {most:g}: samples "
                "that come later are LateSamples."
            )
        return most * numbers


@dataclass(frozen=True)
class Saturation(Limiting, ActuatorImperfection):
    """Input saturation: inputs are clipped to [low, high].

    Parameters
    ----------
    low, high : array_like
        Scalars or shape (m,), low < high; infinite for no limit on a side.
    """

    words: ClassVar[str] = "saturation ({low} to {high})"
    low: ArrayLike
    high: ArrayLike

    def __post_init__(self) -> None:
        super().__post_init__()
        form = "one or (m,)"
        low = not_nan("Saturation.low", as_floats("Saturation.low", self.low, form))
        high = not_nan("Saturation.high", as_floats("Saturation.high", self.high, form))
        if low.ndim and high.ndim and low.shape != high.shape:
            raise ArgumentError(
                f"Saturation must have low and high of one length, got shapes {low.shape} and "
                f"{high.shape}."
            )
        if (low >= high).any():
            raise ArgumentError(
                f"Saturation must have low < high, got {low.tolist()} and {high.tolist()}."
            )

    def limits(self, sizes: Sizes) -> Limits:
        low = bound("Saturation.low", self.low, sizes.inputs)
        high = bound("Saturation.high", self.high, sizes.inputs)
        return Limits(low, high, False)


@dataclass(frozen=True)
class RateLimit(Limiting, ActuatorImperfection):
    """Rate limit: inputs change by at most `rate`·step from one period to the next.

    Parameters
    ----------
    rate : array_like
        Units of the input per second, a scalar or shape (m,).
    """

    words: ClassVar[str] = "rate limit ({rate} per s)"
    rate: ArrayLike

    def limits(self, sizes: Sizes) -> Limits:
        most = per_signal("RateLimit.rate", self.rate, sizes.inputs) * sizes.step
        if (most <= 0.0).any():
            raise ArgumentError(f"RateLimit.rate must be positive, got {self.rate}.")
        return Limits(-most, most, True)


class InputLimits(NamedTuple):
    """The limits of the inputs in their order.

    low, high : (count, m)
    relative : (count,), whether the bounds are of the change from the input applied before
    """

    low: Float[np.ndarray, "limit m"]
    high: Float[np.ndarray, "limit m"]
    relative: Bool[np.ndarray, " limit"]

    @classmethod
    def of(cls, imperfections: Sequence[Imperfection | Limiting], sizes: Sizes) -> InputLimits:
        """The limits among these imperfections."""
        limits = [each.limits(sizes) for each in imperfections if isinstance(each, Limiting)]
        shape = len(limits), sizes.inputs
        return cls(
            read_only(np.reshape([limit.low for limit in limits], shape)),
            read_only(np.reshape([limit.high for limit in limits], shape)),
            read_only(np.array([limit.relative for limit in limits], np.bool_)),
        )


# The arrays are separate arguments: passing an `InputLimits` costs as much as 50 multiply-adds.
@kernel(nogil=True, forceinline=True, _nrt=False)
def limit_input(low, high, relative, i, u, before):
    """The applied input i: u is the commanded one, `before` the one applied in the last period.

    Numbers are floats, or vectors of eight scenarios (`deadtime.numerics.numbers`).
    """
    for j in range(relative.size):
        base = where(relative[j], before, 0.0)
        u = min(max(u, base + low[j, i]), base + high[j, i])
    return u
