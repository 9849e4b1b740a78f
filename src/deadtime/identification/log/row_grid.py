"""The even grid of rows: times that a coarse clock rounded, and rows that were lost.

**Rounded times.** If all times are multiples of a resolution r, and there are a and h with

    |t_k − a − h n_k| ≤ r/2    for all rows, n_k their places on the grid,

then rounding explains why they are uneven, and rows are taken to lie on the grid. Of jitter beyond
r/2 no such a and h exist. The range of h is found by two linear programs over the corners of the
convex hull of (n_k, t_k). Of it the simplest fraction is taken, as of a clock that was set.

**Lost rows** of an even log become rows of which nothing is known. So they cost the periods that
read them, and no others. A long gap begins a new part instead, as all inputs before it are too old.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from deadtime.identification.log.recording import Part

# Seconds. Not 20 ms: rows that a controller logs in its scans have their times.
_RESOLUTIONS = (60.0, *(10.0**-k for k in range(7)))
_FEWEST = 20  # rows: some grid is near enough to fewer
_ROUND_OFF = 1e-6  # of a resolution
_OFTEN = 0.05  # share of the steps between rows that differ from the usual one
_BY_CHANCE = 0.05  # number of fractions in a range below which one is no chance
_FINE = 0.01  # of a period: a resolution that hardly matters
_LOST = 1.5  # of a period: a longer step has lost rows
_ON_GRID = 0.1  # of a period: a gap that is no more off a whole number of periods stays on the grid
_LONG = 100  # periods: a longer gap begins a new part


class RowGrid(NamedTuple):
    """Times on a grid from the first row, seconds, its period, and the clock's resolution."""

    seconds: Float[np.ndarray, " row"]
    step: float
    resolution: float


def snapped(seconds: Float[np.ndarray, " row"]) -> RowGrid | None:
    """The even grid of times that were rounded; None if rounding does not explain them.

    Examples
    --------
    >>> grid = snapped(np.round(np.arange(90) / 30.0, 2))
    >>> grid.resolution, round(grid.step, 5)
    (0.01, 0.03333)
    """
    moves = np.diff(seconds)
    if seconds.size < _FEWEST or (moves < 0.0).any():
        return None
    resolution = _resolution(seconds)
    if resolution is None:
        return None
    # Steps that seldom differ are lost rows, or errors: of rounded times many differ.
    _, counts = np.unique(np.round(moves / resolution), return_counts=True)
    if counts.max() <= (1.0 - _OFTEN) * moves.size:
        grid = _grid(np.arange(seconds.size, dtype=float), seconds, resolution)
        if grid is not None:
            return grid
    usual = moves[moves < _LOST * np.median(moves)]
    if not (moves > 0.0).all() or np.ptp(usual) <= 2.0 * _FINE * usual.mean():
        return None
    places = np.cumsum(np.maximum(np.round(moves / usual.mean()), 1.0))
    return _grid(np.append(0.0, places), seconds, resolution)


def _grid(
    places: Float[np.ndarray, " row"], seconds: Float[np.ndarray, " row"], resolution: float
) -> RowGrid | None:
    """The grid of times rounded to a resolution, at given places of it; None if there is none."""
    steps = _steps(places, seconds, (0.5 + _ROUND_OFF) * resolution)
    if steps is None or resolution < _FINE * steps[0]:
        return None
    h = _simplest(*steps)
    return RowGrid(h * places, h, resolution)


def _steps(
    places: Float[np.ndarray, " row"], seconds: Float[np.ndarray, " row"], reach: float
) -> tuple[float, float] | None:
    """The least and the largest h with |t − a − h n| ≤ reach for some a; None if there is none."""
    from scipy.optimize import linprog
    from scipy.spatial import ConvexHull

    a, h = np.linalg.lstsq(np.vander(places, 2)[:, ::-1], seconds, rcond=None)[0]
    rest, last = (seconds - a - h * places) / reach, places[-1]
    if np.ptp(rest) > 4.0:  # least squares is not so far off the best fit
        return None
    points = np.column_stack((places / last, rest))
    n, y = points[ConvexHull(points).vertices].T  # the other rows lie between these
    one = np.ones(n.size)
    within = np.vstack((np.column_stack((one, n)), -np.column_stack((one, n))))
    limits, free = np.concatenate((1.0 + y, 1.0 - y)), [(None, None)] * 2
    found = [linprog([0.0, sign], within, limits, bounds=free) for sign in (1.0, -1.0)]
    if any(one.x is None for one in found):
        return None
    low, high = (float(h + one.x[1] * reach / last) for one in found)
    return low, high


def _simplest(low: float, high: float) -> float:
    """A period in a range: the simplest fraction if chance has none so simple there, or the middle.

    Some 0.3 q² fractions per unit have a denominator up to q.
    """
    most = int(np.sqrt(_BY_CHANCE / (0.3 * max(high - low, 1e-12))))
    for q in range(1, min(most, 100_000) + 1):
        if (p := np.ceil(low * q)) <= high * q:
            return float(p / q)
    return 0.5 * (low + high)


def _resolution(seconds: Float[np.ndarray, " row"]) -> float | None:
    """The largest unit of which all times are multiples, of those that clocks round to."""
    for one in _RESOLUTIONS:
        counts = seconds / one
        slack = _ROUND_OFF + 4.0 * np.finfo(float).eps * np.abs(counts).max()
        if np.abs(counts - np.round(counts)).max() <= slack:
            return one
    return None


def split_at_gaps(
    part: Part, step: float, gaps: Bool[np.ndarray, " move"] | None = None
) -> list[Part]:
    """A part divided where rows are lost, or at other gaps; inputs are not known there."""
    gaps = np.diff(part.time) > _LOST * step if gaps is None else gaps
    rows = np.split(np.arange(part.time.size), np.flatnonzero(gaps) + 1)
    return [
        part.rows(own)._replace(after_gap=part.after_gap or bool(own[0]))
        for own in rows
        if own.size > 1
    ]


def with_lost_rows(part: Part, step: float, several: bool) -> list[Part]:
    """An even part with a row of NaN for each lost row, divided at long gaps.

    several : whether there are several modes, so that the mode of a lost row is unknown, −1
    """
    moves = np.diff(part.time) / step
    counts = np.where(moves > _LOST, np.round(moves), 1.0)
    off_grid = (moves > _LOST) & (np.abs(moves - counts) > _ON_GRID)
    pieces = split_at_gaps(part, step, off_grid | (counts > _LONG))
    return [_spread(piece, step, several) for piece in pieces]


def _spread(part: Part, step: float, several: bool) -> Part:
    """A part with rows of NaN on the grid between its rows."""
    counts = np.maximum(np.round(np.diff(part.time) / step), 1.0).astype(int)
    at = np.concatenate(([0], np.cumsum(counts)))
    size = int(at[-1]) + 1
    if size == at.size:
        return part
    time = np.interp(np.arange(size), at, part.time)
    output = np.full((size, part.output.shape[1]), np.nan)
    u = np.full((size, part.input.shape[1]), np.nan)
    mode = np.full(size, -1 if several else 0, np.int64)
    output[at], u[at], mode[at] = part.output, part.input, part.mode
    return part._replace(time=time, output=output, input=u, mode=mode)
