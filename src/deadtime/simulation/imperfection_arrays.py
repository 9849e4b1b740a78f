"""Imperfections as arrays: those that the compiled loop takes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.imperfections import (
    Heard,
    Imperfection,
    Relaying,
    Sizes,
    TimingImperfection,
)
from deadtime.imperfections.received import is_known, relayed
from deadtime.imperfections.sensors_and_actuators import InputLimits
from deadtime.plant.discretisation import snap_all

Pairs = Sequence[tuple[Imperfection, np.random.Generator]]  # imperfections and their streams


class MeasurementLags(NamedTuple):
    """How long before its sample each state is measured, seconds.

    missing : (samples,), of which what was before time 0 is missing
    early : (samples,), of which time 0 is taken instead

    Of many runs there is an axis of these in front; axes of length 1 stand for all.
    """

    missing: Float[np.ndarray, "*runs sample"]
    early: Float[np.ndarray, "*runs sample"]

    def instants(self, h: float, samples: int) -> tuple[np.ndarray, np.ndarray]:
        """The period, −1 before time 0, and the seconds into it at which each state is measured."""
        k = np.arange(samples)
        ratio = np.maximum(0.0, snap_all(k - (self.missing + self.early) / h))
        whole = np.floor(ratio)
        step = np.where(snap_all(k - self.missing / h) < 0.0, -1, whole.astype(np.int64))
        return step, (ratio - whole) * h

    @classmethod
    def of(cls, pairs: Pairs, sizes: Sizes, samples: int) -> MeasurementLags | None:
        """The lags of a run, None where every state is measured at its sample."""
        timings = [(each, rng) for each, rng in pairs if isinstance(each, TimingImperfection)]
        if not timings:
            return None
        sums = cls(np.zeros(samples), np.zeros(samples))
        for each, rng in timings:
            sums[0 if each.waits else 1][:] += lags_of(each, sizes, samples, rng)
        return sums


def lags_of(
    each: TimingImperfection, sizes: Sizes, samples: int, rng: np.random.Generator
) -> Float[np.ndarray, " sample"]:
    """Its lags; refused where they do not fit, as compiled loops look back by them."""
    name, found = f"{type(each).__name__}.lags", np.asarray(each.lags(sizes, samples, rng))
    if found.dtype.kind not in "fiu" or found.shape != (samples,):
        raise ArgumentError(
            f"{name} must return seconds of shape (samples,) = {(samples,)}, got {found.dtype} of "
            f"shape {found.shape}."
        )
    wrong = ~((found >= 0.0) & (found < np.inf))
    if wrong.any():
        k = int(wrong.argmax())
        raise ArgumentError(f"{name} must return finite seconds ≥ 0, got {found[k]} at sample {k}.")
    return found.astype(float)


class Arrays(NamedTuple):
    """What imperfections do to a run, all that is random drawn; it needs neither plant nor signal.

    Attributes
    ----------
    commanded : bool
        Whether the law takes the inputs that it asked for to be those applied.
    """

    heard: Heard
    lags: MeasurementLags | None
    limits: InputLimits
    commanded: bool

    @classmethod
    def of(cls, pairs: Pairs, sizes: Sizes, samples: int, predict: str) -> Arrays:
        """The arrays of a run; everything random is drawn from the streams."""
        commanded, heard = tells_commands(predict), heard_of(pairs, sizes, samples)
        lags = MeasurementLags.of(pairs, sizes, samples)
        return cls(heard, lags, InputLimits.of([each for each, _ in pairs], sizes), commanded)


def heard_of(pairs: Pairs, sizes: Sizes, samples: int) -> Heard:
    """What is heard through all sensors among them, one after the other."""
    heard = Heard.perfect(samples, sizes)
    for each, rng in pairs:
        if isinstance(each, Relaying):
            heard = relayed(each, heard, sizes, rng)
    return heard


def tells_commands(predict: str) -> bool:
    """Whether the law's past inputs are those asked for."""
    if predict not in ("applied", "commanded"):
        raise ArgumentError(f'predict must be "applied" or "commanded", got {predict!r}.')
    return predict == "commanded"


def takes(pairs: Pairs) -> bool:
    """Whether the compiled loop takes them all.

    Examples
    --------
    >>> from deadtime.imperfections import Dropout, Noise, SensorImperfection
    >>> class Own(SensorImperfection):
    ...     def sensor(self, sizes, rng):
    ...         return lambda seen: seen
    >>> rng = np.random.default_rng(0)
    >>> takes([(Noise(0.1), rng), (Dropout(0.1), rng)]), takes([(Noise(0.1), rng), (Own(), rng)])
    (True, False)
    """
    return all(is_known(each) for each, _ in pairs)
