"""Logs as they come, CSV files or tables, as arrays; what cannot be one is refused by its line."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import brief, read_only
from deadtime.base.errors import ArgumentError

if TYPE_CHECKING:
    import pandas as pd

ROUNDED = 0.01  # of a period: a time that a clock rounds so much is still on the grid
TIMES = ("t", "time")
_NAMED = re.compile(r"(\w[ _]?\[?\d*\]?): *(.+)")


class Part(NamedTuple):
    """One log: samples at rising times; a measurement that is missing is NaN."""

    time: Float[np.ndarray, " sample"]
    output: Float[np.ndarray, "sample p"]
    input: Float[np.ndarray, "sample m"]
    mode: Int[np.ndarray, " sample"]


class Recording(NamedTuple):
    """All logs of one plant.

    step : the sampling period, the median of all, seconds
    even : whether all samples lie on one grid, but for rounded times
    outputs, inputs, modes : their names
    logged : whether the mode was, or there is only one
    absent : modes that a table declares, as categories, and never visits
    """

    parts: tuple[Part, ...]
    step: float
    even: bool
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    modes: tuple[str, ...]
    logged: bool
    absent: tuple[str, ...] = ()

    @property
    def samples(self) -> int:
        """How many there are in all logs."""
        return sum(part.time.size for part in self.parts)


Check = Callable[
    [tuple[Part, ...], tuple[Sequence[str], Sequence[str]], list[str], Callable[[int, int], str]],
    None,
]


class _Table(NamedTuple):
    """A table, what messages call it, and how they name its rows: the first one's number."""

    frame: pd.DataFrame
    name: str
    row: str
    first: int

    def place(self, index: int) -> str:
        return f"{self.name}, {self.row} {index + self.first}"


def read_recording(
    logs: Any,
    modes: str | None,
    states: Sequence[str] | None = None,
    inputs: Sequence[str] | None = None,
    letter: str = "x",
    check: Check | None = None,
) -> Recording:
    """The recording of a log or a list of logs: paths of CSV files, or pandas tables.

    Parameters
    ----------
    logs : path, DataFrame, or list of them
        With columns t (or time), x…, u…, and the mode.
    modes : str or None
        The column of the mode; None: one mode.
    states, inputs : sequence of str, optional
        Their columns; by default those that begin with `letter`, and with u, and go on with a
        number or not at all. A name may follow a colon: "x1: position (m)" is so called.
    letter : str
        "x", or "y" for outputs.
    check : callable, optional
        Called with the logs, the columns of outputs and of inputs, what logs are called, and what
        names a row of one of them, before they are put together.

    Raises
    ------
    ArgumentError
        If a column is missing, an entry is no number, times do not rise, a mode is not visited or
        an input never moves. The message names the line.
    """
    given = list(logs) if isinstance(logs, list | tuple) else [logs]
    if not given:
        raise ArgumentError("log must be a path, a table or a list of them, got an empty list.")
    tables = [_table(log, number) for number, log in enumerate(given)]
    column = _mode_column(tables, modes)
    names = _columns(tables[0], letter, states, "states" if letter == "x" else "outputs")
    acting = _columns(tables[0], "u", inputs, "inputs")
    for table in tables:
        if len(table.frame) < 3:
            raise ArgumentError(
                f"{table.name} must have at least 3 rows, got {len(table.frame)}: log for longer."
            )
    labels = _labels(tables, column)
    parts = tuple(_part(table, names, acting, column, labels) for table in tables)
    _require_moving(parts, acting)
    if check is not None:
        called = [table.name for table in tables]
        check(parts, (names, acting), called, lambda i, k: tables[i].place(k))
    parts = _split_at_gaps(parts)
    step, even = _period(parts)
    called, moved = map(_names_of, (names, acting))
    absent = _absent(tables, column, labels)
    logged = column is not None
    return Recording(parts, step, even, called, moved, tuple(labels), logged, absent)


def _names_of(columns: Sequence[str]) -> tuple[str, ...]:
    """What columns are of: the name behind the colon, or all of the column's."""
    return tuple(match[2] if (match := _NAMED.fullmatch(one)) else one for one in columns)


def _table(log: Any, number: int) -> _Table:
    """A log as a pandas table."""
    import pandas as pd

    if isinstance(log, pd.DataFrame):
        name = "log" if number == 0 else f"log[{number}]"
        return _Table(log.rename(columns=lambda c: str(c).strip()), name, "row", 0)
    try:
        source = Path(log)
    except TypeError:
        raise ArgumentError(
            f"log must be the path of a CSV file or a pandas DataFrame, got {type(log).__name__}."
        ) from None
    frame = read_table(source)
    return _Table(frame.rename(columns=lambda c: str(c).strip()), str(source), "line", 2)


