"""Random switching signals, drawn reproducibly from a seed."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import count, positive
from deadtime.base.errors import ArgumentError

BLOCK = 64
MOST_SWITCHES = 1e7

Draw = Callable[[np.random.Generator, int], np.ndarray]
Switches = tuple[np.ndarray, np.ndarray]  # times, from 0 on, and modes


def random_switches(
    modes: int,
    horizon: float,
    *,
    dwell_time: float | None,
    average_dwell_time: float | None,
    mean_sojourn: float | None,
    chatter: int,
    seed: int,
) -> Switches:
    """Times and modes of `SwitchingSignal.random`, whose arguments these are."""
    horizon = positive("horizon", horizon)
    if (dwell_time is None) == (average_dwell_time is None):
        raise ArgumentError("dwell_time or average_dwell_time: give exactly one of the two.")
    count("modes", modes)
    count("seed", seed, least=0)
    rng, mode_rng = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))
    if dwell_time is not None:
        times = _minimum_dwell(rng, horizon, positive("dwell_time", dwell_time), mean_sojourn)
    else:
        count("chatter", chatter)
        average = positive("average_dwell_time", average_dwell_time)
        mean = average if mean_sojourn is None else positive("mean_sojourn", mean_sojourn)
        times = _average_dwell(rng, horizon, average, mean, chatter)
    visited = [int(mode_rng.integers(modes))]
    for _ in times:
        shift = int(mode_rng.integers(1, modes)) if modes > 1 else 0
        visited.append((visited[-1] + shift) % modes)
    return np.array([0.0, *times]), np.array(visited)


def mean_or_twice(dwell_time: float, mean_sojourn: float | None = None) -> float:
    """The mean of whole sojourns, seconds: twice the dwell time where none is stated."""
    return 2.0 * dwell_time if mean_sojourn is None else mean_sojourn


def require_few(horizon: float, mean: float) -> None:
    """Refuse a horizon that would hold more switches than memory."""
    if horizon / mean > MOST_SWITCHES:
        raise ArgumentError(
            f"horizon = {horizon:g} s would hold about {horizon / mean:.0e} switches, more than "
            f"{MOST_SWITCHES:.0e}: shorten it or lengthen the sojourns."
        )


def _minimum_dwell(
    rng: np.random.Generator, horizon: float, dwell_time: float, mean_sojourn: float | None
) -> list[float]:
    """Switching instants below the horizon, at least `dwell_time` apart."""
    mean = positive("mean_sojourn", mean_or_twice(dwell_time, mean_sojourn))
    if mean < dwell_time:
        raise ArgumentError(
            f"mean_sojourn must be at least dwell_time = {dwell_time:g} s, got {mean:g}."
        )
    require_few(horizon, mean)
    times, time = [], 0.0
    while (time := time + dwell_time + rng.exponential(mean - dwell_time)) < horizon:
        times.append(time)
    return times


def _average_dwell(
    rng: np.random.Generator, horizon: float, average: float, mean: float, chatter: int
) -> list[float]:
    """Poisson instants thinned by the leaky bucket."""
    require_few(horizon, mean)
    times, time, level, last = [], 0.0, float(chatter), 0.0
    while (time := time + rng.exponential(mean)) < horizon:
        level = min(float(chatter), level + (time - last) / average)
        last = time
        if level >= 1.0:
            times.append(time)
            level -= 1.0
    return times


def jump_switches(
    draws: Sequence[Draw],
    transition: Float[np.ndarray, "mode mode"],
    horizon: float,
    seed: int,
) -> Switches:
    """Times and modes of a process that stays in mode i for a time from draws[i], then jumps.

    Jumps go by the rows of `transition`; the first mode is uniform. Each mode has a generator of
    its own, and one more decides the jumps; all are read in blocks of a fixed size, so a longer
    horizon continues the signal. A sojourn too short for a double to tell its ends apart is left
    out.
    """
    seeds = np.random.SeedSequence(seed).spawn(len(draws) + 1)
    jump_rng, *sojourn_rngs = map(np.random.default_rng, seeds)
    bounds = np.cumsum(transition, axis=1)
    bounds = (bounds / np.maximum(bounds[:, -1:], np.finfo(float).tiny)).tolist()
    sojourns: list[list[float]] = [[] for _ in draws]
    jumps: list[float] = []
    time, mode = 0.0, int(jump_rng.integers(len(draws)))
    times, visited = [time], [mode]
    while True:
        if not sojourns[mode]:
            sojourns[mode] = draws[mode](sojourn_rngs[mode], BLOCK)[::-1].tolist()
            if len(times) > MOST_SWITCHES:
                require_few(horizon, max(time, np.finfo(float).tiny) / len(times))
        time += sojourns[mode].pop()
        if time >= horizon:
            break
        jumps = jumps or jump_rng.random(BLOCK).tolist()
        mode = bisect_right(bounds[mode], jumps.pop())
        times.append(time)
        visited.append(mode)
    starts = np.array(times)
    kept = np.append(np.diff(starts) > 0.0, True)
    return starts[kept], np.array(visited)[kept]
