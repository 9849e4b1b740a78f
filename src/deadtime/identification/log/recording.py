"""Logs from CSV files or tables as arrays, split where rows are lost; errors name the line.

The sampling period is the median distance of rows; rows are even if all lie on its grid to 1 %.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from itertools import groupby
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import brief, read_only
from deadtime.base.errors import ArgumentError
from deadtime.identification.log.read_tables import (
    LogTable,
    absent_modes,
    chosen_columns,
    label,
    labels_among,
    labels_of,
    mode_column,
    numeric_column,
    table_of,
)
from deadtime.switching.log import TIMES

# Stretches of a long log that represent all of it.
_STRETCHES = 10
# Of a period: times rounded by a clock to this accuracy are still on the grid.
ROUNDED = 0.01
_NAMED = re.compile(r"(\w[ _]?\[?\d*\]?): *(.+)")


class Part(NamedTuple):
    """One log: samples at rising times; a missing measurement is NaN.

    rests : whether inputs before the first row equal those of the first row
    after_gap : whether lost rows precede the first row
    """

    time: Float[np.ndarray, " sample"]
    output: Float[np.ndarray, "sample p"]
    input: Float[np.ndarray, "sample m"]
    mode: Int[np.ndarray, " sample"]
    rests: bool = False
    after_gap: bool = False

    def rows(self, own: Int[np.ndarray, " row"] | slice) -> Part:
        """Some consecutive rows; inputs before them are unknown unless the first row is kept."""
        first = self.time[own][:1] == self.time[:1]
        columns = (column[own] for column in self[:4])
        return Part(*columns, rests=self.rests and bool(first.all()))

    def held_out(self, first: int, before: float) -> Part:
        """The rows from `first` on, and with empty outputs those of the seconds before."""
        oldest = np.searchsorted(self.time, self.time[first] - before, side="right") - 1
        late = self.rows(slice(max(int(oldest), 0), None))
        output = late.output.copy()
        output[: late.time.size - self.time.size + first] = np.nan
        return late._replace(output=read_only(output))

    def on_a_grid(self, step: float, hold: int) -> Part:
        """The part resampled on an even grid, states by linear interpolation."""
        time = self.time[0] + step * np.arange(int((self.time[-1] - self.time[0]) / step) + 1)
        # The factor keeps a grid time that round-off puts just below its sample at that sample.
        before = np.searchsorted(self.time, time * (1.0 + 1e-15), side="right") - 1
        y, u = (
            np.column_stack([np.interp(time, self.time, one) for one in columns.T])
            for columns in (self.output, self.input)
        )
        return Part(time, y, u if hold else self.input[before], self.mode[before], self.rests)


class Level(NamedTuple):
    """Values subtracted from outputs (p,) and inputs (m,)."""

    output: Float[np.ndarray, " p"]
    input: Float[np.ndarray, " m"]


class LogColumns(NamedTuple):
    """The columns of a log's tables: of the mode, if it was logged, outputs and inputs."""

    mode: str | None
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]


