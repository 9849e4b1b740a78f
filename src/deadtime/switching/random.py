"""Random signals with a minimum or an average dwell time."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from deadtime.base.checks import count, positive
from deadtime.base.errors import ArgumentError
from deadtime.switching.models.jump_process import JumpProcess, Switches
from deadtime.switching.models.quantiles import Quantiles


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
    """The one signal of `SwitchingSignal.random`, whose arguments these are."""
    if (dwell_time is None) == (average_dwell_time is None):
        raise ArgumentError("dwell_time or average_dwell_time: give exactly one of the two.")
    if dwell_time is not None:
        dwell = positive("dwell_time", dwell_time)
        mean = positive("mean_sojourn", mean_or_twice(dwell, mean_sojourn))
        if mean < dwell:
            raise ArgumentError(
                f"mean_sojourn must be at least dwell_time = {dwell:g} s, got {mean:g}."
            )
        return _process(modes, dwell, mean).draw(horizon, seed)
    average = positive("average_dwell_time", average_dwell_time)
    mean = average if mean_sojourn is None else positive("mean_sojourn", mean_sojourn)
    most = count("chatter", chatter)
    _, times, visited = _process(modes, 0.0, mean).draw(horizon, seed)
    kept = times[_passes(times, average, most)]
    # Modes in the order drawn, whichever instants pass: each differs from the one before.
    return Switches(np.array([0, kept.size]), kept, visited[: kept.size])


def mean_or_twice(dwell_time: float, mean_sojourn: float | None = None) -> float:
    """The mean of whole sojourns, seconds: twice the dwell time where none is stated."""
    return 2.0 * dwell_time if mean_sojourn is None else mean_sojourn


def _process(modes: int, dwell: float, mean: float) -> JumpProcess:
    """Sojourns of `dwell` and an exponential time; each next mode uniform over the others."""
    number = count("modes", modes)
    sojourn = Quantiles(np.full(number, dwell), np.full(number, mean - dwell))
    return JumpProcess(sojourn, 1.0 - np.eye(number), mean)


def _passes(
    times: Float[np.ndarray, " sojourn"], average: float, chatter: int
) -> Bool[np.ndarray, " sojourn"]:
    """Which instants the leaky bucket lets through; the one at 0 is no switch and costs nothing."""
    passed, level, last = np.ones(times.size, dtype=bool), float(chatter), 0.0
    for i, time in enumerate(times[1:].tolist(), start=1):
        level = min(float(chatter), level + (time - last) / average)
        last = time
        passed[i] = level >= 1.0
        level -= passed[i]
    return passed
