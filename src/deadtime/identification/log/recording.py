"""Logs as arrays: parts with rows at rising times, and all logs of one plant."""

from __future__ import annotations

from itertools import groupby
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from deadtime.base.checks import read_only
from deadtime.base.errors import ArgumentError
from deadtime.identification.log.read_options import PLAIN, ReadOptions

# Stretches of a long log that represent all of it.
_STRETCHES = 10


class Part(NamedTuple):
    """One log: samples at rising times; a missing measurement is NaN, a mode that is unknown −1.

    rests : whether inputs before the first row equal those of the first row
    after_gap : whether lost rows precede the first row
    log : the number of the log
    """

    time: Float[np.ndarray, " sample"]
    output: Float[np.ndarray, "sample p"]
    input: Float[np.ndarray, "sample m"]
    mode: Int[np.ndarray, " sample"]
    rests: bool = False
    after_gap: bool = False
    log: int = 0

    @property
    def logged(self) -> Bool[np.ndarray, " sample"]:
        """The rows of which something is known: others were lost."""
        return np.asarray(np.isfinite(np.hstack((self.output, self.input))).any(axis=1))

    def rows(self, own: Int[np.ndarray, " row"] | slice) -> Part:
        """Some consecutive rows; inputs before them are unknown unless the first row is kept."""
        first = self.time[own][:1] == self.time[:1]
        columns = (column[own] for column in self[:4])
        return Part(*columns, rests=self.rests and bool(first.all()), log=self.log)

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
        own = y, u if hold else self.input[before], self.mode[before]
        return Part(time, *own, self.rests, log=self.log)


class Level(NamedTuple):
    """Values subtracted from outputs (p,) and inputs (m,)."""

    output: Float[np.ndarray, " p"]
    input: Float[np.ndarray, " m"]


class LogColumns(NamedTuple):
    """The columns of a log's tables, of the mode if it was logged, and how files were read."""

    mode: str | None
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    options: ReadOptions = PLAIN


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
    read_as : sentences on how the files were read
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
    read_as: tuple[str, ...] = ()

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
        """The number of rows, without lost ones."""
        return sum(int(part.logged.sum()) for part in self.parts)

    @property
    def rows(self) -> int:
        """The number of rows, lost ones included."""
        return sum(part.time.size for part in self.parts)

    @property
    def by_log(self) -> list[tuple[Part, ...]]:
        """The parts of every log."""
        return [tuple(own) for _, own in groupby(self.parts, attrgetter("log"))]

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
        first, moving, constants = moving_inputs(tuple(kept), columns)
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
        if self.rows <= 2 * most:
            return self
        parts, share = [], most / self.rows
        for part in self.parts:
            count = max(1, round(_STRETCHES * part.time.size / self.rows))
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


def moving_inputs(
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
