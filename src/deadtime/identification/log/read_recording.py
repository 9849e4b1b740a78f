"""Logs from files or tables as arrays on the rows' grid; errors name the line.

The sampling period is the median distance of rows; rows are even if all lie on its grid to 1 %.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from deadtime.base.checks import brief, read_only
from deadtime.base.errors import ArgumentError
from deadtime.base.wording import number_of
from deadtime.identification.log.read_options import PLAIN, ReadOptions
from deadtime.identification.log.read_tables import (
    LogTable,
    TimedTable,
    absent_modes,
    chosen_columns,
    held,
    is_of_few_texts,
    labels_among,
    labels_of,
    mode_column,
    mode_texts,
    numeric_column,
    quoted,
    table_of,
    timed,
)
from deadtime.identification.log.recording import LogColumns, Part, Recording, moving_inputs
from deadtime.identification.log.row_grid import split_at_gaps, with_lost_rows

# Of a period: times rounded by a clock to this accuracy are still on the grid.
_ROUNDED = 0.01
_NAMED = re.compile(r"(\w[ _]?\[?\d*\]?): *(.+)")


Check = Callable[
    [tuple[Part, ...], tuple[Sequence[str], Sequence[str]], list[str], Callable[[int, int], str]],
    None,
]


def read_recording(
    logs: Any,
    modes: str | None,
    states: Sequence[str] | None = None,
    inputs: Sequence[str] | None = None,
    letter: str = "x",
    check: Check | None = None,
    options: ReadOptions = PLAIN,
) -> Recording:
    """The recording of a log or a list of logs: paths of text files, or pandas tables.

    modes : the column of the mode; None for one mode
    states, inputs : their columns; by default those named by `letter` (y for outputs) or u, alone
        or with a number, after which a name may follow, as in "x1: position (m)"
    check : called with the logs, the columns of outputs and of inputs, the names of logs, and a
        function that names a row of a log
    """
    tables = _tables(logs, "log", options)
    column = mode_column(tables, modes)
    measured = "states" if letter == "x" else "outputs"
    names = chosen_columns(tables[0], letter, states, measured)
    acting = chosen_columns(tables[0], "u", inputs, "inputs")
    _require_rows(tables)
    for name in options.on_change:
        if name not in (*acting, column):
            raise ArgumentError(
                "on_change, --on-change, must name inputs or the column of the mode, got "
                f"{brief(name)}: inputs are {', '.join(acting)}."
            )
    timed_tables = [timed(table, options) for table in tables]
    _require_one_role({measured: names, "inputs": acting}, timed_tables[0].clock)
    filled = [_with_held_modes(one, column, options.on_change) for one in timed_tables]
    tables = [one.table for one in filled]
    labels = labels_of(tables, column)
    read = [_part(one, names, acting, column, labels, options.on_change) for one in filled]
    parts = tuple(part._replace(log=i) for i, (part, _) in enumerate(read))
    parts, acting, constants = moving_inputs(parts, acting)
    if check is not None:
        called = [table.name for table in tables]
        check(parts, (names, acting), called, lambda i, k: tables[i].place(k))
    parts = _with_lost_rows(parts, len(labels) > 1)
    read_as = [table.read_as for _, table in read]
    for i, phrases in enumerate(read_as):
        if lost := sum(int((~part.logged).sum()) for part in parts if part.log == i):
            read_as[i] = *phrases, f"{number_of(lost, 'row')} lost, of which nothing is known"
    # The name of a column "x1: position (m)" is the text after the colon.
    called, moved = (
        tuple(match[2] if (match := _NAMED.fullmatch(one)) else one for one in columns)
        for columns in (names, acting)
    )
    return Recording(
        parts,
        *_period(parts),
        called,
        moved,
        tuple(labels),
        logged=column is not None,
        absent=absent_modes(tables, column, labels),
        constants=constants,
        columns=LogColumns(column, names, acting, options),
        logs=tuple(f"{t.name}[0]" if t.name == "log" and tables[1:] else t.name for t in tables),
        read_as=(*_read_as(tables, read_as), *_of_one_mode(filled[0], modes, column)),
    )


def read_beside(logs: Any, recording: Recording, argument: str) -> Recording:
    """Other logs of the plant of a recording: of its columns and modes; inputs may be constant.

    Its `constants` are those inputs that had another value in the recording.
    """
    column, names, acting, options = recording.columns
    tables = _tables(logs, argument, options)
    if column is not None:
        for table in tables:
            table.require(column, "log the mode there, too.")
    _require_rows(tables)
    filled = [_with_held_modes(timed(one, options), column, options.on_change) for one in tables]
    tables = [one.table for one in filled]
    labels = labels_among(tables, column, recording.modes)
    read = [_part(one, names, acting, column, labels, options.on_change) for one in filled]
    parts = tuple(part._replace(log=i) for i, (part, _) in enumerate(read))
    parts = _with_lost_rows(parts, len(labels) > 1)
    moved = tuple(
        (name, value)
        for name, value in recording.constants
        for table in tables
        if name in table.frame.columns
        and (np.abs(numeric_column(table, name)[0] - value) > 0.0).any()
    )
    step, even = _period(parts)
    return recording._replace(
        parts=parts,
        step=step,
        even=even,
        absent=(),
        level=None,
        constants=tuple(dict.fromkeys(moved)),
        logs=tuple(table.name for table in tables),
        read_as=tuple(_read_as(tables, [table.read_as for _, table in read])),
    )


def _tables(logs: Any, argument: str, options: ReadOptions) -> list[LogTable]:
    given = list(logs) if isinstance(logs, list | tuple) else [logs]
    if not given:
        raise ArgumentError(
            f"{argument} must be a path, a table or a list of them, got an empty list."
        )
    return [table_of(log, number, options, argument) for number, log in enumerate(given)]


def _require_rows(tables: list[LogTable]) -> None:
    for table in tables:
        if len(table.frame) < 3:
            raise ArgumentError(
                f"{table.name} must have at least 3 rows, got {len(table.frame)}: log for longer."
            )


def _read_as(tables: list[LogTable], phrases: list[tuple[str, ...]]) -> list[str]:
    """A sentence on how each log was read, if not as a plain CSV file; one for logs alike."""
    if len(set(phrases)) == 1:
        return [f"Read as: {'; '.join(phrases[0])}."] if phrases[0] else []
    each = zip(tables, phrases, strict=True)
    return [f"{table.name} read as: {'; '.join(one)}." for table, one in each if one]


def _of_one_mode(one: TimedTable, modes: str | None, column: str | None) -> list[str]:
    if modes is None or column is not None:
        return []
    others = [name for name in one.table.frame.columns if name != one.clock]
    texts = [name for name in others if is_of_few_texts(one.table, name)]
    hints = (f" If {one} is the mode, say modes={one!r}, --modes {quoted(one)}." for one in texts)
    return [f"No column {modes}: one mode.{next(hints, '')}"]


def _require_one_role(roles: dict[str, tuple[str, ...]], clock: str | None) -> None:
    """Refuse a column with two roles, such as a state that is also an input."""
    taken: dict[str, str] = {} if clock is None else {clock: "time"}
    for role, columns in roles.items():
        for column in columns:
            before = taken.setdefault(column, role)
            if before != role or columns.count(column) > 1:
                both = f"{before} and {role}" if before != role else role
                options = f"{role}=[…], --{role}"
                if before in roles and before != role:
                    options = f"{before}=[…], --{before}, and {options}"
                raise ArgumentError(
                    f"{both} must be different columns, got {column!r} twice: say which are "
                    f"which by {options}."
                )


def _with_held_modes(one: TimedTable, column: str | None, option: Sequence[str]) -> TimedTable:
    """The table with modes filled where they were logged on change."""
    if column is None or (empty := held(one.table, column, option)) is None:
        return one
    raw = one.table.frame[column]
    frame = one.table.frame.assign(**{column: raw.mask(empty).ffill()})
    return one._replace(table=one.table._replace(frame=frame).with_phrases(_of_change(column)))


def _of_change(column: str) -> str:
    return f"{column} logged on change, so that its value holds in empty cells"


def _part(
    one: TimedTable,
    names: tuple[str, ...],
    inputs: tuple[str, ...],
    column: str | None,
    labels: dict[str, int],
    option: Sequence[str],
) -> tuple[Part, LogTable]:
    """The arrays of a log, and its table with phrases on missing values."""
    table, columns = one.table, []
    for name in (*names, *inputs):
        values, phrase = numeric_column(table, name)
        table = table.with_phrases(phrase)
        if name in inputs and (empty := held(table, name, option)) is not None:
            last = np.maximum.accumulate(np.where(empty, 0, np.arange(values.size)))
            values, table = values[last], table.with_phrases(_of_change(name))
        columns.append(values)
    output = np.column_stack(columns[: len(names)])
    u = np.column_stack(columns[len(names) :])
    mode = np.zeros(one.seconds.size, np.int64)
    if column is not None:
        mode = np.array([labels[text] for text in mode_texts(table, column)], np.int64)
    time, output, u, mode = map(read_only, (one.seconds, output, u, mode))
    return Part(time, output, u, mode), table


def _period(parts: tuple[Part, ...]) -> tuple[float, bool]:
    """The sampling period, and whether all samples lie on its grid."""
    step = float(np.median(np.concatenate([np.diff(part.time) for part in parts])))
    whole = sum(part.time.size - 1 for part in parts)
    mean = sum(float(part.time[-1] - part.time[0]) for part in parts) / whole
    if abs(mean - step) < _ROUNDED * step:
        step = float(f"{mean:.10g}")  # a rounding clock is right on average
    grid = [part.time - part.time[0] - step * np.arange(part.time.size) for part in parts]
    off = max(float(np.abs(np.diff(part.time) - step).max()) for part in parts)
    drift = max(float(np.abs(one).max()) for one in grid)
    return step, off <= 2.0 * _ROUNDED * step and drift <= 10.0 * _ROUNDED * step


def _with_lost_rows(parts: tuple[Part, ...], several: bool) -> tuple[Part, ...]:
    """Logs with rows of NaN for lost ones, if they are even else."""
    step, even = _period(parts)
    if even:
        return parts
    pieces = tuple(piece for part in parts for piece in split_at_gaps(part, step))
    if not pieces or not _period(pieces)[1]:
        return parts
    step = _period(pieces)[0]
    filled = tuple(one for part in parts for one in with_lost_rows(part, step, several))
    return filled if filled and _period(filled)[1] else pieces
