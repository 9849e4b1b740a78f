"""Fisher scoring: the maximum of a likelihood whose score and information are known.

    θ ← θ + (F + μ diag F)⁻¹ score,    kept within bounds

A likelihood over a delay has a kink at every whole number of periods, where the other samples of
the input begin to act. Between two kinks, in a *cell*, it is smooth. A maximum is searched in one
cell, and in the next one only if the maximum lies at the cell's end.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from deadtime.identification.parameters import FisherMatrix, Vector, Window, cells_of

GAIN = 1e-10  # rise of log likelihood that ends a climb
STEPS = 200
# Share of the predicted rise: after less of it the damping stays, or steps overshoot alternately.
_AS_PREDICTED = 0.25
_CLOSE = 0.1  # of a period: a coarse climb that ends so near a kink may go on beyond it


class Evaluation(NamedTuple):
    """A log likelihood with its derivative and the information on the unknowns."""

    value: float
    score: Vector
    information: FisherMatrix


class Maximum(NamedTuple):
    """A maximum of a likelihood; `bound`: whether each unknown is at a bound."""

    theta: Vector
    value: float
    information: FisherMatrix
    bound: Bool[np.ndarray, " size"]


Evaluate = Callable[[np.ndarray], Evaluation]
EvaluateIn = Callable[[np.ndarray], Evaluate]  # of the cells of delays
Stride = Callable[[np.ndarray], np.ndarray]


class Climb(NamedTuple):
    """The options of a climb.

    delays : their places; limits : bounds of all unknowns; fixed : unknowns that do not move
    stride, gain, steps : see `climb`
    """

    delays: slice
    limits: tuple[np.ndarray, np.ndarray]
    fixed: Bool[np.ndarray, " size"]
    stride: Stride | None = None
    gain: float = GAIN
    steps: int = STEPS

    def within(
        self, theta: Vector, low: np.ndarray, high: np.ndarray
    ) -> tuple[Vector, Vector, Vector]:
        """A start and bounds of all unknowns, with delays between two bounds."""
        bounds = self.limits[0].copy(), self.limits[1].copy()
        bounds[0][self.delays], bounds[1][self.delays] = low, high
        start = np.where(self.fixed, theta, np.clip(theta, *bounds))
        for bound in bounds:
            bound[self.fixed] = start[self.fixed]
        return start, *bounds


def best_in_turn(
    best: tuple[int | None, ...],
    options: Sequence[int],
    values: Callable[..., np.ndarray],  # of choices, one of them an array of all options
    sweeps: int,
) -> tuple[int | None, ...]:
    """Coordinate search from `best`: the option of largest value for each choice in turn.

    Examples
    --------
    >>> best_in_turn((2, 0), range(5), lambda c, d: c * (4 - c) - d, 4)
    (2, 0)
    """
    for _ in range(sweeps):
        before = best
        for j in range(len(best)):
            each = values(*best[:j], np.array(options), *best[j + 1 :])
            best = (*best[:j], options[int(each.argmax())], *best[j + 1 :])
        if best == before:
            break
    return best


@np.errstate(all="ignore")  # exponentials of trials far from the maximum overflow
def climb(
    evaluate: Evaluate,
    theta: Vector,
    low: Vector,
    high: Vector,
    steps: int = STEPS,
    gain: float = GAIN,
    stride: Stride | None = None,
) -> Maximum:
    """The local maximum within bounds near a start; a predicted rise below `gain` ends the climb.

    stride : maps unknowns to the largest step of those whose information is nearly 0

    Examples
    --------
    >>> def parabola(theta):
    ...     return Evaluation(-0.5 * (theta[0] - 2.0)**2, np.array([2.0 - theta[0]]), np.eye(1))
    >>> climb(parabola, np.array([0.0]), np.array([-1.0]), np.array([9.0])).theta.round(6)
    array([2.])
    """
    theta = np.clip(theta, low, high)
    now, damping = evaluate(theta), 1e-3
    if not np.isfinite(now.value):
        return Maximum(theta, now.value, now.information, np.zeros(theta.size, bool))
    for _ in range(steps):
        blocked = ((theta <= low) & (now.score < 0.0)) | ((theta >= high) & (now.score > 0.0))
        reach = np.inf if stride is None else stride(theta)
        trial, rise = _step(theta, now, blocked | (low == high), damping, low, high, reach)
        if rise < gain:
            break
        after = evaluate(trial)
        if np.isfinite(after.value) and after.value > now.value:
            if after.value - now.value > _AS_PREDICTED * rise:
                damping = max(0.1 * damping, 1e-12)
            theta, now = trial, after
        elif damping > 1e8:
            break
        else:
            damping = max(10.0 * damping, 1e-6)
    return Maximum(theta, now.value, now.information, (theta <= low) | (theta >= high))


def _step(
    theta: np.ndarray,
    now: Evaluation,
    fixed: np.ndarray,
    damping: float,
    low: np.ndarray,
    high: np.ndarray,
    stride: np.ndarray | float,
) -> tuple[np.ndarray, float]:
    """The next vector, and the rise of log likelihood that the quadratic model predicts."""
    free = np.flatnonzero(~fixed)
    if free.size == 0:
        return theta, 0.0
    F = now.information[np.ix_(free, free)]
    F = F + np.diag((np.abs(now.score) / stride)[free])
    unit = np.sqrt(np.maximum(np.diagonal(F), 1e-300))
    scaled = F / unit[:, None] / unit + damping * np.eye(free.size)
    step = np.linalg.lstsq(scaled, now.score[free] / unit, rcond=1e-14)[0] / unit
    trial = theta.copy()
    trial[free] = np.clip(theta[free] + step, low[free], high[free])
    return trial, float(now.score @ (trial - theta)) / 2.0


def climb_cells(
    evaluate_in: EvaluateIn, theta: Vector, step: float, bounds: Window, how: Climb
) -> tuple[Maximum, np.ndarray]:
    """The maximum over delays, searched from cell to cell; and its cells.

    Cell N of a delay is [(N − 1) h, N h], cut at `bounds`.
    """
    delays, gain, free = how.delays, how.gain, ~how.fixed[how.delays]

    def highest(cells: np.ndarray, start: np.ndarray) -> Maximum:
        low = np.maximum((cells - 1) * step, bounds[0])
        within = how.within(start, low, np.minimum(cells * step, bounds[1]))
        return climb(evaluate_in(cells), *within, how.steps, gain, how.stride)

    cells = cells_of(theta[delays], step)
    best, tried = highest(cells, theta), {tuple(cells)}
    while True:
        options = []
        whole = best.theta[delays] / step
        close = (gain > GAIN) & (np.abs(whole - np.round(whole)) < _CLOSE)
        for j in np.flatnonzero((best.bound[delays] | close) & free):
            D, beyond = best.theta[delays][j], cells.copy()
            beyond[j] += 1 if (cells[j] - 0.5) * step < D else -1
            reach = (beyond[j] - 1) * step < bounds[1] and beyond[j] * step > bounds[0]
            if reach and tuple(beyond) not in tried:
                tried.add(tuple(beyond))
                options.append((highest(beyond, best.theta), beyond))
        better = [o for o in options if o[0].value > best.value + gain]
        if not better:
            return best, cells
        best, cells = max(better, key=lambda option: option[0].value)
