"""Records of signals written out period by period, for loops that run scenarios side by side."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from deadtime.feedback.table import Context
from deadtime.scenarios.loop import Laid, Loop

_EVER = np.iinfo(np.int32).max


def by_period(
    laid: Laid, scenarios: Int[np.ndarray, " scenario"], samples: int
) -> tuple[Int[np.ndarray, "scenario sample"], Int[np.ndarray, "scenario sample"]]:
    """Mode at each sample, and map of each period, of scenarios that follow each other.

    Examples
    --------
    >>> records = [np.array(part) for part in ([0, 2, 3], [0, 2, 0], [1, 0, 1], [1, 0, 1])]
    >>> laid = Laid(*records, np.zeros((2, 8)), np.zeros(2, int))
    >>> by_period(laid, np.arange(2), 4)[0]
    array([[1, 1, 0, 0],
           [1, 1, 1, 1]])
    """
    records = slice(laid.first[scenarios[0]], laid.first[scenarios[-1] + 1])
    step = laid.step[records]
    until = np.append(step[1:], 0)
    until = np.where(until == 0, samples, until)  # the next record is another scenario's first
    shape = scenarios.size, samples
    return (
        np.repeat(laid.mode[records], until - step).reshape(shape),
        np.repeat(laid.map[records], until - step).reshape(shape),
    )


def rows_of(
    mode: Int[np.ndarray, "scenario sample"],
    age: Int[np.ndarray, " scenario"],
    context: Context,
    ages: int,
) -> Int[np.ndarray, "scenario sample"] | None:
    """The row of a law at each sample, as `Feedback.rows` has it; None where there is only one.

    Examples
    --------
    >>> rows_of(np.array([[0, 0, 0, 1, 1]]), np.array([1]), "mode_age", 3)
    array([[1, 2, 2, 3, 4]])
    """
    if context == "none":
        return None
    if context == "mode":
        return mode
    samples = np.arange(mode.shape[1])
    began = np.where(np.diff(mode, axis=1, prepend=-1) != 0, samples, -_EVER)
    began[:, 0] = -np.minimum(age, ages)
    since = samples - np.maximum.accumulate(began, axis=1)
    return mode * ages + np.minimum(since, ages - 1)


def most_maps(laid: Laid, first: int, count: int, size: int, loop: Loop) -> int:
    """How many maps a chunk of `size` of the scenarios first, …, first + count − 1 uses at most."""
    modes = loop.plant.modes
    cuts = np.add.reduceat(laid.map >= modes, laid.first[:-1], dtype=np.int64)
    each = np.add.reduceat(cuts[first : first + count], np.arange(0, count, size))
    return modes + int(each.max())


def own_maps(
    laid: Laid, index: Int[np.ndarray, "scenario sample"], loop: Loop, room: int
) -> tuple[Float[np.ndarray, "size room"], Int[np.ndarray, "scenario sample"]]:
    """The maps that a chunk uses, as `room` columns, and where each period's is among these."""
    modes, n, wide = loop.plant.modes, loop.plant.states, loop.maps.move.shape[2]
    size = n * wide + wide * (wide + 1) // 2
    cut = index[index >= modes]  # of a chunk these follow each other; every last period is cut
    low, high = int(cut.min()), int(cut.max()) + 1
    maps = np.zeros((size, room))
    maps[:, :modes] = laid.maps[:modes, :size].T
    maps[:, modes : modes + high - low] = laid.maps[low:high, :size].T
    return maps, np.where(index < modes, index, index - low + modes)


def filled(
    values: Int[np.ndarray, "scenario sample"], size: int
) -> Int[np.ndarray, "sample {size}"]:
    """By sample, and with the last scenario repeated so that there are `size`.

    Examples
    --------
    >>> filled(np.array([[1, 2, 3], [4, 5, 6]]), 3)
    array([[1, 4, 4],
           [2, 5, 5],
           [3, 6, 6]], dtype=int32)
    """
    again = np.minimum(np.arange(size), len(values) - 1)
    return np.ascontiguousarray(values[again].T.astype(np.int32))
