"""The measurements and modes that reach a law at all samples of a run, drawn before it.

Which sample's measurement reaches the law, what was added to it and which mode is named in place of
another depend neither on the state nor on the mode. So a whole run of it is drawn at once, for
compiled loops and for many runs, and its sensors are functions of arrays, one after the other.
Imperfections that arrays do not say all of are functions, to be called once a sample.
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

Draw = Callable[[int], np.ndarray]  # from how many samples to what is added in the next ones


class ReceivedData(NamedTuple):
    """The measurements and modes that reach a law at every sample of a run.

    Of many runs, each array has an axis of them in front; axes of length 1 stand for all runs, and
    for all samples of `noise` and `named`.

    sample : (samples,)
        Whose measurement; −1 for none.
    noise : (samples, n)
        What was added to it.
    mode_of : (samples,)
        Whose mode; −1 for none.
    named : (samples, modes)
        What each mode is taken for.

    Examples
    --------
    >>> heard = Heard.perfect(3, Sizes(modes=2, states=1, inputs=1, step=0.1))
    >>> heard.at(np.array([-1, 0, 0])).modes(np.array([1, 0, 0]))
    array([-1,  1,  1])
    """

    sample: Int[np.ndarray, " sample"]
    noise: Float[np.ndarray, "sample n"]
    mode_of: Int[np.ndarray, " sample"]
    named: Int[np.ndarray, "sample mode"]

    @classmethod
    def of_many(cls, samples: int, sizes: Sizes) -> ReceivedData:
        """Every sample of all runs at once and as it is."""
        each, noise = np.arange(samples)[None], np.zeros((1, 1, sizes.states))
        return cls(each, noise, each, np.arange(sizes.modes)[None, None])

    def each(self, runs: int) -> Iterator[ReceivedData]:
        """One for each of so many runs."""
        samples = self.samples
        shapes = [(runs, samples), (runs, samples, self.noise.shape[-1]), (runs, samples)]
        shapes.append((runs, samples, self.named.shape[-1]))
        whole = [np.broadcast_to(part, shape) for part, shape in zip(self, shapes, strict=True)]
        for run in range(runs):
            yield ReceivedData(*(part[run] for part in whole))

    @property
    def samples(self) -> int:
        """How many there are."""
        return self.sample.shape[-1]

    @classmethod
    def perfect(cls, samples: int, sizes: Sizes) -> ReceivedData:
        """Every sample at once and as it is."""
        each, noise = np.arange(samples), np.zeros((samples, sizes.states))
        named = np.broadcast_to(np.arange(sizes.modes), (samples, sizes.modes))
        return cls(each, noise, each, named)

    def at(self, sample: Int[np.ndarray, "*runs sample"]) -> ReceivedData:
        """Those of other samples, one for each; nothing at −1."""
        found = mode_of = self._through(self.sample, sample)
        if self.mode_of is not self.sample:
            mode_of = self._through(self.mode_of, sample)
        noise, named = _of_samples(self.noise, sample), _of_samples(self.named, sample)
        return ReceivedData(found, noise, mode_of, named)

    def _through(self, received: np.ndarray, sample: np.ndarray) -> np.ndarray:
        """Which samples are heard at samples of which these are heard, −1 for none."""
        if (
            received.size == self.samples
            and (received.reshape(-1) == np.arange(self.samples)).all()
        ):
            return sample
        return np.where(sample < 0, -1, at_samples(received, sample))

    def with_modes_of(self, sample: Int[np.ndarray, " sample"]) -> ReceivedData:
        """These measurements with the modes of other samples."""
        mode_of, named = at_samples(self.mode_of, sample), _of_samples(self.named, sample)
        return self._replace(mode_of=mode_of, named=named)

    def modes(self, sampled: Int[np.ndarray, "*runs sample"]) -> Int[np.ndarray, "*runs sample"]:
        """The mode that the law is told at each sample, from σ(t_k); −1 where it is told none."""
        true = at_samples(sampled, self.mode_of)
        if self.named.size == self.named.shape[-1]:  # one row, of all samples and runs
            told = self.named.reshape(-1)[true]
        else:
            told = np.take_along_axis(self.named, true[..., None], -1)[..., 0]
        return np.where(self.mode_of < 0, -1, told)


def at_samples(array: np.ndarray, sample: np.ndarray) -> np.ndarray:
    """Entries of an array (…, samples) at samples, those of all runs or of each.

    At −1 any entry is found.
    """
    if array.shape[-1] == 1:
        return array
    one = sample.reshape(-1) if sample.size == sample.shape[-1] else None
    if one is not None or array.size == array.shape[-1]:
        return array[..., one] if one is not None else array.reshape(-1)[sample]
    if array.ndim == sample.ndim == 2 and len(array) == len(sample):
        # As `take_along_axis` does, in a third of its time.
        begin = array.shape[1] * np.arange(len(array))[:, None]
        return np.take(array.reshape(-1), begin + sample)
    return np.take_along_axis(array, sample, -1)


def _of_samples(rows: np.ndarray, sample: np.ndarray) -> np.ndarray:
    """Rows of an array (…, samples, entries) at samples; one row stands for all."""
    if rows.shape[-2] == 1:
        return rows
    if sample.ndim == 1:
        return rows[..., sample, :]
    return np.take_along_axis(rows, sample[..., None], -2)


class Relaying(ABC):
    """A sensor that asks for no state and no mode.

    A base beside `SensorImperfection`, by which compiled loops know what they can take.
    """

    @abstractmethod
    def relay(self, received: ReceivedData, sizes: Sizes, rng: np.random.Generator) -> ReceivedData:
        """The measurements through it; a longer run of the same numbers begins as a shorter one."""

    @final
    def sensor(self, sizes: Sizes, rng: np.random.Generator) -> Sense:
        """`relay` called once a sample: for a loop beside a sensor that is no `Relaying`."""
        seen: list[Seen] = []
        nothing = np.full(sizes.states, np.nan)

        def draw(samples: int) -> ReceivedData:
            return relayed(self, ReceivedData.perfect(samples, sizes), sizes, copy.deepcopy(rng))

        received = draw(_BLOCK)

        def sense(now: Seen) -> Seen:
            nonlocal received
            k = len(seen)
            seen.append(now)
            if k == received.samples:
                received = draw(2 * k)
            j, i = received.sample[k], received.mode_of[k]
            mode = -1 if i < 0 else seen[i].mode
            return Seen(
                nothing if j < 0 else seen[j].x + received.noise[k],
                -1 if mode < 0 else int(received.named[k, mode]),
            )

        return sense


def relayed(
    by: Relaying, received: ReceivedData, sizes: Sizes, rng: np.random.Generator
) -> ReceivedData:
    """Its measurements; refused where they do not fit, as compiled loops index with them."""
    found = by.relay(received, sizes, rng)
    if type(by).__module__.startswith("deadtime."):
        return found  # tested to fit; looking again would cost a third of drawing it
    _require_fit(f"{type(by).__name__}.relay", found, len(received.sample), sizes)
    kinds = np.int64, float, np.int64, np.int64
    return ReceivedData(*(part.astype(kind) for part, kind in zip(found, kinds, strict=True)))


def _require_fit(name: str, found: object, samples: int, sizes: Sizes) -> None:
    """Refuse what is no `ReceivedData` of so many samples."""
    if not isinstance(found, ReceivedData):
        raise ArgumentError(f"{name} must return a Heard, got {type(found).__name__}.")
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
                f"{array[k]}: a law hears of no later sample."
            )
    if found.named.min(initial=0) < 0 or found.named.max(initial=0) >= sizes.modes:
        raise ArgumentError(
            f"{name} must return named with 0 ≤ named < modes = {sizes.modes}, got numbers from "
            f"{found.named.min()} to {found.named.max()}."
        )


class DrawnRelaying(Drawing, Relaying):
    """A relaying by numbers that are drawn at once, of one run or of many."""

    @abstractmethod
    def relay_from(
        self, numbers: Float[np.ndarray, "*runs count"], received: ReceivedData, sizes: Sizes
    ) -> ReceivedData:
        """The measurements through it in runs that drew these numbers, which it may overwrite."""

    @final
    def relay(self, received: ReceivedData, sizes: Sizes, rng: np.random.Generator) -> ReceivedData:
        return self.relay_from(self.draw(sizes, received.samples, rng), received, sizes)


class Additive(Relaying):
    """A sensor that adds to the measured state, whatever it is, and leaves the mode alone."""

    @abstractmethod
    def sampler(self, sizes: Sizes, rng: np.random.Generator) -> Draw:
        """A function of a count that draws noise (count, n), the same in blocks or one by one."""

    def relay(self, received: ReceivedData, sizes: Sizes, rng: np.random.Generator) -> ReceivedData:
        with np.errstate(over="ignore", invalid="ignore"):
            return received._replace(
                noise=received.noise + self.sampler(sizes, rng)(received.samples)
            )


def is_known(each: Imperfection) -> bool:
    """Whether a compiled loop can take all that it does: each part that it plays counts.

    A sensor or an actuator that is written anew in a subclass is a function again.

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
    """Whether the engine of many scenarios can take all that it does."""
    if isinstance(each, Disturbance) and each.goes_by_mode:
        return False  # within a period that is cut it is no one force
    drawing = (Relaying, TimingImperfection, Disturbance)
    # One that draws as two of these shares a stream between them: no array is each part's alone.
    return is_known(each) and sum(isinstance(each, part) for part in drawing) <= 1
