"""The measurement and the mode that reach a law at each sample, for one run or for many.

Loss, delay and noise do not depend on the state, so that all draws are made before a run
(`imperfections.received`) and arranged here sample by sample. Arrays are (group, sample, lane),
flat, so that the loop reads the lanes of a sample in one piece:

    sample        0                     | 1                     | …
    lane          0   1   2   …   7     | 0   1   2   …   7     | …        group 0, then group 1, …

A batch has eight lanes, of which the last scenario fills the rest; a single run has one.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.errors import ArgumentError
from deadtime.feedback.table import age_after, row_at
from deadtime.imperfections import Imperfection, ReceivedData, Relaying, Sizes, TimingImperfection
from deadtime.imperfections.received import is_known, relayed
from deadtime.imperfections.sensors_and_actuators import InputLimits
from deadtime.numerics.kernels import kernel
from deadtime.plant.discretisation import snap

# Inlined into compiled callers, and run by Python in short runs.
_part: dict[str, Any] = {"nogil": True, "forceinline": True, "_nrt": False}

# Unwrapped: a type checker may have wrapped them, which Numba cannot compile.
snap_number, _age_after, row_of_mode = (
    kernel(inspect.unwrap(rule), **_part) for rule in (snap, age_after, row_at)
)


class Received(NamedTuple):
    """Sensor data that reach a law.

    lag : (group, sample, lane), age of the measurement in samples, or of the period in which it was
        made, −1 for no measurement (the last command is held); empty if every sample arrives at
        once
    reach : the longest lag
    noise : (group, sample, n, lane), added to it; empty without noise
    row : (group, sample, lane), the row of the law's table; empty if that is the plant's mode's
    mode : (group, sample, lane), the mode reported to an observer; empty if that is the plant's
    """

    lag: np.ndarray
    reach: int
    noise: np.ndarray
    row: np.ndarray
    mode: np.ndarray


Pairs = Sequence[tuple[Imperfection, np.random.Generator]]  # imperfections and their streams


class MeasurementLags(NamedTuple):
    """Time from the measurement of each state to its sample, seconds, (run, sample).

    A measurement before time 0 is missing if the seconds are `missing`, and made at time 0 if they
    are `early`. An axis of length 1 is the same for all.
    """

    missing: Float[np.ndarray, "run sample"]
    early: Float[np.ndarray, "run sample"]

    @classmethod
    def of(cls, lags: Iterable[tuple[TimingImperfection, np.ndarray]]) -> MeasurementLags:
        """The sums of the lags of imperfections."""
        sums = [np.zeros((1, 1)), np.zeros((1, 1))]
        for each, more in lags:
            place = 0 if each.waits else 1
            sums[place] = sums[place] + more
        return cls(*sums)

    @classmethod
    def of_run(cls, pairs: Pairs, sizes: Sizes, samples: int) -> MeasurementLags | None:
        """The lags of a run, None if every state is measured at its sample."""
        timings = [(each, rng) for each, rng in pairs if isinstance(each, TimingImperfection)]
        lags = [(each, lags_of(each, sizes, samples, rng)[None]) for each, rng in timings]
        return cls.of(lags) if lags else None


def lags_of(
    each: TimingImperfection, sizes: Sizes, samples: int, rng: np.random.Generator
) -> Float[np.ndarray, " sample"]:
    """The lags of an imperfection, checked: compiled loops index by them without bounds."""
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


class DrawnImperfections(NamedTuple):
    """The imperfections of a run as arrays, all draws made; independent of plant and signal.

    Attributes
    ----------
    commanded : bool
        Whether the law's past inputs are its commands.
    """

    received: ReceivedData
    lags: MeasurementLags | None
    limits: InputLimits
    commanded: bool

    @classmethod
    def of(cls, pairs: Pairs, sizes: Sizes, samples: int, predict: str) -> DrawnImperfections:
        """The arrays of a run; everything random is drawn from the streams."""
        commanded, received = tells_commands(predict), ReceivedData.perfect(samples, sizes)
        for each, rng in pairs:
            if isinstance(each, Relaying):
                received = relayed(each, received, sizes, rng)
        lags = MeasurementLags.of_run(pairs, sizes, samples)
        return cls(received, lags, InputLimits.of([each for each, _ in pairs], sizes), commanded)


def tells_commands(predict: str) -> bool:
    """Whether the law's past inputs are its commands, not the inputs applied."""
    if predict not in ("applied", "commanded"):
        raise ArgumentError(f'predict must be "applied" or "commanded", got {predict!r}.')
    return predict == "commanded"


