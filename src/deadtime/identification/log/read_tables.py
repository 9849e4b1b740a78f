"""Columns, numbers and modes of logs, read from text files or tables of pandas."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from deadtime.base.checks import brief
from deadtime.base.errors import ArgumentError
from deadtime.base.row_clocks import TIMES, clock_of, require_rising
from deadtime.base.text_tables import advice_on, numbers_in, read_text_table, with_points
from deadtime.identification.log.read_options import PLAIN, ReadOptions
from deadtime.identification.log.row_grid import snapped

if TYPE_CHECKING:
    import pandas as pd

# Of mode columns: other texts for no value, such as shutdown, may be modes.
_NO_MODE = frozenset(("", "nan", "null", "none", "na", "n/a", "#n/a", "<na>", "bad"))
_EVIDENCE = 7.0  # repeats expected by chance of which none is there: a chance of e⁻⁷
_OFTEN = 0.3  # share of empty cells in a log on change: few are lost readings
_MOST_MODES = 20
_MOSTLY = 0.5  # share of empty cells of an input that are no mere loss


class LogTable(NamedTuple):
    """A table with its name in messages, the word for its rows, and their numbers.

    decimal : the sign of decimals in texts; read_as : phrases on how it was read
    """

    frame: pd.DataFrame
    name: str
    row: str
    numbers: Sequence[int]
    decimal: str = "."
    read_as: tuple[str, ...] = ()

    def place(self, index: int) -> str:
        return f"{self.name}, {self.row} {self.numbers[index]}"

    def with_phrases(self, *phrases: str) -> LogTable:
        return self._replace(read_as=(*self.read_as, *filter(None, phrases)))

    def rows(self, kept: Sequence[int]) -> LogTable:
        numbers = [self.numbers[k] for k in kept]
        return self._replace(frame=self.frame.iloc[list(kept)], numbers=numbers)

    def require(self, column: str, hint: str) -> None:
        if column not in self.frame.columns:
            raise ArgumentError(
                f"{self.name} must have the column {column!r}, got "
                f"{brief(list(self.frame.columns))}: {hint}"
            )


class TimedTable(NamedTuple):
    """A table with a row per instant, its column of times, and the times in seconds.

    Times count from the first row, unless the log counts seconds of its own.
    """

    table: LogTable
    clock: str | None
    seconds: Float[np.ndarray, " row"]


def table_of(
    log: Any, number: int, options: ReadOptions = PLAIN, argument: str = "log"
) -> LogTable:
    import pandas as pd

    if isinstance(log, pd.DataFrame):
        name = argument if number == 0 else f"{argument}[{number}]"
        frame = log.rename(columns=lambda c: str(c).strip())
        return LogTable(frame, name, "row", range(len(frame)))
    try:
        source = Path(log)
    except TypeError:
        raise ArgumentError(
            f"{argument} must be the path of a CSV file or a pandas DataFrame, got "
            f"{type(log).__name__}."
        ) from None
    wanted = TIMES if options.time is None else (options.time,)
    text = read_text_table(source, options.sep, options.decimal, wanted)
    frame = pd.DataFrame(text.columns, dtype=object)
    return LogTable(frame, text.name, "line", text.lines, text.decimal, text.read_as)


def timed(table: LogTable, options: ReadOptions) -> TimedTable:
    """The times of a table, on an even grid if they were rounded, without repeated rows."""
    if options.step is not None:
        given = options.time or next((c for c in TIMES if c in table.frame.columns), None)
        phrase = f"rows every {options.step:g} s" + (f", not as {given} says" if given else "")
        return TimedTable(
            table.with_phrases(phrase), None, options.step * np.arange(len(table.frame))
        )
    column = clock_column(table, options.time)
    seconds, first, notation = _clock(table, column)
    grid = snapped(seconds)
    if grid is None:
        cells = table.frame[column].to_list()

        def same(i: int, j: int) -> bool:
            return table.frame.iloc[i].equals(table.frame.iloc[j])

        kept = require_rising(seconds, same, table.place, column, cells)
        if len(kept) < len(seconds):
            lost = len(seconds) - len(kept)
            table, seconds = table.rows(kept), seconds[kept]
            table = table.with_phrases(f"{lost} repeated row{'s' * (lost > 1)} left out")
            grid = snapped(seconds)
    if grid is None:
        return TimedTable(table.with_phrases(notation), column, seconds + first)
    phrase = f"times rounded to {grid.resolution:g} s put on an even grid of {grid.step:.6g} s"
    return TimedTable(
        table.with_phrases(notation, phrase), column, grid.seconds + (seconds[0] + first)
    )


def clock_column(table: LogTable, time: str | None) -> str:
    if time is not None:
        table.require(time, 'name its column of times by time="…", --time.')
        return time
    column = next((name for name in TIMES if name in table.frame.columns), None)
    if column is None:
        raise ArgumentError(
            f"{table.name} must have a column t of times in seconds, got "
            f'{brief(list(table.frame.columns))}: name it by time="…", --time, or give the '
            f"sampling period as step, --step.{suggestion(table)}"
        )
    return column


def _clock(table: LogTable, column: str) -> tuple[Float[np.ndarray, " row"], float, str]:
    """Times from the first row, the first on a clock of seconds, and a phrase."""
    raw = table.frame[column]
    missing = np.flatnonzero(raw.isna())
    if missing.size:
        where = table.place(int(missing[0]))
        raise ArgumentError(f"{where}: {column} must be a number, got none: leave the row out.")
    if raw.dtype.kind in "mM" and len(raw):
        moves = (raw - raw.iloc[0]).to_numpy("timedelta64[ns]").astype(np.int64)
        since = f"times from {str(raw.iloc[0])[:19]}" if raw.dtype.kind == "M" else ""
        return moves / 1e9, 0.0, since
    if raw.dtype.kind in "iuf" and len(raw) and abs(raw.iloc[0]) < 1e8:
        seconds = raw.to_numpy(np.float64)
        bad = np.flatnonzero(np.isinf(seconds))
        if bad.size:
            raise ArgumentError(f"{table.place(int(bad[0]))}: {column} must be finite.")
        return seconds, 0.0, ""
    cells = texts_of(table, column)
    seconds, _, bad = numbers_in(cells, table.decimal)
    if bad is None and np.isfinite(seconds).all() and np.abs(seconds[:1]).max(initial=0.0) < 1e8:
        return seconds, 0.0, ""
    clock = clock_of(with_points(cells, table.decimal), table.place, column)
    return clock.seconds, clock.first, clock.notation


def texts_of(table: LogTable, column: str) -> list[str]:
    """Cells as texts; empty where there is none."""
    raw = table.frame[column]
    if table.row == "line" and not raw.isna().to_numpy().any():
        return raw.to_list()  # of a file they are
    return ["" if no else str(cell).strip() for cell, no in zip(raw, raw.isna(), strict=True)]


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
            f"{suggestion(table)}"
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


def suggestion(table: LogTable) -> str:
    """A command with the columns of a file in place, its roles guessed from their values."""
    if table.row != "line":
        return ""
    frame = table.frame.iloc[:1000]
    columns = list(frame.columns)
    clock = next((one for one in columns if re.match(r"(?i)t$|time|date|stamp|zeit", one)), None)
    numbers, texts = [], []
    for name in columns:
        values, _, bad = numbers_in(texts_of(table._replace(frame=frame), name), table.decimal)
        if name == clock:
            continue
        if bad is None and np.isfinite(values).any():
            known = values[np.isfinite(values)]
            numbers.append((name, float(np.mean(known[1:] != known[:-1])) if len(known) > 1 else 0))
        elif bad is not None and is_of_few_texts(table._replace(frame=frame), name):
            texts.append(name)
    # Inputs are held for some rows, measurements are not.
    inputs = [name for name, moves in numbers if 0.0 < moves < 0.5]
    inputs = inputs or [name for name, _ in numbers[-1:]]
    states = [name for name, _ in numbers if name not in inputs]
    options = [("--time", [clock])] if clock not in (None, *TIMES) else []
    options += [] if clock is not None else [("--step", ["SECONDS"])]
    options += [("--states", states)] * (not columns_of(columns, "x"))
    options += [("--inputs", inputs)] * (not columns_of(columns, "u"))
    options += [("--modes", texts[:1])] * ("mode" not in columns)
    words = ["deadtime identify", quoted(table.name)]
    for option, names in options:
        joined = [",".join(names)] if names and not any("," in one for one in names) else names
        words += [f"{option} {quoted(name)}" for name in joined]
    return f" For this file perhaps: {' '.join(words)}"


def is_of_few_texts(table: LogTable, column: str) -> bool:
    """Whether a column holds some texts, again and again, as one of a mode does."""
    cells = texts_of(table, column)
    few = 1 < len(set(cells)) <= min(_MOST_MODES, len(cells) // 3)
    return few and numbers_in(cells, table.decimal)[2] is not None


def quoted(text: str) -> str:
    if re.fullmatch(r"[\w./,:+-]+", text):
        return text
    return '"' + re.sub(r'(["\\$`])', r"\\\1", text) + '"'


def numeric_column(table: LogTable, column: str) -> tuple[Float[np.ndarray, " row"], str]:
    """A column as numbers, NaN for a missing one, and a phrase on texts for no value."""
    table.require(column, "name columns as the log does.")
    raw = table.frame[column]
    if raw.dtype.kind in "iufb":
        result, missing, bad = raw.to_numpy(np.float64), {}, None
    else:  # pandas would convert dates to nanoseconds since 1970
        dates = raw.dtype.kind in "mM"
        cells = texts_of(table, column)
        found = numbers_in(cells, table.decimal)
        result, missing, bad = (*found[:2], 0) if dates else found
    infinite = np.flatnonzero(np.isinf(result))
    if bad is None and infinite.size:
        bad = int(infinite[0])
    if bad is not None:
        got = raw.astype(object).iloc[bad]
        raise ArgumentError(
            f"{table.place(bad)}: {column} must be a finite number, got {brief(got)}: "
            f"{advice_on(str(got))}"
        )
    each = (f"{count} cell{'s' * (count > 1)} {text!r}" for text, count in missing.items())
    listed = " and ".join(each)
    return result, f"{listed} in {column} taken as missing" if listed else ""


def held(table: LogTable, column: str, option: Sequence[str]) -> Bool[np.ndarray, " row"] | None:
    """The cells that are empty because the value before still holds; None if the log shows none.

    Were cells empty by loss, some values would be equal to the last one recorded. So many empty
    cells with never an equal value, where chance would make some, are those of a log on change.
    """
    raw = table.frame[column]
    if raw.dtype.kind in "iufb" and not raw.isna().to_numpy().any():
        return None
    cells = texts_of(table, column)
    empty = np.array([not cell for cell in cells])
    if column in option:
        return empty
    filled = [cell for cell in cells if cell]
    share = 1.0 - len(filled) / max(len(cells), 1)
    if not filled or share == 0.0:
        return None
    counts = np.unique(filled, return_counts=True)[1] / len(filled)
    same = sum(a == b for a, b in pairwise(filled))
    expected = (len(filled) - 1) * float(counts @ counts)
    if share > _OFTEN and not same and bool(cells[0]) and expected >= _EVIDENCE:
        return empty
    if share > _MOSTLY:
        raise ArgumentError(
            f"{table.name} has {int(empty.sum()):,} empty cells in {len(cells):,} of {column}: if "
            f"the value before holds there, say on_change=[{column!r}], --on-change "
            f"{quoted(column)}; else leave {column} out, or log it."
        )
    return None


def mode_column(tables: list[LogTable], modes: str | None) -> str | None:
    """The column of the mode, required in all tables; the default one if any has it."""
    if modes is None or (modes == "mode" and not any("mode" in t.frame.columns for t in tables)):
        return None
    for table in tables:
        table.require(
            modes,
            "log the mode, name its column by modes=, say modes=None (--one-mode) for a plant of "
            "one mode, or modes=2 (--modes 2) for two that were not logged.",
        )
    return modes


def labels_of(tables: list[LogTable], column: str | None) -> dict[str, int]:
    """The number of every mode by its label in the logs."""
    if column is None:
        return {"mode 0": 0}
    labels = set().union(*_visited(tables, column))
    if not all(name.isdecimal() and len(name) < 10 for name in labels):
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
        texts = mode_texts(table, column)
        if "" in texts:
            raise ArgumentError(
                f"{table.place(texts.index(''))}: {column} must be there in every row, got none: "
                "fill it with the mode that was active."
            )
        every.append(set(texts))
    return every


def mode_texts(table: LogTable, column: str) -> list[str]:
    """The label of the mode in every row, "" where there is none."""
    names = {value: label(value, table.decimal) for value in table.frame[column].dropna().unique()}
    raw = table.frame[column]
    return ["" if no else names[value] for value, no in zip(raw, raw.isna(), strict=True)]


def absent_modes(
    tables: list[LogTable], column: str | None, labels: dict[str, int]
) -> tuple[str, ...]:
    """Modes that a categorical column declares and never visits."""
    import pandas as pd

    kinds = [table.frame[column].dtype for table in tables if column is not None]
    declared = [kind.categories for kind in kinds if isinstance(kind, pd.CategoricalDtype)]
    names = [label(name) for categories in declared for name in categories]
    return tuple(dict.fromkeys(name for name in names if name not in labels))


def label(value: Any, decimal: str = ".") -> str:
    """The name of a mode; 1, 1.0, "1.0" and True are the same mode.

    Examples
    --------
    >>> [label(value) for value in (1, 1.0, "01.0", True, "true", " ice ", "NaN")]
    ['1', '1', '1', '1', '1', 'ice', '']
    """
    text = str(value).strip()
    if text.lower() in _NO_MODE:
        return ""
    if text.lower() in ("true", "false"):
        return str(int(text.lower() == "true"))
    found, _, bad = numbers_in([text], decimal)
    if bad is None and found[0].is_integer() and found[0] >= 0.0:
        return str(int(found[0]))
    return text
