"""What a regression of one stretch of a log foretells of another one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.identification.log.recording import Part

_TOLD = 0.5  # of what a stretch moves by, that a model of its units leaves at most
_WORSE = 3.0  # times so much is left in the units as they are
_MOST_LAGS = 60  # of inputs, in a regression
LEAST = 20  # rows of a stretch


class RowStretch(NamedTuple):
    """Rows of a log, from `first` to before `last`, of which columns have the same units."""

    part: Part
    first: int
    last: int


class Scaled(NamedTuple):
    """A column, an output's or an input's, and what converts it."""

    output: bool
    place: int
    factor: float


def lags_between(known: RowStretch, other: RowStretch, most: float) -> int:
    """How far back inputs are looked at, in samples, so that half of the rows have it."""
    rows = min(one.last - one.first for one in (known, other))
    return int(max(0, min(np.ceil(most) + 1, rows // 2, _MOST_LAGS)))


def foretells(known: RowStretch, other: RowStretch, lags: int) -> bool:
    """Whether a stretch does what another one foretells, of one output at least."""
    return bool(_left(known, other, lags).min() < _TOLD)


def only_scaled(known: RowStretch, other: RowStretch, scaled: Scaled, lags: int) -> bool:
    """Whether a stretch does what another one foretells if a column is converted, and else not.

    It must be clear of one output, and better on the whole. Without the column it must be worse,
    too: what noise makes of a column that hardly moves is no foretelling.
    """
    left, as_it_is = _left(known, other, lags, scaled), _left(known, other, lags)
    without = _left(known, other, lags, scaled._replace(factor=0.0))
    clear = (left < _TOLD) & (np.minimum(as_it_is, without) > _WORSE * left)
    return bool(clear.any()) and float(left.mean()) < float(as_it_is.mean())


class _Rows(NamedTuple):
    """Periods: outputs at their beginning, inputs then and before, how far outputs move, modes."""

    output: Float[np.ndarray, "row p"]
    past: Float[np.ndarray, "row lag m"]
    moved: Float[np.ndarray, "row p"]
    mode: Int[np.ndarray, " row"]

    def of(self, mode: int) -> _Rows:
        """Those of one mode."""
        own = self.mode == mode
        return _Rows(*(column[own] for column in self))

    def acting(self, lags: Sequence[int]) -> Float[np.ndarray, "row z"]:
        """Outputs, and of every input two samples, from a lag on."""
        columns = [self.past[:, lag : lag + 2, j] for j, lag in enumerate(lags)]
        return np.hstack((self.output, *columns))


def _left(
    known: RowStretch, other: RowStretch, lags: int, scaled: Scaled | None = None
) -> Float[np.ndarray, " p"]:
    """What regressions of one stretch leave of how far another moves: shares of squares."""
    told, asked = _rows(known, lags, None), _rows(other, lags, scaled)
    rest, total = np.zeros((2, asked.moved.shape[1]))
    for i in np.unique(asked.mode).tolist():
        own, his = told.of(i), asked.of(i)
        if len(own.moved) < LEAST + 2 * own.acting([0] * own.past.shape[2]).shape[1]:
            continue
        chosen = _delays(own)
        P = np.linalg.lstsq(own.acting(chosen), own.moved, rcond=None)[0]
        rest += ((his.moved - his.acting(chosen) @ P) ** 2).sum(axis=0)
        total += (his.moved**2).sum(axis=0)
    return np.divide(rest, total, out=np.full(total.size, np.inf), where=total > 0.0)


def _delays(rows: _Rows) -> list[int]:
    """The lags of all inputs, one after the other, from which on two samples explain most."""
    chosen: list[int] = []
    spread = np.maximum(rows.moved.std(axis=0), 1e-300)
    for _ in range(rows.past.shape[2]):
        tried = []
        for lag in range(max(1, rows.past.shape[1] - 1)):
            z = rows.acting([*chosen, lag])
            P = np.linalg.lstsq(z, rows.moved, rcond=None)[0]
            tried.append(float((((rows.moved - z @ P) / spread) ** 2).sum()))
        chosen.append(int(np.argmin(tried)))
    return chosen


def _rows(one: RowStretch, lags: int, scaled: Scaled | None) -> _Rows:
    """The periods of a stretch of which all is known."""
    output, entered = one.part.output.copy(), one.part.input.copy()
    if scaled is not None:
        column = output if scaled.output else entered
        column[:, scaled.place] *= scaled.factor
    k = np.arange(one.first + lags, one.last - 1)
    past = entered[k[:, None] - np.arange(lags + 1)]
    moved = output[k + 1] - output[k]
    good = np.isfinite(past).all(axis=(1, 2))
    good &= np.isfinite(output[k]).all(axis=1) & np.isfinite(moved).all(axis=1)
    return _Rows(*(part[good] for part in (output[k], past, moved, one.part.mode[k])))
