"""The measurements and modes that reach a law at all samples of a run, drawn before it.

The received sample, its noise and wrong mode reports depend neither on the state nor on the mode.
So they are drawn for a whole run in advance, as compiled loops and batches need, and these sensors
are functions of arrays, applied one after the other. Sensors that depend on the state are functions
that are called once a sample.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import brief
from deadtime.base.errors import ArgumentError
from deadtime.imperfections.base import (
    ActuatorImperfection,
    Disturbance,
    Drawing,
    Imperfection,
    Limiting,
    Seen,
    Sense,
    SensorImperfection,
    Sizes,
    TimingImperfection,
)

_BLOCK = 64  # samples

Draw = Callable[[int], np.ndarray]  # from a number of samples to the noise of the next ones


class ReceivedData(NamedTuple):
    """The measurements and modes that reach a law at every sample of a run.

    For many runs, each array has an axis of runs in front; axes of length 1 stand for all runs, and
    for all samples of `noise` and `named`.

    sample : (samples,)
        The sample whose measurement is received; −1 for none.
    noise : (samples, n)
        The noise of that measurement.
    mode_of : (samples,)
        The sample whose mode is reported; −1 for none.
    named : (samples, modes)
        The mode that is reported for each true one.

    Examples
    --------
    >>> received = ReceivedData.perfect(3, Sizes(modes=2, states=1, inputs=1, step=0.1))
    >>> received.at(np.array([-1, 0, 0])).modes(np.array([1, 0, 0]))
    array([-1,  1,  1])
    """

    sample: Int[np.ndarray, " sample"]
    noise: Float[np.ndarray, "sample n"]
    mode_of: Int[np.ndarray, " sample"]
    named: Int[np.ndarray, "sample mode"]

    @classmethod
    def of_many(cls, samples: int, sizes: Sizes) -> ReceivedData:
        """Perfect measurements of many runs, as one for all of them."""
        each, noise = np.arange(samples)[None], np.zeros((1, 1, sizes.states))
        return cls(each, noise, each, np.arange(sizes.modes)[None, None])

    def each(self, runs: int) -> Iterator[ReceivedData]:
        """The data of each run."""
        samples = self.samples
        shapes = [(runs, samples), (runs, samples, self.noise.shape[-1]), (runs, samples)]
        shapes.append((runs, samples, self.named.shape[-1]))
        whole = [np.broadcast_to(part, shape) for part, shape in zip(self, shapes, strict=True)]
        for run in range(runs):
            yield ReceivedData(*(part[run] for part in whole))

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.sample.shape[-1]

    @classmethod
    def perfect(cls, samples: int, sizes: Sizes) -> ReceivedData:
        """Perfect measurements of one run: no delay, noise, loss or error."""
        each, noise = np.arange(samples), np.zeros((samples, sizes.states))
        named = np.broadcast_to(np.arange(sizes.modes), (samples, sizes.modes))
        return cls(each, noise, each, named)

    def at(self, sample: Int[np.ndarray, "*runs sample"]) -> ReceivedData:
        """This data behind a further sensor, which passes on sample[k] at k; −1 for none."""

        def through(received: np.ndarray) -> np.ndarray:
            all_received = np.arange(self.samples)
            if received.size == self.samples and (received.reshape(-1) == all_received).all():
                return sample
            return np.where(sample < 0, -1, at_samples(received, sample))

        source = through(self.sample)
        mode_of = source if self.mode_of is self.sample else through(self.mode_of)
        noise, named = _of_samples(self.noise, sample), _of_samples(self.named, sample)
        return ReceivedData(source, noise, mode_of, named)

    def with_modes_of(self, sample: Int[np.ndarray, " sample"]) -> ReceivedData:
        """These measurements with the modes of other samples."""
        mode_of, named = at_samples(self.mode_of, sample), _of_samples(self.named, sample)
        return self._replace(mode_of=mode_of, named=named)

    def modes(self, sampled: Int[np.ndarray, "*runs sample"]) -> Int[np.ndarray, "*runs sample"]:
        """The reported mode at each sample, from σ(t_k); −1 for none."""
        true = at_samples(sampled, self.mode_of)
        if self.named.size == self.named.shape[-1]:  # one row for all samples and runs
            reported = self.named.reshape(-1)[true]
        else:
            reported = np.take_along_axis(self.named, true[..., None], -1)[..., 0]
        return np.where(self.mode_of < 0, -1, reported)


def at_samples(array: np.ndarray, sample: np.ndarray) -> np.ndarray:
    """Entries of an array (…, samples) at samples, the same for all runs or one row per run.

    At −1 the entry is arbitrary.
    """
    if array.shape[-1] == 1:
        return array
    one = sample.reshape(-1) if sample.size == sample.shape[-1] else None
    if one is not None or array.size == array.shape[-1]:
        return array[..., one] if one is not None else array.reshape(-1)[sample]
    if array.ndim == sample.ndim == 2 and len(array) == len(sample):
        # `take` of the flat array: a third of the time of `take_along_axis`.
        begin = array.shape[1] * np.arange(len(array))[:, None]
        return np.take(array.reshape(-1), begin + sample)
    return np.take_along_axis(array, sample, -1)


def _of_samples(rows: np.ndarray, sample: np.ndarray) -> np.ndarray:
    """Rows of an array (…, samples, entries) at samples; a single row stands for all."""
    if rows.shape[-2] == 1:
        return rows
    if sample.ndim == 1:
        return rows[..., sample, :]
    return np.take_along_axis(rows, sample[..., None], -2)


class Relaying(ABC):
    """A sensor that depends neither on the state nor on the mode, which compiled loops support.

    It is a second base beside `SensorImperfection`.
    """

    @abstractmethod
    def relay(self, received: ReceivedData, sizes: Sizes, rng: np.random.Generator) -> ReceivedData:
        """The data behind the sensor; a longer run from the same generator continues a shorter."""

    @final
    def sensor(self, sizes: Sizes, rng: np.random.Generator) -> Sense:
        """`relay` as a function per sample, for a loop with other sensors that are functions."""
        seen: list[Seen] = []
        lost = np.full(sizes.states, np.nan)

        def draw(samples: int) -> ReceivedData:
            return relayed(self, ReceivedData.perfect(samples, sizes), sizes, copy.deepcopy(rng))

        received = draw(_BLOCK)

        def sense(now: Seen) -> Seen:
            nonlocal received
            # Twice as many samples at a time: each draw starts again from the same generator.
            k = len(seen)
            seen.append(now)
            if k == received.samples:
                received = draw(2 * k)
            j, i = received.sample[k], received.mode_of[k]
            mode = -1 if i < 0 else seen[i].mode
            return Seen(
                lost if j < 0 else seen[j].x + received.noise[k],
                -1 if mode < 0 else int(received.named[k, mode]),
            )

        return sense


def relayed(
    by: Relaying, received: ReceivedData, sizes: Sizes, rng: np.random.Generator
) -> ReceivedData:
    """The data behind a sensor; refused where it does not fit, as compiled loops index with it."""
    found = by.relay(received, sizes, rng)
    if type(by).__module__.startswith("deadtime."):
        return found  # covered by tests; checking takes a third of the time of drawing
    name, samples = f"{type(by).__name__}.relay", len(received.sample)
    if not isinstance(found, ReceivedData):
        raise ArgumentError(f"{name} must return ReceivedData, got {type(found).__name__}.")
    each, one = np.arange(samples), (samples,)
    shapes = one, (samples, sizes.states), one, (samples, sizes.modes)
    for field, array, shape in zip(ReceivedData._fields, found, shapes, strict=True):
        words, kinds = ("floats", "f") if field == "noise" else ("integers", "iu")
        if not isinstance(array, np.ndarray):
            raise ArgumentError(f"{name} must return arrays, got {field} = {brief(array)}.")
        if array.dtype.kind not in kinds or array.shape != shape:
            raise ArgumentError(
                f"{name} must return {field} as {words} of shape {shape}, got {array.dtype} of "
                f"shape {array.shape}."
            )
    for field, array in (("sample", found.sample), ("mode_of", found.mode_of)):
        wrong = (array < -1) | (array > each)
        if wrong.any():
            k = int(wrong.argmax())
            raise ArgumentError(
                f"{name} must return {field} with −1 ≤ {field}[k] ≤ k, got {field}[{k}] = "
                f"{array[k]}: no later sample has been taken."
            )
    if found.named.min(initial=0) < 0 or found.named.max(initial=0) >= sizes.modes:
        raise ArgumentError(
            f"{name} must return named with 0 ≤ named < modes = {sizes.modes}, got numbers from "
            f"{found.named.min()} to {found.named.max()}."
        )
    types = np.int64, float, np.int64, np.int64
    return ReceivedData(*(part.astype(kind) for part, kind in zip(found, types, strict=True)))


class DrawnRelaying(Drawing, Relaying):
    """A `Relaying` from random numbers that are drawn in advance, for one run or for many."""

    @abstractmethod
    def relay_from(
        self, numbers: Float[np.ndarray, "*runs count"], received: ReceivedData, sizes: Sizes
    ) -> ReceivedData:
        """The data behind the sensor from these random numbers, which may be overwritten."""

    @final
    def relay(self, received: ReceivedData, sizes: Sizes, rng: np.random.Generator) -> ReceivedData:
        return self.relay_from(self.draw(sizes, received.samples, rng), received, sizes)


class Additive(Relaying):
    """A sensor that adds noise to the measured state and does not change the mode."""

    @abstractmethod
    def sampler(self, sizes: Sizes, rng: np.random.Generator) -> Draw:
        """A function of a count that draws noise (count, n), the same in blocks or one by one."""

    def relay(self, received: ReceivedData, sizes: Sizes, rng: np.random.Generator) -> ReceivedData:
        with np.errstate(over="ignore", invalid="ignore"):
            return received._replace(
                noise=received.noise + self.sampler(sizes, rng)(received.samples)
            )


def is_known(each: Imperfection) -> bool:
    """Whether compiled loops support an imperfection: its sensor and its actuator.

    They do not if a subclass overrides `sensor` or `actuator`.

    Examples
    --------
    >>> from deadtime.imperfections import Noise
    >>> class Squared(Noise):
    ...     def sensor(self, sizes, rng):
    ...         return lambda seen: seen._replace(x=seen.x**2)
    >>> is_known(Noise(0.1)), is_known(Squared(0.1))
    (True, False)
    """
    if isinstance(each, SensorImperfection) and not (
        isinstance(each, Relaying) and type(each).sensor is Relaying.sensor
    ):
        return False
    return not isinstance(each, ActuatorImperfection) or (
        isinstance(each, Limiting) and type(each).actuator is Limiting.actuator
    )


def is_batched(each: Imperfection) -> bool:
    """Whether the batch engine supports an imperfection."""
    if isinstance(each, Disturbance) and each.depends_on_mode:
        return False  # the force changes within a period
    drawing = (Relaying, TimingImperfection, Disturbance)
    # One that is two of these draws both from one stream, in turns, and not in an array for each.
    return is_known(each) and sum(isinstance(each, part) for part in drawing) <= 1
