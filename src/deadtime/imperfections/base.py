"""The interfaces of imperfections, and the sizes of a loop."""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any, ClassVar, NamedTuple, TypeVar, final

import numpy as np
from numpy.typing import ArrayLike

from deadtime.base.checks import as_floats, instance, number, real_array, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.numerics.streams import stream
from deadtime.plant import SwitchedSystem


class Sizes(NamedTuple):
    """The sizes of a loop, and its step in seconds."""

    modes: int
    states: int
    inputs: int
    step: float

    @classmethod
    def of(cls, plant: SwitchedSystem, step: float) -> Sizes:
        """The sizes of a plant under a law that measures the whole state."""
        return cls(plant.modes, plant.states, plant.inputs, step)


class Seen(NamedTuple):
    """The state and mode that reach the law at a sample; x is NaN if the sample is lost."""

    x: np.ndarray
    mode: int


Sense = Callable[[Seen], Seen]
Act = Callable[[np.ndarray, np.ndarray], np.ndarray]  # (u_k commanded, u_{k−1} applied) -> applied
Piece = tuple[np.ndarray, float]  # A and its duration, seconds


class Limits(NamedTuple):
    """Bounds (m,) of the inputs or, if relative, of their change since the last period."""

    low: np.ndarray
    high: np.ndarray
    relative: bool


Checked = TypeVar("Checked")
Size = TypeVar("Size", int, Sizes)


class Imperfection(Frozen, ABC):
    """A deviation of the loop from the ideal one.

    `words` is its text for sentences, with the names of its fields in braces; its repr by default.

    Examples
    --------
    >>> from deadtime.imperfections import Dropout, Noise
    >>> Dropout(1 / 30).in_words, Noise([0.1, 0.2]).in_words
    ('dropout (probability 0.0333333)', 'noise (std [0.1, 0.2])')
    """

    words: ClassVar[str] = ""

    @property
    def in_words(self) -> str:
        """Its name and numbers for headings and sentences."""
        if not self.words:
            return repr(self)
        own: Any = self
        return self.words.format(
            **{one.name: number_text(getattr(self, one.name)) for one in fields(own)}
        )


def number_text(value: ArrayLike) -> str:
    """A number to six digits, or nested lists of such."""
    given = np.asarray(value)
    return f"{given:.6g}" if given.ndim == 0 else f"[{', '.join(map(number_text, given))}]"


class Drawing(ABC):
    """A part that draws all random numbers of a run in advance, as batches need.

    They are standard normal if `normal`, else uniform on [0, 1).
    """

    normal: ClassVar[bool] = False

    @abstractmethod
    def count(self, sizes: Sizes, samples: int) -> int:
        """Number of random numbers of a run."""

    @final
    def draw(self, sizes: Sizes, samples: int, rng: np.random.Generator) -> np.ndarray:
        """The numbers of one run."""
        size = self.count(sizes, samples)
        return rng.standard_normal(size) if self.normal else rng.random(size)


class SensorImperfection(Imperfection):
    """Changes the measurements; one that does not depend on the state is a `Relaying`, too."""

    @abstractmethod
    def sensor(self, sizes: Sizes, rng: np.random.Generator) -> Sense:
        """A function from the true to the received state and mode, called once a sample."""


class TimingImperfection(Imperfection):
    """Changes when the state is measured.

    For a measurement instant before 0 the sample is lost if `waits`, else x(0) is measured.
    """

    waits: ClassVar[bool]

    @abstractmethod
    def lags(self, sizes: Sizes, samples: int, rng: np.random.Generator) -> np.ndarray:
        """The time from the measurement of x to each sample, seconds (samples,)."""


class DrawnTiming(Drawing, TimingImperfection):
    """Timing from random numbers that are drawn in advance, for one run or for many."""

    @abstractmethod
    def lags_from(self, numbers: np.ndarray, sizes: Sizes, samples: int) -> np.ndarray:
        """Lags (runs, samples) from random numbers (runs, count), or those of one run.

        An axis of length 1 stands for all runs or samples.
        """

    @final
    def lags(self, sizes: Sizes, samples: int, rng: np.random.Generator) -> np.ndarray:
        lags = self.lags_from(self.draw(sizes, samples, rng), sizes, samples)
        return np.broadcast_to(lags, (samples,)).copy()


