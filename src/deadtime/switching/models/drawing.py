"""The signals of many scenarios at once, each a function of its number.

Scenario i reads the numbers of its own streams only (`deadtime.numerics.philox`): one for its
first mode, and for jump j one for the sojourn before it and one for the mode after it. So its
signal does not depend on which scenarios are drawn beside it, and a longer horizon continues it.

All scenarios advance together, a round of jumps at a time: the modes they pass first, since these
do not depend on the sojourns, then the sojourns, then the instants; those that have reached the
horizon leave. Needs Numba, so it is imported where it is used.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, UInt64

from deadtime.base.checks import count, positive, read_only
from deadtime.base.errors import ArgumentError
from deadtime.numerics.philox import WORDS, uniforms
from deadtime.switching.batch import SignalBatch
from deadtime.switching.models.drawing_kernel import first_modes, paths, place, starts
from deadtime.switching.models.quantiles import Quantiles
from deadtime.switching.random import require_few
from deadtime.switching.signal import MOST_SWITCHES

MOST_JUMPS = 1e8
_FIRST_MODE, _SOJOURNS, _JUMPS = 1, 2, 3
_FIRST_BLOCKS = 2
_TINY = float(np.finfo(float).tiny)


def key_of(seed: int) -> UInt64[np.ndarray, 2]:
    """The generator's key for a seed."""
    state = np.random.SeedSequence(count("seed", seed, least=0)).generate_state(2, np.uint64)
    return read_only(state)


def draw_signals(
    quantiles: Quantiles,
    transition: Float[np.ndarray, "mode mode"],
    mean: float,
    horizon: float,
    seed: int,
    scenarios: tuple[int, int],
) -> SignalBatch:
    """Check what a model's `draw` was asked for, and draw.

    Parameters
    ----------
    quantiles, transition, horizon : as for `draw_jumps`
    mean : float
        The longest of the modes' mean sojourns, seconds.
    seed : int
        At least 0.
    scenarios : (int, int)
        The number of the first scenario, and how many.

    Raises
    ------
    ArgumentError
        If the horizon is not positive, the seed or the first scenario is negative, there are no
        scenarios, or they would hold too many switches.
    """
    horizon = positive("horizon", horizon)
    first, size = count("first", scenarios[0], least=0), count("count", scenarios[1])
    key = key_of(seed)
    require_few(horizon, mean)
    if size * horizon / mean > MOST_JUMPS:
        _refuse(size, horizon)
    return draw_jumps(quantiles, transition, horizon, key, first, size)


def draw_jumps(
    quantiles: Quantiles,
    transition: Float[np.ndarray, "mode mode"],
    horizon: float,
    key: UInt64[np.ndarray, 2],
    first: int,
    count: int,
) -> SignalBatch:
    """The signals of scenarios first, …, first + count − 1.

    The first mode is uniform. A sojourn too short for a double to tell its ends apart is left out.

    Parameters
    ----------
    quantiles : Quantiles
        The modes' inverse survival functions.
    transition : (mode, mode) array
        What the probabilities of the next mode are proportional to; a row of zeros stays.
    horizon : float
        The signals end here, seconds.
    key : (2,) array of uint64
        The generator's key.
    first, count : int
        Which scenarios, at least one.

    Raises
    ------
    ArgumentError
        If sojourns are so short that the signals hold too many switches, or the quantiles give
        anything but times.

    Examples
    --------
    >>> quantiles = Quantiles(np.zeros(2), np.array([0.5, 1.0]))
    >>> batch = draw_jumps(quantiles, 1.0 - np.eye(2), 3.0, key_of(0), first=0, count=4)
    >>> alone = draw_jumps(quantiles, 1.0 - np.eye(2), 3.0, key_of(0), first=2, count=1)
    >>> (alone.times == batch[2].times).all()
    np.True_
    """
    bounds = _bounds(transition)
    numbers = read_only(np.uint64(first) + np.arange(count, dtype=np.uint64))
    mode = first_modes(key, numbers, _FIRST_MODE, transition.shape[0])
    rows, time, last = np.arange(count), np.zeros(count), np.full(count, -1)
    rounds, block, jumps_read = [], 0, 0
    while rows.size:
        # Longer and longer rounds: at most a quarter of what a signal needs is read in vain.
        blocks = max(_FIRST_BLOCKS, block // 4)
        jumps_read += rows.size * blocks * WORDS
        if WORDS * block > MOST_SWITCHES:
            require_few(horizon, max(float(time.min()), _TINY) / (WORDS * block))
        if jumps_read > 2.0 * MOST_JUMPS:
            _refuse(count, horizon)
        own = read_only(numbers[rows])
        path, mode = paths(bounds, mode, key, own, _JUMPS, block, blocks)
        sojourns = quantiles(path, uniforms(key, own, block, blocks, _SOJOURNS))
        times, modes, used, time, last = starts(path, sojourns, time, last, horizon)
        rounds.append((rows, used, times, modes))
        going = time < horizon
        rows, mode, time, last = rows[going], mode[going], time[going], last[going]
        block += blocks
    return _pack(rounds, count, horizon)


def _pack(rounds: list[tuple[np.ndarray, ...]], count: int, horizon: float) -> SignalBatch:
    """The rounds' sojourns, scenario by scenario."""
    sizes = np.zeros(count, np.int64)
    for rows, used, _, _ in rounds:
        sizes[rows] += used
    first = np.concatenate(([0], np.cumsum(sizes)))
    times, modes = np.empty(first[-1]), np.empty(first[-1], np.int64)
    to = first[:-1].copy()
    for rows, used, round_times, round_modes in rounds:
        place(to, rows, used, round_times, round_modes, times, modes)
    return SignalBatch(first, times, modes, np.full(count, horizon), np.zeros(count))


def _bounds(transition: Float[np.ndarray, "mode mode"]) -> Float[np.ndarray, "mode mode"]:
    """Cumulated probabilities of the next mode; a mode that nothing leaves leads to itself."""
    bounds = np.cumsum(transition, axis=1)
    left = bounds[:, -1] > 0.0
    bounds[left] /= bounds[left, -1:]
    bounds[~left] = np.triu(np.ones(bounds.shape))[~left]
    return read_only(bounds)


def _refuse(count: int, horizon: float) -> None:
    raise ArgumentError(
        f"count = {count} signals of {horizon:g} s would hold more than {MOST_JUMPS:.0e} switches: "
        "draw fewer at once, shorten the horizon or lengthen the sojourns."
    )
