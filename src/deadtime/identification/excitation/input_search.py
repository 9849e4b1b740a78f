"""Input sequences: the usual ones, and the one that a search finds to tell most.

The criterion is smooth in the inputs and has many local maxima, most of them with nearly all inputs
at their limits. It is climbed by a quasi-Newton method with bounds (L-BFGS-B), its exact gradient
from one sweep backwards through the log, from several starts; the best is kept.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from deadtime.identification.excitation.input_information import Prospect

CLOCKS = (1, 2, 4, 8, 16)  # times the holding time, of sequences to begin with
_PRICES = (10.0, 1e3)  # of what is beyond a limit, one after the other
_CLIMBED = 5  # starts, those that are worth most
_ITERATIONS = 60
_INSIDE = 0.6  # of the limit: starts, so that bounds do not hold them at once
_PACES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)  # how often random starts turn
_STRETCH = 20  # samples of a kick at most


def binary_sequence(
    count: int, limit: Float[np.ndarray, " m"], clock: int
) -> Float[np.ndarray, "sample m"]:
    """A maximum-length binary sequence of values held for `clock` samples, shifted for each input.

    Examples
    --------
    >>> binary_sequence(8, np.array([2.0]), 2).ravel()
    array([ 2.,  2.,  2.,  2.,  2.,  2., -2., -2.])
    """
    from scipy.signal import max_len_seq

    values = -(-count // clock)
    bits = int(min(max(np.ceil(np.log2(values + 1)), 2), 16))
    sequence = max_len_seq(bits)[0].astype(float) * 2.0 - 1.0
    shift = sequence.size // limit.size
    columns = [np.resize(np.roll(sequence, -j * shift), values) for j in range(limit.size)]
    return np.repeat(np.column_stack(columns), clock, axis=0)[:count] * limit


def steps(count: int, limit: Float[np.ndarray, " m"]) -> Float[np.ndarray, "sample m"]:
    """A step of every input from −limit to limit, one after the other.

    Examples
    --------
    >>> steps(4, np.array([1.0])).ravel()
    array([-1., -1.,  1.,  1.])
    """
    m = limit.size
    at = np.array([(j + 1) * count // (m + 1) for j in range(m)])
    return np.where(np.arange(count)[:, None] < at, -limit, limit)


def within_limits(prospect: Prospect, r: Float[np.ndarray, "sample m"]) -> np.ndarray:
    """The inputs, made smaller where they would carry the loop beyond its limits: it is linear."""
    beyond = prospect.worth(r).beyond
    return r / (1.0 + beyond)


def best_sequence(
    prospect: Prospect, limit: Float[np.ndarray, " m"], hold: int, kicks: int, seed: int
) -> Float[np.ndarray, "sample m"]:
    """The inputs within ±limit, each held for `hold` samples, that are worth most of those found.

    First from sequences of all paces; then the best is kicked, a stretch of it turned about, and
    climbed from again, `kicks` times.
    """
    count, m = prospect.samples, limit.size
    rng = np.random.default_rng(seed)
    values = -(-count // hold)
    begin = [binary_sequence(count, limit, hold * clock)[::hold] for clock in CLOCKS]
    for pace in _PACES:
        turns = np.where(rng.random((values, m)) < pace, -1.0, 1.0)
        begin.append(limit * np.cumprod(turns, axis=0))
    as_they_are = [prospect.worth(within_limits(prospect, _held(v, hold, count))) for v in begin]
    order = np.argsort([-worth.value for worth in as_they_are])[:_CLIMBED]
    found = [_climb(prospect, _INSIDE * begin[place], limit, hold, _PRICES) for place in order]
    best = max(found, key=lambda one: one[0])
    for _ in range(kicks):
        v, length = best[1][::hold].copy(), int(rng.integers(1, min(_STRETCH, values) + 1))
        start = int(rng.integers(values - length + 1))
        v[start : start + length, rng.integers(m)] *= -1.0
        again = _climb(prospect, _INSIDE * v, limit, hold, _PRICES[-1:])
        best = max(best, again, key=lambda one: one[0])
    return best[1]


def _held(v: np.ndarray, hold: int, count: int) -> np.ndarray:
    """Values, each for `hold` samples."""
    return np.repeat(v, hold, axis=0)[:count]


def _climb(
    prospect: Prospect, first: np.ndarray, limit: np.ndarray, hold: int, prices: tuple[float, ...]
) -> tuple[float, Float[np.ndarray, "sample m"]]:
    """The worth of the local maximum that a start leads to, made to keep its limits, and it."""
    from scipy.optimize import minimize

    count, m = prospect.samples, limit.size
    edges = np.arange(0, count, hold)

    def downhill(v: np.ndarray, price: float) -> tuple[float, np.ndarray]:
        worth = prospect.worth(_held(v.reshape(-1, m) * limit, hold, count), price)
        if not np.isfinite(worth.value):
            return 1e6, np.zeros(v.size)
        return -worth.value, -(np.add.reduceat(worth.by_r, edges, axis=0) * limit).ravel()

    v = (first / limit).ravel()
    for price in prices if np.isfinite(prospect.room).any() else prices[-1:]:
        result = minimize(
            downhill,
            v,
            (price,),
            method="L-BFGS-B",
            jac=True,
            bounds=[(-1.0, 1.0)] * v.size,
            options={"maxiter": _ITERATIONS},
        )
        v = np.clip(result.x, -1.0, 1.0)
    r = within_limits(prospect, _held(v.reshape(-1, m) * limit, hold, count))
    return prospect.worth(r).value, r
