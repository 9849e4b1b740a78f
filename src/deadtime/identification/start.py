"""Where to begin: a linear regression at every whole number of periods, and its logarithm.

With D in the cell [(N − 1) h, N h] only u_{k−N} and u_{k−N+1} act, so x_{k+1} is linear in x_k and
those, whatever D is. The N with the likeliest residuals is taken; A = log Φ / h, and the weights of
the two samples tell B and the fraction of the period.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.errors import ArgumentError
from deadtime.identification.log.recording import Recording
from deadtime.identification.parameters import Layout
from deadtime.identification.regression import Lags, lags_of
from deadtime.identification.transition import transitions_of
from deadtime.identification.untold import require_enough

MOST_COLUMNS = 1000  # of past inputs, in a scan
_ALL = 2000  # combinations of cells that are all tried


class Start(NamedTuple):
    """A first guess, and the likelihood of every cell of each delay beside it.

    theta : of the `Layout`; cells : of each of its delays
    scanned : (delays, cells), log likelihood, the others in their cells, from cell `first` on
    vectors : (delays, cells, size), where it is so large, if a maximum was sought in each cell
    """

    theta: Float[np.ndarray, " size"]
    cells: Int[np.ndarray, " delay"]
    first: int
    scanned: Float[np.ndarray, "delay cell"]
    vectors: Float[np.ndarray, "delay cell unknown"] | None = None


def start_of(
    recording: Recording, layout: Layout, bounds: tuple[float, float], within: bool
) -> Start:
    """A first guess from an evenly sampled recording; delays are within `bounds`, seconds."""
    h = recording.step
    first, last = cell_range(h, bounds, layout.m)
    lags = lags_of(recording.parts, layout.modes, first - 1, last, within, root=False)
    require_enough(recording, layout, lags.periods, last * h)
    scan = _Scan(lags, layout, first, last)
    cells, scanned = scan.best()
    P = [scan.weights(i, scan.own(cells, i)) for i in range(layout.modes)]
    theta = plant_of(P, layout.spread(cells), lags.periods, layout, h, bounds)
    return Start(theta, cells, first, scanned)


def cell_range(h: float, bounds: tuple[float, float], m: int) -> tuple[int, int]:
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
    cells: Int[np.ndarray, "mode m"],
    count: Float[np.ndarray, " mode"] | Int[np.ndarray, " mode"],
    layout: Layout,
    h: float,
    bounds: tuple[float, float],
) -> Float[np.ndarray, " size"]:
    """The plant of regressions on x_k, u_{k−N} and u_{k−N+1}, each over `count` periods."""
    A, B, D = np.zeros((layout.modes, layout.n, layout.n)), [], []
    for i in range(layout.modes):
        A[i], b, part = _logarithm(P[i], layout, h)
        B.append(b)
        D.append((cells[i] - part) * h)
    D = np.array(D)
    if not layout.per_mode:
        strength = np.array([np.sum(b**2, axis=0) for b in B]) * count[:, None]
        D[:] = (D * strength).sum(axis=0) / np.maximum(strength.sum(axis=0), 1e-300)
    return layout.join(A, np.array(B), np.clip(D, *bounds))


class _Scan:
    """Linear regressions over the cells of all delays."""

    def __init__(self, lags: Lags, layout: Layout, first: int, last: int) -> None:
        self.lags, self.layout, self.first = lags, layout, first
        self.cells = np.arange(first, last + 1)

    def own(self, cells: np.ndarray, mode: int) -> np.ndarray:
        """The cells of a mode."""
        m = self.layout.m
        return cells[mode * m : (mode + 1) * m] if self.layout.per_mode else cells

    def best(self) -> tuple[np.ndarray, np.ndarray]:
        """The likeliest cells, and what each delay's others would be like."""
        groups = range(self.layout.modes) if self.layout.per_mode else [None]
        found = [self._best_of(group) for group in groups]
        return np.concatenate([f[0] for f in found]), np.concatenate([f[1] for f in found])

    def _best_of(self, mode: int | None) -> tuple[np.ndarray, np.ndarray]:
        m, count = self.layout.m, self.cells.size
        modes = range(self.layout.modes) if mode is None else [mode]

        def likelihood(chosen: tuple[int | None, ...]) -> float:
            return sum(self._likelihood(i, chosen) for i in modes)

        if count**m <= _ALL:
            table = {c: likelihood(c) for c in itertools.product(self.cells.tolist(), repeat=m)}
            best = max(table, key=lambda c: table[c])
        else:
            best = (None,) * m
            for _ in range(3):
                for j in range(m):
                    options = [(*best[:j], c, *best[j + 1 :]) for c in self.cells.tolist()]
                    best = max(options, key=likelihood)
        scanned = [
            [likelihood((*best[:j], c, *best[j + 1 :])) for c in self.cells.tolist()]
            for j in range(m)
        ]
        return np.array(best), np.array(scanned)

    def _sums(self, mode: int, chosen: tuple[int | None, ...]) -> np.ndarray:
        n, m = self.layout.n, self.layout.m
        columns = [*range(2 * n)]
        for lag in (0, -1):
            of = [(j, c) for j, c in enumerate(chosen) if c is not None]
            columns += [2 * n + (c + lag - self.lags.low) * m + j for j, c in of]
        return self.lags.root[mode][np.ix_(columns, columns)]

    def _likelihood(self, mode: int, chosen: tuple[int | None, ...]) -> float:
        n, M = self.layout.n, self._sums(mode, chosen)
        unit = np.sqrt(np.maximum(np.diagonal(M), 1e-300))
        M = M / unit / unit[:, None]
        P = np.linalg.lstsq(M[n:, n:], M[n:, :n], rcond=1e-13)[0]
        S = M[:n, :n] - M[:n, n:] @ P
        size = np.linalg.eigvalsh(S).clip(1e-15)
        return float(-0.5 * self.lags.periods[mode] * np.log(size).sum())

    def weights(self, mode: int, chosen: np.ndarray) -> Float[np.ndarray, "n r"]:
        """Φ, then the weights of u_{k−N} and of u_{k−N+1}, by least squares."""
        n, M = self.layout.n, self._sums(mode, tuple(chosen.tolist()))
        unit = np.sqrt(np.maximum(np.diagonal(M), 1e-300))
        scaled = M / unit / unit[:, None]
        P = np.linalg.lstsq(scaled[n:, n:], scaled[n:, :n], rcond=1e-13)[0]
        return P.T * unit[:n, None] / unit[n:]


def _logarithm(
    P: Float[np.ndarray, "n r"], layout: Layout, h: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, B, and what part of a period the newer sample acts."""
    n, m = layout.n, layout.m
    A = matrix_logarithm(P[:, :n]) / h
    old, new = P[:, n : n + m], P[:, n + m :]
    whole = old + new
    part = (new * whole).sum(axis=0) / np.maximum((whole**2).sum(axis=0), 1e-300)
    W = transitions_of(A, np.array([h])).W[0]
    return A, np.linalg.solve(W, whole), np.clip(part, 0.02, 0.98)


def matrix_logarithm(Phi: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    """log Φ where it is real; else of the nearest Φ that has one: eigenvalues to positive parts."""
    found = np.linalg.eig(Phi)
    values, vectors = np.asarray(found[0], complex), np.asarray(found[1], complex)
    size = max(1.0, float(np.abs(values).max()))
    bad = (np.abs(np.imag(values)) < 1e-9 * size) & (np.real(values) < 1e-3 * size)
    values = np.where(bad, 1e-3 * size, values)
    if np.linalg.cond(vectors) > 1e8:
        return Phi - np.eye(len(Phi))
    return (vectors @ np.diag(np.log(values)) @ np.linalg.inv(vectors)).real
