"""Units that change from log to log or within one, such as seconds and milliseconds.

A period of the plant is linear in its state and inputs, so a regression fitted to one stretch
predicts another one if both have the same units. A column whose size differs by a factor of about
1,000 between stretches is tested: if one stretch predicts the other only after the column is
divided or multiplied by 1,000, the column is refused by name. Stretches of different size in the
same units predict each other unconverted; noise predicts nothing either way.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.errors import ArgumentError
from deadtime.identification.log.recording import Part, Recording

_THOUSAND = 1000.0
_LIKELY = 0.7  # decades by which a ratio may differ from 1,000: stretches differ in size, too
_SAME = 0.01  # relative error of a ratio of sampling periods
_CLOCKS = (
    (1e3, "milliseconds", "1,000"),
    (1e6, "microseconds", "1,000,000"),
    (1e9, "nanoseconds", "1,000,000,000"),
)
_SLOW = 5.0  # longest delays per sampling period: plants are often sampled that slowly
_MOST_LEFT = 0.5  # share of a stretch's variance that a model in the right units leaves at most
_WORSE = 3.0  # times so much variance is left in wrong units
_MOST_LAGS = 60  # of inputs, in a regression
_LEAST = 20  # rows of a stretch


def require_seconds(recording: Recording, longest: float) -> None:
    """Refuse times that seem to be in milliseconds or smaller units.

    A period of a few longest delays is accepted: in milliseconds it would be far longer.
    """
    step = recording.step
    if step <= _SLOW * longest:
        return
    fits = [(unit, text) for ratio, unit, text in _CLOCKS if step / ratio <= longest]
    unit, text = fits[0] if fits else _CLOCKS[0][1:]
    raise ArgumentError(
        f"log has a row every {step:g} s, and delays of at most {longest:g} s are looked for, far "
        f"less than that: if its t counts {unit}, divide it by {text}; else widen "
        "delay=(low, high), --delay LOW HIGH, in seconds."
    )


def require_same_units(
    parts: Sequence[Part],
    columns: tuple[Sequence[str], Sequence[str]],
    longest: float,
    places: Sequence[str],
    row_of: Callable[[int, int], str],
) -> None:
    """Refuse logs in which the unit of a column or of time changes.

    columns : names of outputs and inputs; longest : the longest delay, seconds; places : names of
    logs; row_of : the name of row k of log i
    """
    best = max(range(len(parts)), key=lambda i: parts[i].time.size)
    steps = [float(np.median(np.diff(part.time))) for part in parts]
    whole = [RowStretch(part, 0, part.time.size) for part in parts]
    names = [name for own in columns for name in own]
    for i, one in enumerate(whole):
        if i == best:
            continue
        lags = _lags_between(whole[best], one, longest / min(steps))
        ratio = steps[i] / steps[best]
        near = [c for c in _CLOCKS if abs(max(ratio, 1.0 / ratio) / c[0] - 1.0) < _SAME]
        if near and _unexplained(whole[best], one, lags).min() < _MOST_LEFT:
            slow, fast = (i, best) if ratio > 1.0 else (best, i)
            _, unit, text = near[0]
            raise ArgumentError(
                f"{places[slow]} has a row every {steps[slow]:g} s, {places[fast]} one every "
                f"{steps[fast]:g} s, and row by row the plant does the same in both: if t counts "
                f"{unit} in {places[slow]}, divide it by {text}."
            )
        for column, name in enumerate(names):
            sizes = [_log_sizes(two.part, column) for two in (one, whole[best])]
            if all(np.isfinite(size).any() for size in sizes):
                mean, base = (float(np.nanmean(size)) for size in sizes)
                conversion = _conversion(column, mean - base)
                if conversion and _only_converted(whole[best], one, conversion, lags):
                    there, elsewhere = f"in {places[i]}", f"in {places[best]}"
                    raise ArgumentError(_message(name, there, elsewhere, conversion))
    for i, part in enumerate(parts):
        for column, name in enumerate(names):
            at, conversion = _change(part, column)
            if conversion is None:
                continue
            two = RowStretch(part, 0, at), RowStretch(part, at, part.time.size)
            known, other = two if at > part.time.size // 2 else two[::-1]
            inverse = conversion._replace(factor=1.0 / conversion.factor)
            own = conversion if other is two[1] else inverse
            if _only_converted(known, other, own, _lags_between(*two, longest / steps[i])):
                there = f"from {row_of(i, at)}, on"
                raise ArgumentError(_message(name, there, "before", conversion))


class Conversion(NamedTuple):
    """The factor of a column; inputs are numbered after the outputs."""

    column: int
    factor: float


def _message(name: str, where: str, other: str, conversion: Conversion) -> str:
    what = "divided" if conversion.factor < 1.0 else "multiplied"
    return (
        f"{name} seems to be counted in other units {where} than {other}: the plant does the same "
        f"in both only once {name} is {what} by 1,000 {where}. Convert it, so that all rows have "
        "the same units."
    )


def _log_sizes(part: Part, column: int) -> Float[np.ndarray, " row"]:
    """Logarithms of the changes of an output from row to row, or of the size of an input."""
    p = part.output.shape[1]
    size = np.abs(np.diff(part.output[:, column]) if column < p else part.input[:-1, column - p])
    known = size[np.isfinite(size) & (size > 0.0)]
    if known.size == 0:
        return np.full(size.size, np.nan)
    return np.log(np.maximum(size, 1e-9 * known.max()))


def _conversion(column: int, difference: float) -> Conversion | None:
    """The conversion for a difference of mean logarithms, if it is near log 1,000."""
    if not abs(abs(difference) - np.log(_THOUSAND)) < _LIKELY * np.log(10.0):
        return None
    return Conversion(column, 1.0 / _THOUSAND if difference > 0.0 else _THOUSAND)


def _change(part: Part, column: int) -> tuple[int, Conversion | None]:
    """The row from which a column is about 1,000 times larger or smaller, and its conversion.

    The row maximises the variance between the rows before and after it.
    """
    size = _log_sizes(part, column)
    known = np.isfinite(size)
    if known.sum() < 2 * _LEAST:
        return 0, None
    total = np.cumsum(np.where(known, size, 0.0))[:-1]
    count = np.cumsum(known)[:-1].astype(float)
    rest, left = total[-1] + np.nan_to_num(size[-1]) - total, known.sum() - count
    enough = (count >= _LEAST) & (left >= _LEAST)
    if not enough.any():
        return 0, None
    with np.errstate(all="ignore"):
        apart = rest / left - total / count
        gain = np.where(enough, apart**2 * count * left, -1.0)
    at = int(gain.argmax())
    conversion = _conversion(column, float(apart[at]))
    # An output's jump into larger units is itself a large change, in the row before.
    larger = conversion is not None and conversion.factor < 1.0
    return at + 1 + (larger and column < part.output.shape[1]), conversion


class RowStretch(NamedTuple):
    """Rows `first` to `last` − 1 of a log, in the same units."""

    part: Part
    first: int
    last: int


def _lags_between(known: RowStretch, other: RowStretch, most: float) -> int:
    """The lags of inputs in regressions, in samples: at least half of the rows have them all."""
    rows = min(one.last - one.first for one in (known, other))
    return int(max(0, min(np.ceil(most) + 1, rows // 2, _MOST_LAGS)))


def _only_converted(
    known: RowStretch, other: RowStretch, conversion: Conversion, lags: int
) -> bool:
    """Whether one stretch predicts another only after a column is converted.

    The prediction must be clearly better for one output, and better on average. It must also be
    worse without the column: a column of noise that hardly moves predicts nothing.
    """
    left = _unexplained(known, other, lags, conversion)
    unconverted = _unexplained(known, other, lags)
    without = _unexplained(known, other, lags, conversion._replace(factor=0.0))
    clear = (left < _MOST_LEFT) & (np.minimum(unconverted, without) > _WORSE * left)
    return bool(clear.any()) and float(left.mean()) < float(unconverted.mean())


class _Rows(NamedTuple):
    """Periods: outputs at their beginning, inputs then and before, changes of outputs, modes."""

    output: Float[np.ndarray, "row p"]
    past: Float[np.ndarray, "row lag m"]
    moved: Float[np.ndarray, "row p"]
    mode: Int[np.ndarray, " row"]

    def of(self, mode: int) -> _Rows:
        own = self.mode == mode
        return _Rows(*(column[own] for column in self))

    def acting(self, lags: Sequence[int]) -> Float[np.ndarray, "row z"]:
        """Outputs, and two samples of every input from its lag."""
        columns = [self.past[:, lag : lag + 2, j] for j, lag in enumerate(lags)]
        return np.hstack((self.output, *columns))


def _unexplained(
    known: RowStretch, other: RowStretch, lags: int, conversion: Conversion | None = None
) -> Float[np.ndarray, " p"]:
    """Shares of the variance of changes in one stretch not predicted by regressions of another."""
    fitted, tested = _rows(known, lags, None), _rows(other, lags, conversion)
    rest, total = np.zeros((2, tested.moved.shape[1]))
    for i in np.unique(tested.mode).tolist():
        own, predicted = fitted.of(i), tested.of(i)
        if len(own.moved) < _LEAST + 2 * own.acting([0] * own.past.shape[2]).shape[1]:
            continue
        chosen = _delays(own)
        P = np.linalg.lstsq(own.acting(chosen), own.moved, rcond=None)[0]
        rest += ((predicted.moved - predicted.acting(chosen) @ P) ** 2).sum(axis=0)
        total += (predicted.moved**2).sum(axis=0)
    return np.divide(rest, total, out=np.full(total.size, np.inf), where=total > 0.0)


def _delays(rows: _Rows) -> list[int]:
    """The lags of all inputs, chosen in turn, whose two samples leave the least residuals."""
    chosen: list[int] = []
    spread = np.maximum(rows.moved.std(axis=0), 1e-300)
    for _ in range(rows.past.shape[2]):
        tried = []
        for lag in range(max(1, rows.past.shape[1] - 1)):
            z = rows.acting([*chosen, lag])
            P = np.linalg.lstsq(z, rows.moved, rcond=None)[0]
            tried.append(float((((rows.moved - z @ P) / spread) ** 2).sum()))
        chosen.append(int(np.argmin(tried)))
    return chosen


def _rows(one: RowStretch, lags: int, conversion: Conversion | None) -> _Rows:
    columns = np.hstack((one.part.output, one.part.input))
    if conversion is not None:
        columns[:, conversion.column] *= conversion.factor
    output, u = np.split(columns, [one.part.output.shape[1]], axis=1)
    k = np.arange(one.first + lags, one.last - 1)
    past = u[k[:, None] - np.arange(lags + 1)]
    moved = output[k + 1] - output[k]
    good = np.isfinite(past).all(axis=(1, 2))
    good &= np.isfinite(output[k]).all(axis=1) & np.isfinite(moved).all(axis=1)
    return _Rows(*(part[good] for part in (output[k], past, moved, one.part.mode[k])))
