"""The interfaces of imperfections, and the sizes of a loop that they must know."""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, NamedTuple, TypeVar, final

import numpy as np
from numpy.typing import ArrayLike

from deadtime.base.checks import as_floats, instance, number, real_array, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.numerics.streams import stream
from deadtime.plant import SwitchedSystem


class Sizes(NamedTuple):
    """The sizes of a loop that an imperfection must know; the step in seconds."""

    modes: int
    states: int
    inputs: int
    step: float

    @classmethod
    def of(cls, plant: SwitchedSystem, step: float) -> Sizes:
        """Those of a plant under a law that measures the whole state."""
        return cls(plant.modes, plant.states, plant.inputs, step)


class Seen(NamedTuple):
    """The state and mode that reach the law at a sample; x is NaN where nothing did."""

    x: np.ndarray
    mode: int


Sense = Callable[[Seen], Seen]
Act = Callable[[np.ndarray, np.ndarray], np.ndarray]  # from u_k as asked and u_{k−1} as applied
Piece = tuple[np.ndarray, float]  # A and how many seconds the plant has it


class Limits(NamedTuple):
    """Bounds (m,) of the inputs, or, if relative, of their change from those applied before."""

    low: np.ndarray
    high: np.ndarray
    relative: bool


Checked = TypeVar("Checked")
Size = TypeVar("Size", int, Sizes)


class Imperfection(Frozen, ABC):
    """Something between the law and its plant."""


class Drawing(ABC):
    """A part that draws so many numbers of one kind: those of many runs are drawn at once.

    `normal` says whether they are of the standard normal distribution, or uniform on [0, 1).
    """

    normal: ClassVar[bool] = False

    @abstractmethod
    def count(self, sizes: Sizes, samples: int) -> int:
        """How many numbers a run takes."""

    @final
    def draw(self, sizes: Sizes, samples: int, rng: np.random.Generator) -> np.ndarray:
        """Those of one run."""
        size = self.count(sizes, samples)
        return rng.standard_normal(size) if self.normal else rng.random(size)


class SensorImperfection(Imperfection):
    """Changes what the law is told; one that reads no state says so by `Relaying`."""

    @abstractmethod
    def sensor(self, sizes: Sizes, rng: np.random.Generator) -> Sense:
        """A function from what is seen to what the law is told, called once a sample."""


class TimingImperfection(Imperfection):
    """Changes when the law's measurement is taken.

    `waits` says whether what was measured before time 0 is missing, or time 0 is taken instead.
    """

    waits: ClassVar[bool]

    @abstractmethod
    def lags(self, sizes: Sizes, samples: int, rng: np.random.Generator) -> np.ndarray:
        """How long before each sample x is measured, seconds (samples,)."""


class DrawnTiming(Drawing, TimingImperfection):
    """Timing from numbers that are drawn at once, of one run or of many."""

    @abstractmethod
    def lags_from(self, numbers: np.ndarray, sizes: Sizes, samples: int) -> np.ndarray:
        """The lags (runs, samples) of runs that drew these numbers (runs, count), or of one run.

        An axis of length 1 stands for all runs, or for all samples.
        """

    @final
    def lags(self, sizes: Sizes, samples: int, rng: np.random.Generator) -> np.ndarray:
        lags = self.lags_from(self.draw(sizes, samples, rng), sizes, samples)
        return np.broadcast_to(lags, (samples,)).copy()


class ActuatorImperfection(Imperfection):
    """Changes what the plant is given."""

    @abstractmethod
    def actuator(self, sizes: Sizes) -> Act:
        """A function to be called once a sample."""


class Limiting(ABC):
    """A part that clips the input: a base beside `ActuatorImperfection`, as `Relaying` is."""

    @abstractmethod
    def limits(self, sizes: Sizes) -> Limits:
        """The least and the largest input, and whether they are relative to the input before."""

    @final
    def actuator(self, sizes: Sizes) -> Act:
        low, high, relative = self.limits(sizes)
        if relative:
            return lambda asked, before: np.minimum(np.maximum(asked, before + low), before + high)
        return lambda asked, before: np.minimum(np.maximum(asked, low), high)


class Disturbance(Imperfection):
    """A force on the plant: dx/dt = A x + B u(t − D) + w(t), whatever the law does."""

    @abstractmethod
    def draws(
        self, sizes: Sizes, lengths: tuple[float, ...], steps: int, rng: np.random.Generator
    ) -> np.ndarray:
        """Numbers (steps, lengths, r) that decide w over stretches of these lengths, in steps."""

    @abstractmethod
    def spread(self, sizes: Sizes, pieces: Sequence[Piece]) -> np.ndarray:
        """(n, r): from a stretch's numbers to what w adds to x over these pieces of it."""

    @property
    def goes_by_mode(self) -> bool:
        """Whether w is a force that the mode decides; `force_by_mode` then says which."""
        return False

    def force_by_mode(self, sizes: Sizes) -> np.ndarray | None:
        """c (modes, n) of w = c_σ times the one number drawn; None where w is anything else."""
        return None


class Stacked(ABC):
    """A disturbance that spreads over many stretches at once: a base beside `Disturbance`."""

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
    """A generator for each, which the presence of the others does not change."""
    if not isinstance(imperfections, Sequence) or isinstance(imperfections, str):
        raise ArgumentError(
            f"imperfections must be a list of imperfections, got {type(imperfections).__name__}."
        )
    for each in imperfections:
        instance("imperfections", each, Imperfection)
    names = [type(each).__name__ for each in imperfections]
    return [stream(seed, name, names[:place].count(name)) for place, name in enumerate(names)]


def require(one: Imperfection, sizes: Sizes) -> None:
    """Refuse an imperfection that does not fit its loop, as a run would."""
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
    """Remember what a check of an imperfection's fields made of them, size by size.

    Many runs ask for it as often as they draw, and checking takes as long as drawing.
    """

    @functools.wraps(check)
    def memory_size(one: Any, size: Size) -> Checked:
        found = vars(one).setdefault("_found", {})
        if size not in found:
            found[size] = check(one, size)
        return found[size]

    return memory_size


def per_signal(name: str, value: ArrayLike, size: int) -> np.ndarray:
    array = as_floats(name, value, f"one or ({size},)")
    whole = np.full(size, array) if array.ndim == 0 else array
    return require_shape(name, real_array(name, whole, "(size,)", 1), (size,), "(size,)")


def probability_of(name: str, value: float) -> float:
    p = number(name, value)
    if not 0.0 <= p <= 1.0:
        raise ArgumentError(f"{name} must be in [0, 1], got {p:g}.")
    return p
