"""Switching signals in CSV files: logs of events, or of samples at regular times."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from os import PathLike
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.errors import ArgumentError
from deadtime.base.files import replacing
from deadtime.base.row_clocks import TIMES, clock_of, require_rising
from deadtime.base.text_tables import TextTable, numbers_in, read_text_table, with_points
from deadtime.base.wording import number_of

MOST_MODES = 1000  # of a log whose plant is not known
_MOST_NAMES, _LONGEST_NAME = 4, 20  # of modes, in a message


class SwitchingLog(NamedTuple):
    """The content of a log: the arguments of `SwitchingSignal`, times from the first row, s."""

    times: Float[np.ndarray, " sojourn"]
    modes: Int[np.ndarray, " sojourn"]
    end: float
    initial_age: float
    read_as: str = ""  # a sentence, if the file is no plain CSV file


def read_log(
    path: str | PathLike[str],
    *,
    modes: int | None = None,
    labels: Mapping[str, int] | None = None,
    end: float | None = None,
    unit: str | None = None,
    time: str | None = None,
    mode: str = "mode",
    sep: str | None = None,
    decimal: str | None = None,
) -> SwitchingLog:
    """Times and modes from a text file with a header and the columns `t` (or `time`) and `mode`.

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
        Of times that are numbers, and of `end`; by default seconds, or the unit in which a clock
        that counts from 1970 shows a date of this time.
    time, mode : str
        The columns, where they have other names.
    sep, decimal : str, optional
        The separator of columns and the sign of decimals; found by default.

    Raises
    ------
    ArgumentError
        If the file is missing or lacks a column, or a row's time or mode is not known; the
        message names the line.
    """
    wanted = TIMES if time is None else (time,)
    table = read_text_table(path, sep, decimal, wanted)
    clocked = next((name for name in wanted if name in table.columns), None)
    if clocked is None or mode not in table.columns:
        called = "t (or time)" if time is None else time
        raise ArgumentError(
            f"{table.name} must have the columns {called} and {mode}, got "
            f"{_short(list(table.columns))}: name them in its first line, or say which they are by "
            "time=, --time, and mode=, --mode."
        )
    if not table.lines:
        raise ArgumentError(f"{table.name} must hold at least one row, got none.")
    cells = with_points(table.columns[clocked], table.decimal)
    clock = clock_of(cells, table.place, clocked, unit)
    each = list(zip(*table.columns.values(), strict=True))
    kept = require_rising(
        clock.seconds, lambda i, j: each[i] == each[j], table.place, clocked, cells
    )
    table, times = table.rows(kept), clock.seconds[kept]
    texts = table.columns[mode]
    visited = [_mode(table, row, texts, modes, labels) for row in range(len(texts))]
    known_until = np.inf if end is None else clock.at(end)
    if end is None and len(visited) > 1 and visited[-1] == visited[-2]:
        known_until = times[-1]
        times, visited = times[:-1], visited[:-1]
    age = table.columns.get("initial_age", [""])[:1]
    (known_age,), _, bad = numbers_in(age, table.decimal)
    if bad is not None:
        raise ArgumentError(f"{table.name}: initial_age must be a number, got {_short(age[0])}.")
    repeated = len(cells) - len(kept)
    phrases = (*table.read_as, clock.notation, f"{number_of(repeated, 'repeated row')} left out")
    read_as = "; ".join(filter(None, phrases if repeated else phrases[:-1]))
    return SwitchingLog(
        times,
        np.array(visited),
        known_until,
        0.0 if np.isnan(known_age) else float(known_age),
        read_as and f"Read as: {read_as}.",
    )


def _mode(
    table: TextTable,
    row: int,
    texts: list[str],
    modes: int | None,
    labels: Mapping[str, int] | None,
) -> int:
    text = texts[row]
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
        names = sorted(name for name in set(texts) if 0 < len(name) <= _LONGEST_NAME)[:_MOST_NAMES]
        own = {name: mode for mode, name in enumerate(names)} or {"idle": 0}
        options = " ".join(f"--labels.{name} {mode}" for name, mode in own.items())
        hint = f": map other names with labels, such as {own}, {options}"
    raise ArgumentError(f"{table.place(row)}: mode must be {known}, got {_short(text)}{hint}.")


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