class ActuatorImperfection(Imperfection):
    """Changes the commanded input."""

    @abstractmethod
    def actuator(self, sizes: Sizes) -> Act:
        """A function to the applied input, called once a sample."""


class Limiting(ABC):
    """An actuator that clips the input: a second base beside `ActuatorImperfection`."""

    @abstractmethod
    def limits(self, sizes: Sizes) -> Limits:
        """The bounds of the input."""

    @final
    def actuator(self, sizes: Sizes) -> Act:
        low, high, relative = self.limits(sizes)
        if relative:
            return lambda u, before: np.minimum(np.maximum(u, before + low), before + high)
        return lambda u, before: np.minimum(np.maximum(u, low), high)


class Disturbance(Imperfection):
    """A force on the plant: dx/dt = A x + B u(t − D) + w(t), whatever the law does."""

    @abstractmethod
    def draws(
        self, sizes: Sizes, lengths: tuple[float, ...], steps: int, rng: np.random.Generator
    ) -> np.ndarray:
        """Random numbers (steps, lengths, r) for stretches of these lengths, s, in each period."""

    @abstractmethod
    def spread(self, sizes: Sizes, pieces: Sequence[Piece]) -> np.ndarray:
        """(n, r): from the numbers of a stretch to the change of x by w over its pieces."""

    @property
    def depends_on_mode(self) -> bool:
        """Whether w is a force of the mode, then given by `force_by_mode`."""
        return False

    def force_by_mode(self, sizes: Sizes) -> np.ndarray | None:
        """c (modes, n) if w is c_σ times a single number, else None."""
        return None


class Stacked(ABC):
    """A disturbance with vectorised `spreads`: a second base beside `Disturbance`."""

    @abstractmethod
    def spreads(self, sizes: Sizes, A: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """`Disturbance.spread` of many stretches, (count, n, r).

        A (count, pieces, n, n) lasts tau (count, pieces) seconds, 0 where there are fewer pieces.
        """

    @final
    def spread(self, sizes: Sizes, pieces: Sequence[Piece]) -> np.ndarray:
        A, tau = (np.array(part, float)[None] for part in zip(*pieces, strict=True))
        return self.spreads(sizes, A, tau)[0]


def streams(imperfections: Sequence[Imperfection], seed: int) -> list[np.random.Generator]:
    """A generator for each imperfection, independent of the other ones in the list."""
    if not isinstance(imperfections, Sequence) or isinstance(imperfections, str):
        raise ArgumentError(
            f"imperfections must be a list of imperfections, got {type(imperfections).__name__}."
        )
    for each in imperfections:
        instance("imperfections", each, Imperfection)
    # Numbered within the class, so that one of another class changes no stream.
    names = [type(each).__name__ for each in imperfections]
    return [stream(seed, name, names[:place].count(name)) for place, name in enumerate(names)]


def require(one: Imperfection, sizes: Sizes) -> None:
    """Refuse an imperfection with arguments that do not fit its loop, as a run would."""
    rng = np.random.default_rng(0)
    match one:
        case SensorImperfection():
            one.sensor(sizes, rng)
        case TimingImperfection():
            one.lags(sizes, 0, rng)
        case ActuatorImperfection():
            one.actuator(sizes)
        case Disturbance():
            one.draws(sizes, (sizes.step, 0.0), 0, rng)
            one.spread(sizes, [(np.zeros((sizes.states, sizes.states)), sizes.step)] * sizes.modes)
        case _:
            pass


def once(check: Callable[[Any, Size], Checked]) -> Callable[[Any, Size], Checked]:
    """Cache the result of a check of an imperfection's fields, by size.

    Every run of a batch checks again before it draws, and checking takes as long as drawing.
    """

    @functools.wraps(check)
    def cached(one: Any, size: Size) -> Checked:
        results = vars(one).setdefault("_checked", {})
        if size not in results:
            results[size] = check(one, size)
        return results[size]

    return cached


def per_signal(name: str, value: ArrayLike, size: int) -> np.ndarray:
    array = as_floats(name, value, f"one or ({size},)")
    whole = np.full(size, array) if array.ndim == 0 else array
    return require_shape(name, real_array(name, whole, "(size,)", 1), (size,), "(size,)")


def probability_of(name: str, value: float) -> float:
    p = number(name, value)
    if not 0.0 <= p <= 1.0:
        raise ArgumentError(f"{name} must be in [0, 1], got {p:g}.")
    return p
