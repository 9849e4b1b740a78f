"""Switching signals in CSV files: logs of events, or of samples at regular times."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from os import PathLike
from pathlib import Path

import numpy as np

from deadtime.checks import number
from deadtime.errors import ArgumentError
from deadtime.switching.signal import SwitchingSignal


def read_log(
    path: str | PathLike[str],
    *,
    modes: int | None = None,
    labels: Mapping[str, int] | None = None,
    end: float | None = None,
) -> SwitchingSignal:
    """A signal from a CSV file with a header and the columns `time` (seconds) and `mode`.

    Rows may be switching events or samples; the first row's time becomes 0. If the last row
    repeats the mode before it, the signal ends there; otherwise it has no end, unless `end`
    (on the log's own clock) says otherwise. A column `initial_age` (seconds, first row) says how
    long the first mode had been active before the log began.

    Parameters
    ----------
    path : path
        The file.
    modes : int, optional
        Number of modes of the plant; a mode beyond it is an error.
    labels : mapping, optional
        From the text in the log to the mode, such as ``{"throttle": 0, "brake": 1}``.

    Raises
    ------
    ArgumentError
        If the file is missing or lacks a column, or a row's time or mode is not known; the
        message names the line.
    """
    source = Path(path)
    try:
        with source.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file)
            reader.fieldnames = [name.strip() for name in reader.fieldnames or ()]
            if not {"time", "mode"} <= set(reader.fieldnames or ()):
                raise ArgumentError(
                    f"{source} must have the columns time and mode, got "
                    f"{reader.fieldnames}: name them in its first line."
                )
            rows, age = [], None
            for row in reader:
                rows.append((reader.line_num, row["time"], row["mode"]))
                age = row.get("initial_age", "") if age is None else age
    except OSError as error:
        raise ArgumentError(f"{source} cannot be read: {error.strerror}.") from None
    except UnicodeDecodeError:
        raise ArgumentError(f"{source} is not UTF-8 text: save it as UTF-8.") from None
    if not rows:
        raise ArgumentError(f"{source} must hold at least one row, got none.")
    times = np.array([_seconds(f"{source}, line {line}: time", text) for line, text, _ in rows])
    visited = [_mode(source, line, text, modes, labels) for line, _, text in rows]
    for (before, _, _), (line, _, _), gap in zip(rows, rows[1:], np.diff(times), strict=False):
        if gap <= 0.0:
            raise ArgumentError(
                f"{source}, line {line}: time must be later than in line {before}: sort the log "
                "and keep one row per instant."
            )
    start = times[0]
    if end is None:
        repeated = len(visited) > 1 and visited[-1] == visited[-2]
        end = times[-1] if repeated else np.inf
        if repeated:
            times, visited = times[:-1], visited[:-1]
    age_at_start = _seconds(f"{source}: initial_age", age) if age else 0.0
    return SwitchingSignal(times - start, np.array(visited), end - start, initial_age=age_at_start)


def _seconds(name: str, text: str | None) -> float:
    """The number that a cell's text stands for."""
    try:
        value = float(text or "")
    except ValueError:
        raise ArgumentError(f"{name} must be a number, got {text!r}.") from None
    return number(name, value)


def _mode(
    source: Path, line: int, text: str | None, modes: int | None, labels: Mapping[str, int] | None
) -> int:
    """The mode that a row's text names."""
    text = (text or "").strip()
    if labels is not None and text in labels and (modes is None or labels[text] < modes):
        return labels[text]
    known = f"one of {sorted(labels)}" if labels is not None else "an integer counted from 0"
    if labels is None and text.isdecimal() and (modes is None or int(text) < modes):
        return int(text)
    if labels is None and modes is not None:
        known = f"an integer in 0..{modes - 1}"
    hint = "" if labels is not None else ": map other names with labels={'name': mode, …}"
    raise ArgumentError(f"{source}, line {line}: mode must be {known}, got {text!r}{hint}.")


def write_log(signal: SwitchingSignal, path: str | PathLike[str]) -> None:
    """Write the signal's sojourns; a finite end becomes a last row that repeats the mode."""
    rows = list(zip(signal.times.tolist(), signal.modes.tolist(), strict=True))
    if np.isfinite(signal.end):
        rows.append((signal.end, int(signal.modes[-1])))
    known = [()] * len(rows)
    if signal.initial_age:
        known = [(repr(signal.initial_age),), *[("",)] * (len(rows) - 1)]
    with Path(path).open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("time", "mode", "initial_age")[: 2 + len(known[0])])
        writer.writerows((repr(t), mode, *age) for (t, mode), age in zip(rows, known, strict=True))
