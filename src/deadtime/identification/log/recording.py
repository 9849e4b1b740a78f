"""Logs as arrays: parts with rows at rising times, and all logs of one plant."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

# Stretches of a long log that represent all of it.
_STRETCHES = 10


class Part(NamedTuple):
    """One log: samples at rising times; a missing measurement is NaN, a mode that is unknown −1.

    rests : whether inputs before the first row equal those of the first row
    after_gap : whether lost rows precede the first row
    """

    time: Float[np.ndarray, " sample"]
    output: Float[np.ndarray, "sample p"]
    input: Float[np.ndarray, "sample m"]
    mode: Int[np.ndarray, " sample"]
    rests: bool = False
    after_gap: bool = False

    @property
    def logged(self) -> Bool[np.ndarray, " sample"]:
        """The rows of which something is known: others were lost."""
        return np.asarray(np.isfinite(np.hstack((self.output, self.input))).any(axis=1))

    def rows(self, own: Int[np.ndarray, " row"] | slice) -> Part:
        """Some consecutive rows; inputs before them are unknown unless the first row is kept."""
        first = self.time[own][:1] == self.time[:1]
        columns = (column[own] for column in self[:4])
        return Part(*columns, rests=self.rests and bool(first.all()))

    def on_a_grid(self, step: float) -> Part:
        """The part resampled on an even grid, states by linear interpolation."""
        time = self.time[0] + step * np.arange(int((self.time[-1] - self.time[0]) / step) + 1)
        # The factor keeps a grid time that round-off puts just below its sample at that sample.
        before = np.searchsorted(self.time, time * (1.0 + 1e-15), side="right") - 1
        output = np.column_stack([np.interp(time, self.time, one) for one in self.output.T])
        return Part(time, output, self.input[before], self.mode[before], self.rests)


class Level(NamedTuple):
    """Values subtracted from outputs (p,) and inputs (m,)."""

    output: Float[np.ndarray, " p"]
    input: Float[np.ndarray, " m"]


class Recording(NamedTuple):
    """All logs of one plant.

    step : the median sampling period, seconds
    even : whether all samples lie on one grid up to rounding of times
    outputs, inputs, modes : names
    logged : whether the mode was logged
    absent : modes declared as categories of a table and never visited
    level : the values subtracted from all columns; None if plants rest at 0
    constants : names and values of inputs that never move and are left out
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
        parts = tuple(part.on_a_grid(self.step) for part in self.parts)
        return self._replace(parts=parts, even=True)

    def lag(self, delay: float) -> int:
        """The age in samples of the oldest input that acts with a delay in seconds."""
        return int(np.ceil(delay / self.step)) + 1