class Recording(NamedTuple):
    """All logs of one plant.

    step : the median sampling period, seconds
    even : whether all samples lie on one grid up to rounding of times
    outputs, inputs, modes : names
    logged : whether the mode was logged
    absent : modes declared as categories of a table and never visited
    level : the values subtracted from all columns; None if plants rest at 0
    constants : names and values of inputs that never move and are left out
    hold : the degree of the inputs between samples, 0 where they are held, 1 where linear
    columns, logs : the columns that were read, and the names of the logs
    """

    parts: tuple[Part, ...]
    step: float
    even: bool
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    modes: tuple[str, ...]
    logged: bool
    absent: tuple[str, ...] = ()
    level: Level | None = None
    constants: tuple[tuple[str, float], ...] = ()
    hold: int = 0
    columns: LogColumns = LogColumns(None, (), ())
    logs: tuple[str, ...] = ()

    def about(self, level: Level) -> Recording:
        """The recording with a level subtracted."""
        moved = tuple(
            part._replace(output=part.output - level.output, input=part.input - level.input)
            for part in self.parts
        )
        return self._replace(parts=moved, level=level)

    def absolute(self) -> Recording:
        """The recording without its level subtracted."""
        if self.level is None:
            return self
        back = self.about(Level(-self.level.output, -self.level.input))
        return back._replace(level=None)

    @property
    def samples(self) -> int:
        return sum(part.time.size for part in self.parts)

    @property
    def by_log(self) -> list[tuple[Part, ...]]:
        """The parts of every log."""
        log = np.maximum(np.cumsum([not part.after_gap for part in self.parts]) - 1, 0)
        every = zip(log, self.parts, strict=True)
        return [tuple(part for _, part in own) for _, own in groupby(every, itemgetter(0))]

    def divided(self, share: float, before: float) -> tuple[Recording, Recording]:
        """The logs without, and with only, the last share of the rows of each.

        The rows of the last `before` seconds ahead of a held-out part stay in it with empty
        outputs, for their inputs still act there. Its `constants` are those of the first part that
        have another value in it.
        """
        kept, held = [], []
        for parts in self.by_log:
            cut = round((1.0 - share) * sum(part.time.size for part in parts))
            begun = False
            for part in parts:
                if cut > 1:
                    kept.append(part.rows(slice(cut))._replace(after_gap=part.after_gap))
                if cut < part.time.size - 1:
                    late = part.held_out(max(cut, 0), before)
                    held.append(late._replace(after_gap=begun))
                    begun = True
                cut -= part.time.size
        if not kept or not held:
            raise ArgumentError(
                f"test must leave at least 2 rows of a log on either side, got {share:g} of "
                f"{self.samples} rows: log for longer, or give a second log."
            )
        columns = self.columns.inputs
        first, moving, constants = _moving(tuple(kept), columns)
        own = [columns.index(name) for name in moving]
        changed = [
            (name, value)
            for name, value in constants
            for part in held
            if (np.abs(part.input[:, columns.index(name)] - value) > 0.0).any()
        ]
        both = self._replace(
            parts=first,
            inputs=tuple(self.inputs[j] for j in own),
            constants=self.constants + constants,
            columns=self.columns._replace(inputs=moving),
        )
        late = tuple(part._replace(input=read_only(part.input[:, own])) for part in held)
        return both, both._replace(parts=late, constants=tuple(dict.fromkeys(changed)))

    def stretches(self, most: int, lag: int) -> Recording:
        """The recording, or evenly spread stretches of a longer one with about `most` samples.

        Each has `lag` samples more: the inputs that act in its first ones lie before the stretch.
        """
        if self.samples <= 2 * most:
            return self
        parts, share = [], most / self.samples
        for part in self.parts:
            count = max(1, round(_STRETCHES * part.time.size / self.samples))
            every = np.array_split(np.arange(part.time.size), count)
            parts += [part.rows(k[: max(2, int(np.ceil(share * k.size)) + lag)]) for k in every]
        return self._replace(parts=tuple(parts))

    def gridded(self) -> Recording:
        """The recording resampled on an even grid, states by linear interpolation."""
        if self.even:
            return self
        parts = tuple(part.on_a_grid(self.step, self.hold) for part in self.parts)
        return self._replace(parts=parts, even=True)

    def lag(self, delay: float) -> int:
        """The age in samples of the oldest input that acts with a delay in seconds."""
        return int(np.ceil(delay / self.step)) + 1


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
) -> Recording:
    """The recording of a log or a list of logs: paths of CSV files, or pandas tables.

    modes : the column of the mode; None for one mode
    states, inputs : their columns; by default those named by `letter` (y for outputs) or u, alone
        or with a number, after which a name may follow, as in "x1: position (m)"
    check : called with the logs, the columns of outputs and of inputs, the names of logs, and a
        function that names a row of a log
    """
    tables = _tables(logs, "log")
    column = mode_column(tables, modes)
    measured = "states" if letter == "x" else "outputs"
    names = chosen_columns(tables[0], letter, states, measured)
    acting = chosen_columns(tables[0], "u", inputs, "inputs")
    _require_one_role({measured: names, "inputs": acting})
    _require_rows(tables)
    labels = labels_of(tables, column)
    parts = tuple(_part(table, names, acting, column, labels) for table in tables)
    parts, acting, constants = _moving(parts, acting)
    if check is not None:
        called = [table.name for table in tables]
        check(parts, (names, acting), called, lambda i, k: tables[i].place(k))
    parts = _split_at_gaps(parts)
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
        columns=LogColumns(column, names, acting),
        logs=tuple(f"{t.name}[0]" if t.name == "log" and tables[1:] else t.name for t in tables),
    )


def read_beside(logs: Any, recording: Recording, argument: str) -> Recording:
    """Other logs of the plant of a recording: of its columns and modes; inputs may be constant.

    Its `constants` are those inputs that had another value in the recording.
    """
    tables = _tables(logs, argument)
    column, names, acting = recording.columns
    mode_column(tables, column)
    labels = labels_among(tables, column, recording.modes)
    _require_rows(tables)
    parts = _split_at_gaps(tuple(_part(one, names, acting, column, labels) for one in tables))
    moved = tuple(
        (name, value)
        for name, value in recording.constants
        for table in tables
        if name in table.frame.columns and (numeric_column(table, name) != value).any()
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
    )


