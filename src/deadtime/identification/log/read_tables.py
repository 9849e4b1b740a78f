"""Columns, numbers and modes of logs, read from CSV files or tables of pandas."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import brief
from deadtime.base.errors import ArgumentError
from deadtime.switching.log import TIMES

if TYPE_CHECKING:
    import pandas as pd


class LogTable(NamedTuple):
    """A table with its name in messages, the word for its rows, and the number of the first."""

    frame: pd.DataFrame
    name: str
    row: str
    first: int

    def place(self, index: int) -> str:
        return f"{self.name}, {self.row} {index + self.first}"


def table_of(log: Any, number: int, argument: str = "log") -> LogTable:
    import pandas as pd

    if isinstance(log, pd.DataFrame):
        name = argument if number == 0 else f"{argument}[{number}]"
        return LogTable(log.rename(columns=lambda c: str(c).strip()), name, "row", 0)
    try:
        source = Path(log)
    except TypeError:
        raise ArgumentError(
            f"{argument} must be the path of a CSV file or a pandas DataFrame, got "
            f"{type(log).__name__}."
        ) from None
    frame = read_table(source)
    return LogTable(frame.rename(columns=lambda c: str(c).strip()), str(source), "line", 2)


def read_table(source: Path, rows: int | None = None) -> pd.DataFrame:
    """A CSV file with one header line, or its first rows; no column is an index."""
    import pandas as pd

    try:
        with source.open(encoding="utf-8") as lines:
            header = lines.readline(100_000)
        # Countries with decimal commas separate columns by other characters.
        for sign, name in ((";", "semicolons"), ("\t", "tabs")):
            if sign in header and "," not in header:
                raise ArgumentError(
                    f"{source} has {name} between its columns: save it with commas there and "
                    "points in numbers, or give the table that "
                    f"pandas.read_csv(…, sep={sign!r}) makes of it, "
                    'with decimal="," where its numbers have commas.'
                )
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


def chosen_columns(
    table: LogTable, letter: str, given: Sequence[str] | None, argument: str
) -> tuple[str, ...]:
    """The columns of states or inputs, by default those named by a letter and a number.

    letter : several in order of preference
    """
    columns = list(table.frame.columns)
    if given is None:
        chosen = next(filter(None, (columns_of(columns, one) for one in letter)), [])
    elif isinstance(given, str):
        raise ArgumentError(
            f"{argument} must be a list of columns, such as {given.split(',')}, got the text "
            f"{given!r}."
        )
    else:
        chosen = [str(name) for name in given]
    if not chosen:
        raise ArgumentError(
            f"{table.name} must have columns {letter[0]}1, {letter[0]}2, …, got {brief(columns)}: "
            f"name them so, or say which they are by {argument}=[…], --{argument}."
        )
    return tuple(chosen)


def columns_of(columns: Sequence[str], letter: str) -> list[str]:
    """The columns named by a letter and a number, sorted by number.

    Examples
    --------
    >>> columns_of(["t", "x2", "x1: speed (m/s)", "extra"], "x")
    ['x1: speed (m/s)', 'x2']
    """
    form = re.compile(rf"{letter}[ _]?\[?(\d*)\]?(?:: *.+)?")
    places = {name: match[1] for name in columns if (match := form.fullmatch(name))}
    return sorted(places, key=lambda name: int(places[name] or 0))


def numeric_column(table: LogTable, column: str) -> Float[np.ndarray, " sample"]:
    """A column as numbers, NaN for an empty cell."""
    import pandas as pd

    if column not in table.frame.columns:
        raise ArgumentError(
            f"{table.name} must have the column {column!r}, got "
            f"{brief(list(table.frame.columns))}: name columns as the log does."
        )
    raw = table.frame[column]
    dates = raw.dtype.kind in "mM"  # pandas would convert dates to nanoseconds since 1970
    values = raw.map(lambda _: None) if dates else pd.to_numeric(raw, errors="coerce")
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


def mode_column(tables: list[LogTable], modes: str | None) -> str | None:
    """The column of the mode, required in all tables."""
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


def labels_of(tables: list[LogTable], column: str | None) -> dict[str, int]:
    """The number of every mode by its label in the logs."""
    if column is None:
        return {"mode 0": 0}
    labels = set().union(*_visited(tables, column))
    if not all(name.isdecimal() for name in labels):
        return {name: i for i, name in enumerate(sorted(labels))}
    numbers = sorted(map(int, labels))
    if numbers[-1] - numbers[0] >= len(numbers):
        absent = next(i for i in range(numbers[0], numbers[-1]) if i not in numbers)
        raise ArgumentError(
            f"{column}: mode {absent} is never visited, modes {numbers} are: nothing is known of "
            "it. Log a stay in it, or number the modes without a gap."
        )
    return {str(i): place for place, i in enumerate(numbers)}


def labels_among(
    tables: list[LogTable], column: str | None, modes: tuple[str, ...]
) -> dict[str, int]:
    """The number of every mode of a fit by its label; logs that visit others are refused."""
    labels = {name: i for i, name in enumerate(modes)}
    visited = [] if column is None else _visited(tables, column)
    for table, own in zip(tables, visited, strict=False):
        if unknown := sorted(own - labels.keys()):
            raise ArgumentError(
                f"{table.name}: {column} must be one of the modes that were identified, "
                f"{', '.join(modes)}, got {brief(unknown[0])}: nothing is known of it. Identify "
                "from a log that visits it, or leave those rows out."
            )
    return labels


def _visited(tables: list[LogTable], column: str) -> list[set[str]]:
    """The labels of the modes in every table, which are required in every row."""
    every = []
    for table in tables:
        missing = np.flatnonzero(table.frame[column].isna())
        if missing.size:
            raise ArgumentError(
                f"{table.place(int(missing[0]))}: {column} must be there in every row, got none: "
                "fill it with the mode that was active."
            )
        every.append({label(value) for value in table.frame[column].unique()})
    return every


def absent_modes(
    tables: list[LogTable], column: str | None, labels: dict[str, int]
) -> tuple[str, ...]:
    """Modes that a categorical column declares and never visits."""
    import pandas as pd

    kinds = [table.frame[column].dtype for table in tables if column is not None]
    declared = [kind.categories for kind in kinds if isinstance(kind, pd.CategoricalDtype)]
    names = [label(name) for categories in declared for name in categories]
    return tuple(dict.fromkeys(name for name in names if name not in labels))


def label(value: Any) -> str:
    """The name of a mode; 1, 1.0 and True are the same mode."""
    whole = isinstance(value, float | np.floating) and float(value).is_integer()
    if whole or isinstance(value, bool | np.bool_):
        return str(int(value))
    return str(value).strip()
