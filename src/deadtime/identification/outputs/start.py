"""Where to begin from outputs alone: derivatives by a smoother, then a scan of all delays.

With A, W and V as they are, errors of the filter are linear in what inputs add, and a delay of N
periods takes the column of u_{k−N}; one between N − 1 and N both columns. So every cell of a delay
is a linear regression, of B alone, over the whole log.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.identification.cells import cells_of
from deadtime.identification.noisy import Noise, NoisyLog
from deadtime.identification.outputs.derivatives import Derivatives, derivatives_of
from deadtime.identification.outputs.embedding import Embedding
from deadtime.identification.outputs.smoother import Model, filtered, responses
from deadtime.identification.parameters import Layout
from deadtime.identification.recording import Recording
from deadtime.identification.start import cell_range, start_of
from deadtime.identification.transition import transitions_of

_ALL = 2000  # combinations of cells that are all tried


class Guess(NamedTuple):
    """A first plant, and its noise; `size` of the states."""

    theta: Float[np.ndarray, " size"]
    noise: tuple[Noise, ...]
    size: Float[np.ndarray, " n"]


def guess_of(
    grid: Recording,
    layout: Layout,
    order: tuple[int, ...],
    bounds: tuple[float, float],
    within: bool,
) -> Guess:
    """A first plant from evenly sampled outputs, as if their smoothed derivatives were measured."""
    found = derivatives_of(grid.parts, order, grid.step)
    every = np.vstack(found.states)
    shape = Embedding(order, False, np.sqrt(np.mean(every**2, axis=0)))
    parts = zip(grid.parts, found.states, strict=True)
    measured = grid._replace(parts=tuple(part._replace(output=x) for part, x in parts))
    A, B, delays = layout.split(start_of(measured, layout, bounds, within).theta)
    A, B = A.copy(), B.copy()
    A[:, shape.upper], B[:, shape.upper] = shape.shift()[shape.upper], 0.0
    return Guess(layout.join(A, B, delays), _noises(found, shape, grid.step), shape.size)


def _noises(found: Derivatives, shape: Embedding, step: float) -> tuple[Noise, ...]:
    """What moves outputs is mostly noise of the plant, or mostly of the sensors."""
    moves = [np.diff(states, axis=0) for states in found.states]
    moves = np.mean(np.vstack(moves) ** 2, axis=0) / step
    deviation = np.maximum(found.deviation, 1e-4 * (shape.C @ shape.size))
    noises = []
    for much, sensor in ((0.3, 0.5), (0.01, 1.0)):
        W = 0.1 * much * moves
        W[shape.last] = much * np.minimum(found.drive, moves[shape.last])
        W = np.maximum(W, 1e-8 * shape.size**2)
        noises.append(Noise(np.diag(W), sensor * deviation))
    return tuple(noises)


class Scanned(NamedTuple):
    """The likeliest cells, what each delay's others would be like, and the plant there."""

    cells: Int[np.ndarray, " delay"]
    first: int
    curves: Float[np.ndarray, "delay cell"]
    theta: Float[np.ndarray, " size"]


def scanned(log: NoisyLog, vector: Float[np.ndarray, " size"], rows: np.ndarray) -> Scanned:
    """All cells of all delays of an even log, A and noise as they are in `vector`.

    rows : the states that inputs act on
    """
    layout, h = log.layout, log.recording.step
    first, last = cell_range(h, log.bounds, layout.m)
    lags = np.arange(first - 1, last + 1)
    scan = _Scan(_gram(log, vector, rows, lags), layout, rows.size, lags)
    own = cells_of(vector[layout.at_delays], h)
    cells, curves = scan.best(np.clip(own, first, last) - first)
    theta = vector[: layout.size].copy()
    A, _, _ = layout.split(theta)
    B, D = scan.plant(cells)
    full = np.zeros((layout.modes, layout.n, layout.m))
    full[:, rows] = B
    delays = layout.spread(h * (cells + first) - h * D)
    return Scanned(cells + first, first, curves, layout.join(A, full, np.clip(delays, *log.bounds)))