def _tables(logs: Any, argument: str) -> list[LogTable]:
    given = list(logs) if isinstance(logs, list | tuple) else [logs]
    if not given:
        raise ArgumentError(
            f"{argument} must be a path, a table or a list of them, got an empty list."
        )
    return [table_of(log, number, argument) for number, log in enumerate(given)]


def _require_rows(tables: list[LogTable]) -> None:
    for table in tables:
        if len(table.frame) < 3:
            raise ArgumentError(
                f"{table.name} must have at least 3 rows, got {len(table.frame)}: log for longer."
            )


def _require_one_role(roles: dict[str, tuple[str, ...]]) -> None:
    """Refuse a column with two roles, such as a state that is also an input."""
    taken: dict[str, str] = dict.fromkeys(TIMES, "time")
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


def _part(
    table: LogTable,
    names: tuple[str, ...],
    inputs: tuple[str, ...],
    column: str | None,
    labels: dict[str, int],
) -> Part:
    clock = next((name for name in TIMES if name in table.frame.columns), None)
    if clock is None:
        raise ArgumentError(
            f"{table.name} must have a column t of times in seconds, got "
            f"{brief(list(table.frame.columns))}: name it t, and divide it by 1,000 where it "
            "counts milliseconds."
        )
    time = numeric_column(table, clock)
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
    output = np.column_stack([numeric_column(table, name) for name in names])
    u = np.column_stack([numeric_column(table, name) for name in inputs])
    mode = np.zeros(time.size, np.int64)
    if column is not None:
        codes, values = table.frame[column].factorize()
        mode = np.array([labels[label(value)] for value in values])[codes]
    time, output, u, mode = map(read_only, (time, output, u, mode))
    return Part(time, output, u, mode)


def _moving(
    parts: tuple[Part, ...], inputs: tuple[str, ...]
) -> tuple[tuple[Part, ...], tuple[str, ...], tuple[tuple[str, float], ...]]:
    """Logs with the inputs that change, their names, and the constant inputs with their values."""
    every = np.vstack([part.input for part in parts])
    known = [column[np.isfinite(column)] for column in every.T]
    moves = [values.size > 0 and np.ptp(values) > 0.0 for values in known]
    if not any(moves):
        name, values = inputs[0], known[0]
        raise ArgumentError(
            f"{name} must change, got {'nothing' if values.size == 0 else values[0]} "
            "throughout: an input that never moves tells nothing of its delay or its effect. "
            "Move it, or leave it out by inputs=[…], --inputs."
        )
    empty = [name for name, values in zip(inputs, known, strict=True) if values.size == 0]
    if empty:
        raise ArgumentError(
            f"{empty[0]} must have values, got an empty column: leave it out by inputs=[…], "
            "--inputs."
        )
    each = list(zip(inputs, known, moves, strict=True))
    constants = tuple((name, float(values[0])) for name, values, moving in each if not moving)
    own = np.flatnonzero(moves)
    kept = tuple(part._replace(input=read_only(part.input[:, own])) for part in parts)
    return kept, tuple(name for name, _, moving in each if moving), constants


def _period(parts: tuple[Part, ...]) -> tuple[float, bool]:
    """The sampling period, and whether all samples lie on its grid."""
    step = float(np.median(np.concatenate([np.diff(part.time) for part in parts])))
    whole = sum(part.time.size - 1 for part in parts)
    mean = sum(float(part.time[-1] - part.time[0]) for part in parts) / whole
    if abs(mean - step) < ROUNDED * step:
        step = float(f"{mean:.10g}")  # a rounding clock is right on average
    grid = [part.time - part.time[0] - step * np.arange(part.time.size) for part in parts]
    off = max(float(np.abs(np.diff(part.time) - step).max()) for part in parts)
    drift = max(float(np.abs(one).max()) for one in grid)
    return step, off <= 2.0 * ROUNDED * step and drift <= 10.0 * ROUNDED * step


def _split_at_gaps(parts: tuple[Part, ...]) -> tuple[Part, ...]:
    """Logs divided where rows of an even one are lost: inputs are not known there."""
    step = float(np.median(np.concatenate([np.diff(part.time) for part in parts])))
    pieces = []
    for part in parts:
        ends = np.flatnonzero(np.diff(part.time) > 1.5 * step) + 1
        rows = np.split(np.arange(part.time.size), ends)
        pieces += [part.rows(own)._replace(after_gap=bool(own[0])) for own in rows if own.size > 1]
    if len(pieces) == len(parts) or not pieces or not _period(tuple(pieces))[1]:
        return parts
    return tuple(pieces)
