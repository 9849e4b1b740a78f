"""Outputs with their derivatives, by a smoother that knows no plant: a first guess of states.

Each output is the first of a chain of integrators, the last of which is driven by white noise: the
spline whose stiffness is likeliest (Wahba, J. Royal Statistical Society B 40(3), 1978).
"""

from __future__ import annotations

from collections.abc import Iterator
from math import factorial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.identification.likelihoods.filter_periods import FilterPeriods
from deadtime.identification.likelihoods.filtering import (
    Filtered,
    Places,
    Sensors,
    filtered as innovations,
)
from deadtime.identification.likelihoods.smoother import FilterModel, filtered, smoothed
from deadtime.identification.log.recording import Part

_VAGUE = 1e8  # variances of a sensor that a state is not known by
_DECADES = 3.0  # of a stiffness: noise much larger, or smaller, than what the spline bends


class Derivatives(NamedTuple):
    """States of every part, and per output its sensor's deviation and the noise that drives it.

    states : of every part, (samples, n), per second, per second², …
    deviation : (p,); drive : (p,), the intensity of the noise of the last derivative
    """

    states: tuple[Float[np.ndarray, "sample n"], ...]
    deviation: Float[np.ndarray, " p"]
    drive: Float[np.ndarray, " p"]


def derivatives_of(parts: tuple[Part, ...], order: tuple[int, ...], step: float) -> Derivatives:
    """The derivatives of every output of evenly sampled logs.

    Examples
    --------
    >>> t = 0.1 * np.arange(200)
    >>> part = Part(t, np.sin(t)[:, None], np.zeros((200, 1)), np.zeros(200, np.int64))
    >>> found = derivatives_of((part,), (2,), 0.1).states[0]
    >>> bool(np.abs(found[20:-20, 1] - np.cos(t)[20:-20]).max() < 1e-3)
    True
    """
    columns, deviation, drive = [], [], []
    for j, count in enumerate(order):
        series = [part.output[:, j : j + 1] for part in parts]
        states, r, q = _chain(series, count)
        columns.append([one / step ** np.arange(count) for one in states])
        deviation.append(r)
        drive.append(q / step ** (2 * count - 1))
    every = tuple(np.hstack(one) for one in zip(*columns, strict=True))
    return Derivatives(every, np.array(deviation), np.array(drive))


def _chain(series: list[np.ndarray], count: int) -> tuple[list[np.ndarray], float, float]:
    """The states of one output in units of a period, its deviation, and the noise behind it."""
    known = np.concatenate([one[np.isfinite(one)] for one in series])
    size = float(np.sqrt(np.mean(known**2)))
    grid = 10.0 ** np.arange(-_DECADES * count, _DECADES + 2.0)
    found = [(_likelihood(series, count, q, size), q) for q in grid.tolist()]
    (_, variance), q = max(found, key=lambda one: one[0][0])
    model, states = _model(count, q), []
    for y in series:
        start, kind = _one_start(len(y))
        first = filtered(y / size, start, kind, np.zeros((len(y), count)), model)
        states.append(size * smoothed(first, start, kind, model))
    return states, size * float(np.sqrt(variance)), size**2 * variance * q


def _model(count: int, q: float) -> FilterModel:
    """A chain of integrators; variances in units of the sensor's."""
    Phi, Q = np.zeros((count, count)), np.zeros((count, count))
    for a in range(count):
        for b in range(count):
            if b >= a:
                Phi[a, b] = 1.0 / factorial(b - a)
            i, j = count - 1 - a, count - 1 - b
            Q[a, b] = q / (factorial(i) * factorial(j) * (i + j + 1))
    C = np.eye(1, count)
    return FilterModel(Phi[None], Q[None], C, np.ones(1), (_VAGUE * (1.0 + q)) * np.eye(count))


def _one_start(count: int) -> tuple[np.ndarray, np.ndarray]:
    start = np.zeros(count, bool)
    start[0] = True
    return start, np.zeros(count, np.int64)


def _likelihood(series: list[np.ndarray], count: int, q: float, size: float) -> tuple[float, float]:
    """Log likelihood with the sensor's variance at its likeliest, and that, in size²."""
    model, total, squares, logs = _model(count, q), 0, 0.0, 0.0
    for y in series:
        for block in _innovations(y / size, model):
            total += np.count_nonzero(np.isfinite(block.y))
            squares += float((block.e * block.e / block.s).sum())
            logs += float(np.log(block.s).sum())
    variance = max(squares / max(total, 1), 1e-14)
    return -0.5 * (total * np.log(variance) + logs), variance


def _innovations(y: Float[np.ndarray, "sample 1"], model: FilterModel) -> Iterator[Filtered]:
    """Errors and variances of an output; the first ones, by which states begin, left out."""
    start, mode = _one_start(len(y))
    part = Part(np.arange(len(y), dtype=float), y, np.zeros((len(y), 0)), mode)
    initial = np.isfinite(y) & (np.cumsum(np.isfinite(y), axis=0) <= model.C.size)
    n = model.C.size
    nothing = np.zeros((1, 0, n, n))

    def periods(_: Part, rows: np.ndarray, __: np.ndarray) -> FilterPeriods:
        tables = model.Phi, nothing, model.Q, nothing
        unmoved = np.zeros((rows.size, n)), np.zeros((rows.size, 0, n))
        return FilterPeriods(mode[rows], mode[rows], *tables, *unmoved)

    sensors = Sensors(model.C, model.R, model.P0)
    return innovations((part,), [start], [initial], periods, sensors, Places.none(1))