def read_table(source: Path, rows: int | None = None) -> pd.DataFrame:
    """A CSV file with one header line, or its first rows; no column is taken for an index."""
    import pandas as pd

    try:
        _require_commas(source)
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)
            return pd.read_csv(
                source, skipinitialspace=True, skip_blank_lines=False, index_col=False, nrows=rows
            )
    except ArgumentError:
        raise
    except OSError as error:
        raise ArgumentError(f"{source} cannot be read: {error.strerror}.") from None
    except UnicodeDecodeError:
        raise ArgumentError(f"{source} is not UTF-8 text: save it as UTF-8.") from None
    except pd.errors.ParserWarning:
        raise ArgumentError(
            f"{source} is no CSV table with one header line: its rows have more columns than its "
            "header names. Name them all."
        ) from None
    except ValueError as error:  # pandas' own are ValueErrors
        text = " ".join(str(error).split()).rstrip(".")
        raise ArgumentError(f"{source} is no CSV table with one header line: {text}.") from None


def _require_commas(source: Path) -> None:
    """Refuse a header that other signs than commas divide, as in countries of decimal commas."""
    with source.open(encoding="utf-8") as lines:
        header = lines.readline(100_000)
    for sign, name in ((";", "semicolons"), ("\t", "tabs")):
        if sign in header and "," not in header:
            raise ArgumentError(
                f"{source} has {name} between its columns: save it with commas there and points "
                f"in numbers, or give the table that pandas.read_csv(…, sep={sign!r}) makes of it, "
                'with decimal="," where its numbers have commas.'
            )


def _mode_column(tables: list[_Table], modes: str | None) -> str | None:
    if modes is None:
        return None
    for table in tables:
        if modes not in table.frame.columns:
            raise ArgumentError(
                f"{table.name} must have the column {modes!r}, got "
                f"{brief(list(table.frame.columns))}: log the mode, name its column by modes=, say "
                "modes=None (--one-mode) for a plant of one mode, or modes=2 (--modes 2) for two "
                "that were not logged."
            )
    return modes


def _columns(
    table: _Table, letter: str, given: Sequence[str] | None, argument: str
) -> tuple[str, ...]:
    """The columns of states or inputs."""
    found = list(table.frame.columns)
    if given is None:
        chosen = columns_of(found, letter)
    elif isinstance(given, str):
        raise ArgumentError(
            f"{argument} must be a list of columns, such as {given.split(',')}, got the text "
            f"{given!r}."
        )
    else:
        chosen = [str(name) for name in given]
    if not chosen:
        raise ArgumentError(
            f"{table.name} must have columns {letter}1, {letter}2, …, got {brief(found)}: name "
            f"them so, or say which they are by {argument}=[…], --{argument}."
        )
    return tuple(chosen)


def columns_of(columns: Sequence[str], letter: str) -> list[str]:
    """Those that a letter and a number name, by their numbers.

    Examples
    --------
    >>> columns_of(["t", "x2", "x1: speed (m/s)", "extra"], "x")
    ['x1: speed (m/s)', 'x2']
    """
    form = re.compile(rf"{letter}[ _]?\[?(\d*)\]?(?:: *.+)?")
    places = {name: match[1] for name in columns if (match := form.fullmatch(name))}
    return sorted(places, key=lambda name: int(places[name] or 0))


def _labels(tables: list[_Table], column: str | None) -> dict[str, int]:
    """The number of every mode, by what the logs call it."""
    if column is None:
        return {"mode 0": 0}
    seen: set[str] = set()
    for table in tables:
        missing = np.flatnonzero(table.frame[column].isna())
        if missing.size:
            raise ArgumentError(
                f"{table.place(int(missing[0]))}: {column} must be there in every row, got none: "
                "fill it with the mode that was active."
            )
        seen |= {_label(value) for value in table.frame[column].unique()}
    if not all(name.isdecimal() for name in seen):
        return {name: i for i, name in enumerate(sorted(seen))}
    numbers = sorted(map(int, seen))
    if numbers[-1] - numbers[0] >= len(numbers):
        absent = next(i for i in range(numbers[0], numbers[-1]) if i not in numbers)
        raise ArgumentError(
            f"{column}: mode {absent} is never visited, modes {numbers} are: nothing is known of "
            "it. Log a stay in it, or number the modes without a gap."
        )
    return {str(i): place for place, i in enumerate(numbers)}


def _absent(tables: list[_Table], column: str | None, labels: dict[str, int]) -> tuple[str, ...]:
    """Modes that are categories of a column and not visited."""
    import pandas as pd

    kinds = [table.frame[column].dtype for table in tables if column is not None]
    declared = [kind.categories for kind in kinds if isinstance(kind, pd.CategoricalDtype)]
    names = [_label(name) for categories in declared for name in categories]
    return tuple(dict.fromkeys(name for name in names if name not in labels))