def _gram(
    log: NoisyLog, vector: np.ndarray, rows: np.ndarray, lags: np.ndarray
) -> Float[np.ndarray, "z z"]:
    """Sums of the errors without inputs and of the responses to every lag: modes, rows, lags, m."""
    layout, h = log.layout, log.recording.step
    A = layout.split(vector[: layout.size])[0]
    starts, total = log.starts(*log.bounds), 0.0
    left_out = log.initial(starts)
    push = np.array([transitions_of(one, np.array([h])).W[0][:, rows] for one in A])
    given = zip(log.recording.parts, log.filters(vector, starts), left_out, strict=True)
    for part, (output, start, kind, Phi, moved, Q, C, R, _, P0), known in given:
        model = Model(Phi, Q, C, R, P0)
        free = filtered(output, start, kind, np.zeros(moved.shape), model)
        row = np.arange(-1, start.size - 1)[:, None] - lags
        u = np.where(row[..., None] >= 0, np.nan_to_num(part.input)[np.maximum(row, 0)], 0.0)
        added = responses(free, start, kind, push, u.reshape(start.size, -1), model)
        e = (free.error / np.sqrt(free.variance))[..., None]
        z = np.concatenate((e, added), axis=2)[~known & np.isfinite(output)]
        total = total + z.T @ z
    return np.asarray(total)


class _Scan:
    """Regressions of errors on what two neighbouring lags of every input add."""

    def __init__(self, gram: np.ndarray, layout: Layout, rows: int, lags: np.ndarray) -> None:
        self.layout, self.count = layout, lags.size - 1
        self.place = 1 + np.arange(layout.modes * rows * lags.size * layout.m).reshape(
            layout.modes, rows, lags.size, layout.m
        )
        unit = np.sqrt(np.maximum(np.diagonal(gram), 1e-300))
        self.gram, self.unit = gram / unit / unit[:, None], unit

    def columns(self, cells: tuple[int | None, ...]) -> np.ndarray:
        """(modes, rows, m, 2): where the newer and the older sample of each input lie."""
        of = self.layout.spread(np.arange(self.layout.delays))
        chosen = [
            self.place[i, :, cells[of[i, j]] + later, j]
            for i in range(self.layout.modes)
            for j in range(self.layout.m)
            if cells[of[i, j]] is not None
            for later in (0, 1)
        ]
        return np.array(chosen)

    def weights(self, cells: tuple[int | None, ...]) -> tuple[np.ndarray, float]:
        """What the columns weigh, and how much of the errors' squares is left, of 1."""
        at = self.columns(cells).ravel()
        if at.size == 0:
            return np.zeros(0), 1.0
        G, b = self.gram[np.ix_(at, at)], self.gram[at, 0]
        w = np.linalg.lstsq(G, b, rcond=1e-10)[0]
        return w * self.unit[0] / self.unit[at], max(1.0 - float(b @ w), 1e-15)

    def likelihood(self, cells: tuple[int | None, ...]) -> float:
        """Of errors in units of their deviation: half of what is left, below 0."""
        return -0.5 * self.unit[0] ** 2 * self.weights(cells)[1]

    def best(self, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The likeliest cells, and each delay's curve beside them."""
        options, delays = range(self.count), self.layout.delays
        if self.count**delays <= _ALL:
            best = max(itertools.product(options, repeat=delays), key=self.likelihood)
        else:
            begins = (None,) * delays, tuple(own.tolist())
            best = max((self._ascended(begin) for begin in begins), key=self.likelihood)
        curves = [
            [self.likelihood((*best[:d], c, *best[d + 1 :])) for c in options]
            for d in range(delays)
        ]
        return np.array(best), np.array(curves)

    def _ascended(self, cells: tuple[int | None, ...]) -> tuple[int, ...]:
        """Cells of which none alone is better elsewhere."""
        for _ in range(4):
            before = cells
            for d in range(len(cells)):
                tried = [(*cells[:d], c, *cells[d + 1 :]) for c in range(self.count)]
                cells = max(tried, key=self.likelihood)
            if cells == before:
                break
        return cells  # pyright: ignore[reportReturnType]

    def plant(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """B (modes, rows, m), and of each delay the part of a period that it is shorter by."""
        layout = self.layout
        w = self.weights(tuple(cells.tolist()))[0].reshape(layout.modes, layout.m, 2, -1)
        new, whole = w[:, :, 0], w.sum(axis=2)
        share, size = (new * whole).sum(axis=2), (whole**2).sum(axis=2)
        part = np.zeros((2, layout.delays))
        of = layout.spread(np.arange(layout.delays))
        np.add.at(part[0], of, share)
        np.add.at(part[1], of, size)
        return whole.transpose(0, 2, 1), np.clip(part[0] / np.maximum(part[1], 1e-300), 0.02, 0.98)
