"""Switching signals in CSV files: logs of events, or of samples at regular times."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping
from decimal import Decimal, InvalidOperation
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.errors import ArgumentError
from deadtime.base.files import read_text, replacing

MOST_BYTES = 100_000_000
MOST_MODES = 1000  # of a log whose plant is not known
_MOST_NAMES, _LONGEST_NAME = 4, 20  # of modes, in a message
TIMES = ("t", "time")  # names of the column of times, the preferred one first
UNITS = {"s": 0, "ms": -3, "us": -6, "ns": -9}  # of a clock, and their powers of ten
LATEST = 10**11  # seconds: counted from 1970 the year 5138


class SwitchingLog(NamedTuple):
    """The content of a log: the arguments of `SwitchingSignal`, times from the first row, s."""

    times: Float[np.ndarray, " sojourn"]
    modes: Int[np.ndarray, " sojourn"]
    end: float
    initial_age: float


def read_log(
    path: str | PathLike[str],
    *,
    modes: int | None = None,
    labels: Mapping[str, int] | None = None,
    end: float | None = None,
    unit: str | None = None,
) -> SwitchingLog:
    """Times and modes from a CSV file with a header and the columns `t` (or `time`) and `mode`.

    Rows may be switching events or samples, evenly spaced or not: a sojourn begins at the first row
    with its mode. The time of the first row becomes 0, in decimal arithmetic, so that a clock may
    count from any day. If the last row repeats the mode before it, the signal ends there; otherwise
    it has no end, unless `end` (on the log's clock) is given. A column `initial_age` (seconds,
    first row) gives the age of the first mode at the beginning of the log.

    Parameters
    ----------
    path : path
        The file.
    modes : int, optional
        Number of modes of the plant; a mode beyond it is an error.
    labels : mapping, optional
        From the text in the log to the mode, such as ``{"throttle": 0, "brake": 1}``.
    unit : "s", "ms", "us" or "ns", optional
        Of the column of times, and of `end`; seconds by default.

    Raises
    ------
    ArgumentError
        If the file is missing or lacks a column, or a row's time or mode is not known; the
        message names the line. If times are so large that seconds cannot be meant, and no unit
        is given.
    """
    source = Path(path)
    text = read_text(source, MOST_BYTES)
    clocked, rows, age = _rows(source, text)
    clock = [_decimal(f"{source}, line {row.line}: {clocked}", row.time) for row in rows]
    power = _power(source, clock[0], unit)
    visited = [_mode(source, row, rows, modes, labels) for row in rows]
    # As decimals: the difference of two floats that count from 1970 would lose seven digits.
    times = np.array([float((time - clock[0]).scaleb(power)) for time in clock])
    for before, row, late in zip(rows, rows[1:], times[1:] <= times[:-1], strict=False):
        if late:
            raise ArgumentError(
                f"{source}, line {row.line}: {clocked} must be later than in line {before.line}: "
                "sort the log and keep one row per instant."
            )
    known_until = np.inf
    if end is not None:
        known_until = float((Decimal(repr(float(end))) - clock[0]).scaleb(power))
    if end is None and len(visited) > 1 and visited[-1] == visited[-2]:
        known_until = times[-1]
        times, visited = times[:-1], visited[:-1]
    age_at_start = float(_decimal(f"{source}: initial_age", age)) if age else 0.0
    return SwitchingLog(times, np.array(visited), known_until, age_at_start)


def _power(source: Path, start: Decimal, unit: str | None) -> int:
    """The power of ten that converts a log's clock to seconds."""
    if unit is None and abs(start) >= LATEST:
        raise ArgumentError(
            f"{source}: its clock starts at {float(start):.6g}, which is after the year 5138 if it "
            'counts seconds: say unit = "ms" (or "us", "ns") if it does not, "s" if it does.'
        )
    if unit is not None and unit not in UNITS:
        raise ArgumentError(f"unit must be one of {', '.join(UNITS)}, got {unit!r}.")
    return UNITS[unit or "s"]


class _Row(NamedTuple):
    line: int  # where it ends
    time: str | None
    mode: str | None


def _rows(source: Path, text: str) -> tuple[str, list[_Row], str]:
    """The name of the column of times, the rows, and the age of the first mode, if any."""
    reader = csv.DictReader(io.StringIO(text, newline=""))
    rows, age = [], ""
    try:
        reader.fieldnames = names = [name.strip() for name in reader.fieldnames or ()]
        clock = next((name for name in TIMES if name in names), None)
        if clock is None or "mode" not in names:
            raise ArgumentError(
                f"{source} must have the columns t (or time) and mode, got {_short(names)}: name "
                "them in its first line."
            )
        for row in reader:
            age = age if rows else row.get("initial_age") or ""
            rows.append(_Row(reader.line_num, row[clock], row["mode"]))
    except csv.Error as error:
        raise ArgumentError(f"{source}, line {reader.reader.line_num}: {error}.") from None
    if not rows:
        raise ArgumentError(f"{source} must hold at least one row, got none.")
    return clock, rows, age


def _decimal(name: str, text: str | None) -> Decimal:
    """The number in a cell, with all of its digits."""
    text = (text or "").strip()
    try:
        value = Decimal(text)
    except InvalidOperation:
        raise ArgumentError(f"{name} must be a number, got {_short(text)}.") from None
    if not (value.is_finite() and math.isfinite(float(value))):
        raise ArgumentError(f"{name} must be finite, got {text:.40}.")
    return value


def _mode(
    source: Path, row: _Row, rows: list[_Row], modes: int | None, labels: Mapping[str, int] | None
) -> int:
    text = (row.mode or "").strip()
    if labels is not None and text in labels and (modes is None or labels[text] < modes):
        return labels[text]
    known = f"one of {sorted(labels)}" if labels is not None else "an integer counted from 0"
    most = MOST_MODES if modes is None else modes
    if labels is None and text.isdecimal() and len(text) < 10 and int(text) < most:
        return int(text)
    if labels is None and (modes is not None or text.isdecimal()):
        known = f"an integer in 0..{most - 1}"
    hint = ""
    if labels is None:
        names = {(one.mode or "").strip() for one in rows}
        names = sorted(name for name in names if 0 < len(name) <= _LONGEST_NAME)[:_MOST_NAMES]
        own = {name: mode for mode, name in enumerate(names)} or {"idle": 0}
        options = " ".join(f"--labels.{name} {mode}" for name, mode in own.items())
        hint = f": map other names with labels, such as {own}, {options}"
    raise ArgumentError(
        f"{source}, line {row.line}: mode must be {known}, got {_short(text)}{hint}."
    )


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:79]}…"


def write_log(log: SwitchingLog, path: str | PathLike[str]) -> None:
    """Write a signal's sojourns; a finite end becomes a last row that repeats the mode."""
    rows = list(zip(log.times.tolist(), log.modes.tolist(), strict=True))
    if np.isfinite(log.end):
        rows.append((log.end, int(log.modes[-1])))
    known = [()] * len(rows)
    if log.initial_age:
        known = [(repr(log.initial_age),), *[("",)] * (len(rows) - 1)]
    with replacing(path) as place, place.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("time", "mode", "initial_age")[: 2 + len(known[0])])
        writer.writerows((repr(t), mode, *age) for (t, mode), age in zip(rows, known, strict=True))