def _label(value: Any) -> str:
    """What a log calls a mode: whole numbers are the same however they are written."""
    if isinstance(value, float | np.floating) and float(value).is_integer():
        return str(int(value))
    if isinstance(value, bool | np.bool_):
        return str(int(value))
    return str(value).strip()


def _part(
    table: _Table,
    names: tuple[str, ...],
    inputs: tuple[str, ...],
    column: str | None,
    labels: dict[str, int],
) -> Part:
    """One log as arrays."""
    clock = next((name for name in TIMES if name in table.frame.columns), None)
    if clock is None:
        raise ArgumentError(
            f"{table.name} must have a column t of times in seconds, got "
            f"{brief(list(table.frame.columns))}: name it t, and divide it by 1,000 where it "
            "counts milliseconds."
        )
    time = _numbers(table, clock)
    if np.isnan(time).any():
        where = table.place(int(np.flatnonzero(np.isnan(time))[0]))
        raise ArgumentError(f"{where}: {clock} must be a number, got none: leave the row out.")
    late = np.flatnonzero(np.diff(time) <= 0.0)
    if late.size:
        raise ArgumentError(
            f"{table.place(int(late[0]) + 1)}: {clock} must be later than in the row before, got "
            f"{time[late[0] + 1]:.9g} after {time[late[0]]:.9g}: sort the log and keep one row per "
            "instant."
        )
    output = np.column_stack([_numbers(table, name) for name in names])
    entered = np.column_stack([_numbers(table, name) for name in inputs])
    mode = np.zeros(time.size, np.int64)
    if column is not None:
        codes, values = table.frame[column].factorize()
        mode = np.array([labels[_label(value)] for value in values])[codes]
    return Part(*map(read_only, (time, output, entered, mode)))


def _numbers(table: _Table, column: str) -> Float[np.ndarray, " sample"]:
    """A column as numbers, NaN where it has none."""
    import pandas as pd

    if column not in table.frame.columns:
        raise ArgumentError(
            f"{table.name} must have the column {column!r}, got "
            f"{brief(list(table.frame.columns))}: name columns as the log does."
        )
    raw = table.frame[column]
    values = pd.to_numeric(raw, errors="coerce")
    result = np.array(values, dtype=np.float64)
    bad = np.flatnonzero((np.isnan(result) & raw.notna().to_numpy()) | np.isinf(result))
    if bad.size:
        got = brief(raw.astype(object).iloc[int(bad[0])])
        advice = "leave the cell empty where nothing was measured."
        if column in TIMES:
            advice = (
                "count seconds from the first row, and leave out lines that are no samples, such "
                "as one of units."
            )
        raise ArgumentError(
            f"{table.place(int(bad[0]))}: {column} must be a finite number, got {got}: {advice}"
        )
    return result


def _require_moving(parts: tuple[Part, ...], inputs: tuple[str, ...]) -> None:
    """Every input changes somewhere."""
    for j, name in enumerate(inputs):
        values = np.concatenate([part.input[:, j] for part in parts])
        values = values[np.isfinite(values)]
        if values.size == 0 or np.ptp(values) == 0.0:
            raise ArgumentError(
                f"{name} must change, got {'nothing' if values.size == 0 else values[0]} "
                "throughout: an input that never moves tells nothing of its delay or its effect. "
                "Move it, or leave it out by inputs=[…], --inputs."
            )


def _period(parts: tuple[Part, ...]) -> tuple[float, bool]:
    """The sampling period, and whether all samples lie on its grid."""
    step = float(np.median(np.concatenate([np.diff(part.time) for part in parts])))
    whole = sum(part.time.size - 1 for part in parts)
    mean = sum(float(part.time[-1] - part.time[0]) for part in parts) / whole
    if abs(mean - step) < ROUNDED * step:
        step = float(f"{mean:.10g}")  # a clock that rounds is right on average
    grid = [part.time - part.time[0] - step * np.arange(part.time.size) for part in parts]
    off = max(float(np.abs(np.diff(part.time) - step).max()) for part in parts)
    drift = max(float(np.abs(one).max()) for one in grid)
    return step, off <= 2.0 * ROUNDED * step and drift <= 10.0 * ROUNDED * step


def _split_at_gaps(parts: tuple[Part, ...]) -> tuple[Part, ...]:
    """The same where rows of an even log are lost: what the inputs did there is not known."""
    step = float(np.median(np.concatenate([np.diff(part.time) for part in parts])))
    pieces = []
    for part in parts:
        ends = np.flatnonzero(np.diff(part.time) > 1.5 * step) + 1
        rows = np.split(np.arange(part.time.size), ends)
        pieces += [Part(*(column[own] for column in part)) for own in rows if own.size > 1]
    if len(pieces) == len(parts) or not pieces or not _period(tuple(pieces))[1]:
        return parts
    return tuple(pieces)
