"""Weights, and a gain, of the averaged law that are best for the worst constant mode.

    minimise  max_i g_i(w, K)    over w ≥ 0, Σ w_i = 1, and, on request, one K for all modes,

g_i the growth rate of the loop if the plant stays in mode i. This maximum of spectral radii is
neither smooth nor convex, but it has few variables: the weights are searched on a lattice of the
simplex, vertices included, and the best points are refined by Nelder and Mead's method, restarted
until it stops improving. All starts run at a coarse period, where the lifted loop is small, and the
best results are refined at the requested period. The search is deterministic.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import positive
from deadtime.base.errors import InfeasibleError
from deadtime.feedback import Feedback
from deadtime.gains.state_feedback import check_gains
from deadtime.plant import SwitchedSystem
from deadtime.spectrum import LiftedLoop

# A common gain is at most this many times as large as the largest given one (spectral norms):
# without a limit the best rates belong to gains that are large without bound.
GAIN_LIMIT = 2.0
_LATTICE, _COARSE, _RESTARTS = 100, 20, 5  # points; periods of the delay; descents from a point
_UNSTABLE = 1e6  # 1/s: above the growth rate of any loop that is compared

# From a vector of variables to weights (modes,) and gains (modes, m, n).
Reading = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
Height = Callable[[np.ndarray], float]
# From gains and weights to the table of a law at a period.
Tables = Callable[[np.ndarray, np.ndarray, float], Feedback]
# From weights and gains to the growth rates of the modes at a period.
Rates = Callable[[np.ndarray, np.ndarray, float], np.ndarray]


def minimax(
    tables: Tables,
    plant: SwitchedSystem,
    gains: ArrayLike,
    step: float,
    common_gain: bool,
    allow_unstable: bool,
) -> tuple[Float[np.ndarray, " mode"], Float[np.ndarray, "mode m n"], Float[np.ndarray, " mode"]]:
    """Weights, gains and the growth rate of each mode under them, 1/s.

    Raises
    ------
    ArgumentError
        If the gains do not fit the plant.
    InfeasibleError
        If no common gain was found that leaves every A_i + B_i K stable.
    """
    given = check_gains(plant, gains, allow_unstable)
    step = positive("step", step)
    coarse = max(step, plant.longest_delay / _COARSE)

    def rates(weights: np.ndarray, K: np.ndarray, period: float, /) -> np.ndarray:
        """The growth rate of every mode when it is held."""
        table = tables(K, weights, period)
        loops = [LiftedLoop.of(plant, table, mode, 0) for mode in range(plant.modes)]
        return np.array([loop.growth_rate(period) for loop in loops])

    def own(variables: np.ndarray, /) -> tuple[np.ndarray, np.ndarray]:
        return _weights(variables), given

    height, lattice = _height(plant, rates, own, coarse), _simplex(plant.modes)
    order = np.argsort([height(point) for point in lattice], kind="stable")  # ties are common
    start = _best(height, [lattice[i] for i in order[:3]], 0.05)
    best, _ = _minimise(_height(plant, rates, own, step), start, 0.02, 3)
    if not common_gain:
        return _weights(best), given, rates(_weights(best), given, step)

    read, starts = _one_gain(plant, given, _weights(best))
    start = _best(_height(plant, rates, read, coarse, allow_unstable), starts, 0.2)
    best, worst = _minimise(_height(plant, rates, read, step, allow_unstable), start, 0.02, 3)
    if worst >= _UNSTABLE:
        raise InfeasibleError(
            "no common gain was found that leaves every A_i + B_i K stable: use the modes' own "
            "gains (common_gain = False), or allow_unstable = True."
        )
    weights, K = read(best)
    return weights, K, rates(weights, K, step)


def _one_gain(
    plant: SwitchedSystem, given: np.ndarray, weights: np.ndarray
) -> tuple[Reading, list[np.ndarray]]:
    """A parametrisation of weights and one common gain, and the starting points of the search."""
    modes = plant.modes
    limit = GAIN_LIMIT * np.linalg.norm(given, 2, axis=(1, 2)).max()
    # Entries of K are scaled by their typical size, so that one simplex size suits them all.
    unit = np.maximum(np.abs(given).max(axis=0), 1e-3 * np.abs(given).max())

    def read(variables: np.ndarray, /) -> tuple[np.ndarray, np.ndarray]:
        K = variables[modes - 1 :].reshape(unit.shape) * unit
        K = K * min(1.0, limit / max(float(np.linalg.norm(K, 2)), 1e-300))
        return _weights(variables[: modes - 1]), np.tile(K, (modes, 1, 1))

    first = [np.tensordot(weights, given, 1), *given]
    return read, [np.concatenate((weights[:-1], (K / unit).ravel())) for K in first]


def _height(
    plant: SwitchedSystem, rates: Rates, read: Reading, step: float, allow_unstable: bool = True
) -> Height:
    """The largest growth rate; far above it where A_i + B_i K must be stable and is not."""

    def height(variables: np.ndarray, /) -> float:
        weights, K = read(variables)
        if not allow_unstable:
            rightmost = np.linalg.eigvals(plant.A + plant.B @ K).real.max()
            if rightmost >= 0.0:
                return _UNSTABLE + float(rightmost)
        return float(rates(weights, K, step).max())

    return height


def _best(height: Height, starts: list[np.ndarray], spread: float) -> np.ndarray:
    """The lowest end of the descents from several points."""
    ends = [_minimise(height, start, spread, _RESTARTS) for start in starts]
    return min(ends, key=lambda end: end[1])[0]


def _minimise(
    height: Height, start: np.ndarray, spread: float, restarts: int
) -> tuple[np.ndarray, float]:
    """The minimum that Nelder and Mead's method finds, restarted while it improves."""
    from scipy.optimize import minimize

    best, lowest = start, height(start)
    for _ in range(restarts if start.size else 0):
        # A fresh simplex: on a maximum of several rates the old one collapses into a ridge.
        simplex = np.vstack((best, best + spread * np.eye(start.size)))
        options: dict[str, Any] = {"xatol": 1e-6, "fatol": 1e-7, "maxfev": 150 * start.size}
        options["initial_simplex"] = simplex
        end = minimize(height, best, method="Nelder-Mead", options=options)
        gained, best, lowest = lowest - end.fun, end.x, end.fun
        if gained < 1e-4:
            break
    return best, lowest


def _weights(variables: np.ndarray) -> Float[np.ndarray, " mode"]:
    """Weights from all but the last of them, projected onto the simplex."""
    weights = np.maximum(np.append(variables, 1.0 - variables.sum()), 0.0)
    return weights / weights.sum()


def _simplex(modes: int) -> Float[np.ndarray, "point free"]:
    """A lattice of the simplex with at most `_LATTICE` points, its last coordinate left out."""
    sizes = range(1, _LATTICE)
    parts = max(k for k in sizes if k == 1 or math.comb(k + modes - 1, modes - 1) <= _LATTICE)
    counts = itertools.combinations_with_replacement(range(modes), parts)
    return np.array([np.bincount(c, minlength=modes)[:-1] / parts for c in counts])
