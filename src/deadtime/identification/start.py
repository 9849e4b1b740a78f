"""A first guess of the plant: a linear regression in every cell of the delays, and its logarithm.

With D in the cell [(N − 1) h, N h] only u_{k−N}, u_{k−N+1}, and u_{k−N+2} if inputs are linear
between samples, act, so x_{k+1} is linear in x_k and those for every D in the cell. The N with the
likeliest residuals is taken; A = log Φ / h, and the weights of the samples give B and, by their
centre, the fraction of the period. A cell needs inputs of its own lags alone.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.errors import ArgumentError
from deadtime.identification.identifiability import require_enough
from deadtime.identification.log.recording import Recording
from deadtime.identification.parameters import Cells, Layout, ModeCells, Square, Vector, Window
from deadtime.identification.sampling import (
    UsablePeriods,
    known_ends,
    lag_sums,
    stacked,
    usable_lags,
)
from deadtime.identification.scoring import best_in_turn
from deadtime.identification.transition import transitions_of

MOST_COLUMNS = 1000  # of past inputs, in a scan
_MOST_OF = 0.75  # share of each mode's periods that suffices to compare all cells by common ones
_ENOUGH = 10_000  # samples that suffice where each cell has its own periods
_SWEEPS = 3  # over the delays
_ALL = 2000  # combinations of cells that are all tried


class Start(NamedTuple):
    """A first guess, and the log likelihood of every cell of each delay.

    theta : of the `Layout`; cells : of each of its delays
    curves : (delays, cells), log likelihood with other delays in their cells, from cell `first` on
    weights : the number of free weights of an input in each mode
    vectors : (delays, cells, size), the maximum in each cell, if it was searched
    """

    theta: Vector
    cells: Cells
    first: int
    curves: Float[np.ndarray, "delay cell"]
    weights: int
    vectors: Float[np.ndarray, "delay cell unknown"] | None = None


def start_of(recording: Recording, layout: Layout, bounds: Window, within: bool) -> Start:
    """A first guess from an evenly sampled recording; delays are within `bounds`, seconds."""
    h = recording.step
    first, last = cell_range(h, bounds, layout.m)
    hold = recording.hold
    sums = _sums_of(recording, layout, first - 1 - hold, last, within)
    scan = _CellScan(sums, layout, first, last, hold)
    cells, curves = scan.best()
    by_mode = layout.spread(cells)
    P, count = zip(*(scan.regression(i, own) for i, own in enumerate(by_mode)), strict=True)
    require_enough(recording, layout, np.array(count), last * h)
    theta = plant_of(P, by_mode, np.array(count), layout, h, bounds, hold)
    return Start(theta, cells, first, curves, (hold + 2) * layout.n)


def _sums_of(
    recording: Recording, layout: Layout, latest: int, last: int, within: bool
) -> _CommonPeriods | _OwnPeriods:
    """The periods by which a scan compares cells: common ones if these are most of all.

    latest, last : the lags of the newest and of the oldest input of all cells

    A log shorter than twice the range of delays has common ones, too: it is refused later.
    """
    usable = [usable_lags(part, within, latest, last) for part in recording.parts]
    periods = UsablePeriods(recording.parts, usable)
    counts = np.array(periods.counts(layout.modes))
    every = np.zeros(layout.modes)
    for part in recording.parts:
        own = part.mode[:-1][known_ends(part, within)]
        every += np.bincount(own, minlength=layout.modes)
    longest = max(part.time.size for part in recording.parts)
    if (counts >= _MOST_OF * every).all() or longest <= 2 * last:
        return _CommonPeriods(lag_sums(layout, periods, latest, last, root=False), counts)
    some, z = recording.stretches(_ENOUGH, last), [[] for _ in range(layout.modes)]
    for part in some.parts:
        k = np.flatnonzero(known_ends(part, within))
        rows = stacked(part, k, latest, last, layout.constant)
        for i in range(layout.modes):
            z[i].append(rows[part.mode[k] == i])
    return _OwnPeriods([np.vstack(one) for one in z], layout.n, layout.constant)


class _CommonPeriods(NamedTuple):
    """Periods that are shared by all cells, as Σ z zᵀ of every mode, z of `stacked`."""

    gram: list[Float[np.ndarray, "z z"]]
    periods: Int[np.ndarray, " mode"]

    def of(self, mode: int, columns: list[int]) -> tuple[np.ndarray, int]:
        """Σ z zᵀ of some columns, and the number of periods."""
        return self.gram[mode][np.ix_(columns, columns)], int(self.periods[mode])

    def unseen(self, mode: int, count: int, each: float, plausible: bool) -> float:
        """The log likelihood of excluded periods: there are none."""
        return 0.0


class _OwnPeriods:
    """The periods of each cell whose inputs are known.

    A delay that excludes the periods in which a state responds to an input would explain the rest
    as well as the true delay explains all. So in the search for the likeliest delay, excluded
    periods count with the likelihood of a regression on the states alone. In the search for
    plausible ones they count like the others, because unknown inputs may explain the response.
    """

    def __init__(self, z: list[Float[np.ndarray, "period z"]], n: int, constant: bool) -> None:
        self._z, self._n = z, n
        self._alone = [*range(2 * n), *([z[0].shape[1] - 1] if constant else [])]

    def of(self, mode: int, columns: list[int]) -> tuple[np.ndarray, int]:
        """Σ z zᵀ of some columns, and the number of periods."""
        z = self._z[mode][:, columns]
        z = z[np.isfinite(z).all(axis=1)]
        return z.T @ z, len(z)

    def unseen(self, mode: int, count: int, each: float, plausible: bool) -> float:
        """The log likelihood of excluded periods; `each` is the mean over the `count` others."""
        M, every = self.of(mode, self._alone)
        if not plausible:
            each = _mean_likelihood(M, every, self._n)
        return (every - count) * each


def cell_range(h: float, bounds: Window, m: int) -> tuple[int, int]:
    """The first and the last cell of delays within `bounds`, seconds."""
    first = max(1, int(np.floor(bounds[0] / h * (1.0 + 1e-12) + 1e-9)) + (bounds[0] > 0.0))
    last = max(first, int(np.ceil(bounds[1] / h - 1e-9)))
    if m * (last - first + 2) > MOST_COLUMNS:
        low = bounds[0] if first > 1 else 0.0
        raise ArgumentError(
            f"delay = ({low:g}, {bounds[1]:g}) s is {last - first + 1:,} periods of {h:g} s, "
            f"and at most {MOST_COLUMNS // m - 1:,} can be searched: narrow the range, or keep "
            "every tenth row of the log with its input's mean. It is in seconds."
        )
    return first, last


def plant_of(
    P: Sequence[Float[np.ndarray, "n r"]],
    cells: ModeCells,
    count: Float[np.ndarray, " mode"] | Int[np.ndarray, " mode"],
    layout: Layout,
    h: float,
    bounds: Window,
    hold: int,
) -> Vector:
    """The plant of regressions on x_k, u_{k−N}, …, u_{k−N+hold+1}, each over `count` periods."""
    A, B, D = np.zeros((layout.modes, layout.n, layout.n)), [], []
    for i in range(layout.modes):
        A[i], b, part = _logarithm(P[i], layout, h, hold)
        B.append(b)
        D.append((cells[i] - part) * h)
    D = np.array(D)
    if not layout.per_mode:
        strength = np.array([np.sum(b[:, : layout.m] ** 2, axis=0) for b in B]) * count[:, None]
        D[:] = (D * strength).sum(axis=0) / np.maximum(strength.sum(axis=0), 1e-300)
    return layout.join(A, np.array(B), np.clip(D, *bounds))


class _CellScan:
    """Linear regressions over the cells of all delays."""

    def __init__(
        self,
        sums: _CommonPeriods | _OwnPeriods,
        layout: Layout,
        first: int,
        last: int,
        hold: int,
    ) -> None:
        self.sums, self.layout, self.hold = sums, layout, hold
        self.latest = first - 1 - hold
        self.cells = np.arange(first, last + 1)

    def best(self) -> tuple[np.ndarray, np.ndarray]:
        """The likeliest cells, and the log likelihood of all cells of each delay."""
        groups = range(self.layout.modes) if self.layout.per_mode else [None]
        cells, curves = zip(*(self._best_of(group) for group in groups), strict=True)
        return np.concatenate(cells), np.concatenate(curves)

    def _best_of(self, mode: int | None) -> tuple[np.ndarray, np.ndarray]:
        m, count = self.layout.m, self.cells.size
        modes = range(self.layout.modes) if mode is None else [mode]

        def likelihood(*chosen: int | None, plausible: bool = False) -> float:
            return sum(self._likelihood(i, chosen, plausible) for i in modes)

        each, cells = np.vectorize(likelihood, otypes=[float]), self.cells.tolist()
        if count**m <= _ALL:
            best = max(itertools.product(cells, repeat=m), key=lambda chosen: likelihood(*chosen))
        else:
            best = best_in_turn((None,) * m, cells, each, _SWEEPS)
        beside = [(*best[:j], self.cells, *best[j + 1 :]) for j in range(m)]
        return np.array(best), np.array([each(*one, plausible=True) for one in beside])

    def _sums(self, mode: int, chosen: tuple[int | None, ...]) -> tuple[np.ndarray, int]:
        n, m = self.layout.n, self.layout.m
        columns = [*range(2 * n)]
        of = [(j, c) for j, c in enumerate(chosen) if c is not None]
        for newer in range(self.hold + 2):
            columns += [2 * n + (c - newer - self.latest) * m + j for j, c in of]
        if self.layout.constant:
            columns.append(2 * n + (self.cells.size + 1 + self.hold) * m)
        return self.sums.of(mode, columns)

    def regression(self, mode: int, cells: np.ndarray) -> tuple[Float[np.ndarray, "n r"], int]:
        """Φ, then the weights of u_{k−N}, of u_{k−N+1}, …, and of 1; and the number of periods."""
        M, count = self._sums(mode, tuple(cells.tolist()))
        return _regressed(M, self.layout.n)[0], count

    def _likelihood(self, mode: int, chosen: tuple[int | None, ...], plausible: bool) -> float:
        M, count = self._sums(mode, chosen)
        if count < self.layout.least_periods:
            return -np.inf
        each = _mean_likelihood(M, count, self.layout.n)
        return count * each + self.sums.unseen(mode, count, each, plausible)


def _mean_likelihood(M: Float[np.ndarray, "z z"], count: int, n: int) -> float:
    """The mean log likelihood of `count` periods, up to a constant, from Σ z zᵀ."""
    spare = max(count - (len(M) - n), 1)
    return -0.5 * (_regressed(M, n)[1] - n * float(np.log(spare)))


def _regressed(M: Float[np.ndarray, "z z"], n: int) -> tuple[Float[np.ndarray, "n r"], float]:
    """From Σ z zᵀ, z = (x_{k+1}, r_k): the regression, and log det Σ e eᵀ."""
    unit = np.sqrt(np.maximum(np.diagonal(M), 1e-300))
    scaled = M / unit / unit[:, None]
    P = np.linalg.lstsq(scaled[n:, n:], scaled[n:, :n], rcond=1e-13)[0]
    S = scaled[:n, :n] - scaled[:n, n:] @ P
    size = np.linalg.eigvalsh(S).clip(1e-15)
    return P.T * unit[:n, None] / unit[n:], float((np.log(size) + 2.0 * np.log(unit[:n])).sum())


def _logarithm(
    P: Float[np.ndarray, "n r"], layout: Layout, h: float, hold: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, B, and the part of a period in which the newest sample acts.

    If inputs are linear the centre of the weights is half a period later.
    """
    n, m, lags = layout.n, layout.m, hold + 2
    A = matrix_logarithm(P[:, :n]) / h
    of = P[:, n : n + lags * m].reshape(n, lags, m)
    whole, centre = of.sum(axis=1), np.tensordot(np.arange(lags), of, (0, 1))
    part = (centre * whole).sum(axis=0) / np.maximum((whole**2).sum(axis=0), 1e-300) - 0.5 * hold
    W = transitions_of(A, np.array([h])).W[0]
    B = np.linalg.solve(W, np.hstack((whole, P[:, n + lags * m :])))
    return A, B, np.clip(part, 0.02, 0.98)


def matrix_logarithm(Phi: Square) -> Square:
    """log Φ where it is real; else of the nearest Φ that has one: eigenvalues to positive parts."""
    values, vectors = (np.asarray(one, complex) for one in np.linalg.eig(Phi))
    size = max(1.0, float(np.abs(values).max()))
    bad = (np.abs(np.imag(values)) < 1e-9 * size) & (np.real(values) < 1e-3 * size)
    values = np.where(bad, 1e-3 * size, values)
    if np.linalg.cond(vectors) > 1e8:
        return Phi - np.eye(len(Phi))
    return (vectors @ np.diag(np.log(values)) @ np.linalg.inv(vectors)).real
