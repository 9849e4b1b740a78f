"""References: a constant, drawn or not, a schedule, or a function of time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import as_floats, real_array, require_shape, require_unmasked
from deadtime.base.errors import ArgumentError
from deadtime.plant.sampling import TOLERANCE


@runtime_checkable
class Drawable(Protocol):
    """What scipy.stats freezes."""

    def rvs(self, size: Any = ..., random_state: Any = ...) -> Any:
        """Numbers drawn."""
        ...

    def mean(self) -> Any:
        """Their mean."""
        ...

    def support(self) -> Any:
        """The least and the largest."""
        ...


@dataclass(frozen=True, eq=False)
class Reference:
    """r(t), from a time in seconds to shape (size,).

    With a `distribution`, of which every run draws a constant for each output, it is the mean.
    """

    function: Callable[[float], Any]
    size: int
    schedule: Schedule | None = None
    distribution: Drawable | None = None

    def __call__(self, time: float) -> Float[np.ndarray, " size"]:
        return check_reference(self.function(time), self.size)

    def along(self, time: Float[np.ndarray, " T"]) -> Float[np.ndarray, "T size"]:
        """r at many times."""
        if self.schedule is not None:
            return self.schedule.along(time)
        return np.array([self(t) for t in time.tolist()]).reshape(time.size, self.size)

    @property
    def values(self) -> Float[np.ndarray, "count size"]:
        """What it is known to come to: none of a function; of a distribution its mean and ends."""
        if self.schedule is None:
            return np.zeros((0, self.size))
        if self.distribution is None:
            return self.schedule.values
        ends = [np.broadcast_to(end, self.size) for end in self.distribution.support()]
        return np.array([*self.schedule.values, *(end for end in ends if np.isfinite(end).all())])

    def drawn(self, rng: np.random.Generator) -> Reference:
        """That of one run."""
        if self.distribution is None:
            return self
        return Reference.of(self.distribution.rvs(size=self.size, random_state=rng), self.size)

    @classmethod
    def of(cls, value: Any, size: int) -> Reference:
        """From what a user gives: a number, (size,), (times, values), a function or a distribution.

        A distribution is one that scipy.stats freezes, of finite mean.
        """
        if isinstance(value, Reference):
            return value
        if isinstance(value, Drawable):
            mean = value.mean()
            if not np.isfinite(mean).all():
                raise ArgumentError(f"reference must have a finite mean, got {mean}.")
            schedule = Schedule(np.zeros(1), check_reference(mean, size)[None])
            return cls(schedule, size, schedule, value)
        if callable(value):
            return cls(value, size)
        if isinstance(value, tuple) and len(value) == 2 and np.ndim(value[0]) == 1:
            schedule = Schedule.of(*value, size)
        else:
            schedule = Schedule(np.zeros(1), check_reference(value, size)[None])
        return cls(schedule, size, schedule)


def check_reference(value: Any, size: int) -> Float[np.ndarray, " size"]:
    """A number for every output, or one for each."""
    given = require_unmasked("reference", value)
    whole = [given] * size if np.ndim(given) == 0 else given
    array = real_array("reference", whole, "(tracked,)", 1)
    return require_shape("reference", array, (size,), "(tracked,)")


@dataclass(frozen=True, eq=False)
class Schedule:
    """Each value from its time on; the first from the start."""

    times: Float[np.ndarray, " change"]
    values: Float[np.ndarray, "change size"]

    @classmethod
    def of(cls, times: Any, values: Any, size: int) -> Schedule:
        """From a number or (size,) for every time."""
        times = real_array("reference, times", times, "(T,)", 1)
        values = as_floats("reference, values", values, "(T,) or (T, tracked)")
        values = np.tile(values[:, None], size) if values.ndim == 1 else values
        values = real_array("reference, values", values, "(T,) or (T, tracked)", 2)
        require_shape("reference, values", values, (times.size, size), "(T, tracked)")
        if (np.diff(times) <= 0.0).any():
            raise ArgumentError(f"reference, times must increase, got {times.tolist()}.")
        return cls(times, values)

    def __call__(self, time: float) -> Float[np.ndarray, " size"]:
        return self.along(np.array([time]))[0]

    @property
    def slack(self) -> float:
        """Seconds by which a sample may come before a change, and is taken to be at it."""
        return TOLERANCE * max(1.0, float(np.abs(self.times).max()))

    def along(self, time: Float[np.ndarray, " T"]) -> Float[np.ndarray, "T size"]:
        """The values at many times."""
        late = np.searchsorted(self.times, time + self.slack, "right") - 1
        return self.values[np.maximum(late, 0)]