def takes(pairs: Pairs) -> bool:
    """Whether the compiled loop can run all these imperfections.

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


@kernel(nogil=True)
def find_instants(missing, early, step, period, offset):
    """Fill in the period of each measurement, −1 before time 0, and the seconds into it.

    missing, early : of `MeasurementLags`;  period, offset : (run, sample)
    """
    runs, samples = period.shape
    for s in range(runs):
        a, b = min(s, missing.shape[0] - 1), min(s, early.shape[0] - 1)
        for k in range(samples):
            lost = missing[a, min(k, missing.shape[1] - 1)]
            soon = early[b, min(k, early.shape[1] - 1)]
            ratio = max(snap_number(k - (lost + soon) / step), 0.0)
            whole = math.floor(ratio)
            period[s, k] = -1 if snap_number(k - lost / step) < 0.0 else whole
            offset[s, k] = (ratio - whole) * step


@kernel(nogil=True)
def fill_lags(lag, reach, sample, period, scenarios, lanes):
    """Fill in the lags of scenarios, side by side in lanes; the longest, at least `reach`.

    sample : (run or 1, sample), the sample whose measurement is received, −1 for none
    period : (run or 1, sample), the period of each measurement, or (0, 0) for its sample
    """
    samples, at = sample.shape[1], 0
    for first in range(0, scenarios, len(lanes)):
        for k in range(samples):
            for lane in range(len(lanes)):
                s = min(first + lane, scenarios - 1)
                now = sample[min(s, sample.shape[0] - 1), k]
                if period.size > 0 and now >= 0:
                    now = period[min(s, period.shape[0] - 1), now]
                lag[at] = -1 if now < 0 else k - now
                reach = max(reach, lag[at])
                at += 1
    return reach


ONE_LANE = (0.0,)  # the number of lanes is the length of a tuple: a type, so that loops unroll
AT_SAMPLES = np.zeros((0, 0), np.int64)


def lags_of_run(
    sample: Int[np.ndarray, " sample"], lags: MeasurementLags | None, step: float
) -> tuple[Int[np.ndarray, " sample"], Float[np.ndarray, " sample"]]:
    """The lags of one run, and the seconds into the period of each measurement."""
    period, offset = AT_SAMPLES, np.zeros((1, sample.size))
    if lags is not None:
        period = np.empty(offset.shape, np.int64)
        find_instants(*lags, step, period, offset)
    lag = np.empty(sample.size, np.int32)
    fill_lags(lag, 0, sample[None], period, 1, ONE_LANE)
    return lag, np.where(lag < 0, 0.0, offset[0, sample])


@kernel(nogil=True)
def fill_rows(row, reported, sampled, begun, apart, ages, lanes):
    """Fill `row` with a table's rows by reported modes; −1, no report, continues the last mode.

    Until a mode is reported it is mode 0, at the age of the plant's mode; the first reported mode
    starts with that age.
    reported, sampled : (scenario, sample), the mode that is reported to a law, and the plant's
    begun : (scenario,), age of the first mode at time 0, samples
    apart, ages : those of the `Feedback`
    """
    scenarios, samples = reported.shape
    width = len(lanes)
    for s in range(scenarios + -scenarios % width):
        source = min(s, scenarios - 1)
        at = s // width * samples * width + s % width
        mode, age, before = -1, begun[source], sampled[source, 0]
        for k in range(samples):
            now, true = reported[source, k], sampled[source, k]
            if mode >= 0:
                age = _age_after(mode, age, now)
            elif k > 0:
                age = _age_after(before, age, true)
            mode, before = mode if now < 0 else now, true
            row[at] = row_of_mode(apart, ages, max(mode, 0), age)
            at += width


def rows_of_run(
    reported: Int[np.ndarray, " sample"],
    sampled: Int[np.ndarray, " sample"],
    begun: int,
    apart: int = 1,
    ages: int = 1,
) -> Int[np.ndarray, " sample"]:
    """`fill_rows` of one run; the default `apart` and `ages` give the modes that a law assumes.

    Examples
    --------
    >>> rows_of_run(np.array([-1, 0, -1, 1, 1]), np.array([0, 0, 1, 1, 1]), 3, 10, 10)
    array([ 3,  4,  5, 10, 11])
    """
    row = np.empty(sampled.size, np.int64)
    fill_rows(row, reported[None], sampled[None], np.array([begun]), apart, ages, ONE_LANE)
    return row


@kernel(**_part)
def is_held(measured, answer):
    """Whether the last command is held: neither the measurement nor the answer is finite.

    The answer of an observer or a filter is finite: it predicts over lost samples.
    """
    finite = True
    for i in range(measured.size):
        finite = finite and math.isfinite(measured[i])
    if not finite:
        finite = True
        for i in range(answer.size):
            finite = finite and math.isfinite(answer[i])
    return not finite
