"""Random signals with a minimum or an average dwell time."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from deadtime.base.checks import count, positive
from deadtime.base.errors import ArgumentError
from deadtime.switching.constraint import PerMode, SwitchingConstraint
from deadtime.switching.models.jump_process import JumpProcess, Switches
from deadtime.switching.models.quantiles import Quantiles
from deadtime.switching.models.sojourns import Fixed, ShiftedExponential
from deadtime.switching.models.truncation import truncate


def random_switches(
    modes: int,
    horizon: float,
    *,
    dwell_time: PerMode | None,
    maximum_dwell: PerMode | None = None,
    transitions: ArrayLike | None = None,
    average_dwell_time: float | None,
    mean_sojourn: float | None,
    chatter: int,
    seed: int,
) -> Switches:
    """The one signal of `SwitchingSignal.random`, whose arguments these are."""
    if (dwell_time is None) == (average_dwell_time is None):
        raise ArgumentError("dwell_time or average_dwell_time: give exactly one of the two.")
    allowed = SwitchingConstraint.of(count("modes", modes), dwell_time, maximum_dwell, transitions)
    ways = allowed.transitions.astype(float)
    if dwell_time is not None:
        means = []
        for dwell in allowed.dwell_time:
            mean = positive("mean_sojourn", mean_or_twice(dwell, mean_sojourn))
            if mean < dwell:
                raise ArgumentError(
                    f"mean_sojourn must be at least dwell_time = {dwell:g} s, got {mean:g}."
                )
            means.append(mean)
        return _process(allowed, np.array(means), ways).draw(horizon, seed)
    if maximum_dwell is not None:
        raise ArgumentError(
            "maximum_dwell goes with dwell_time, not with average_dwell_time: leave it out."
        )
    average = positive("average_dwell_time", average_dwell_time)
    mean = average if mean_sojourn is None else positive("mean_sojourn", mean_sojourn)
    most = count("chatter", chatter)
    process = _process(allowed, np.full(allowed.modes, mean), ways)
    _, times, visited = process.draw(horizon, seed)
    kept = times[_passes(times, average, most)]
    # Modes in the order drawn, whichever instants pass: each may follow the one before.
    return Switches(np.array([0, kept.size]), kept, visited[: kept.size])


def mean_or_twice(dwell_time: float, mean_sojourn: float | None = None) -> float:
    """The mean of whole sojourns, seconds: twice the dwell time where none is stated."""
    return 2.0 * dwell_time if mean_sojourn is None else mean_sojourn


def _process(allowed: SwitchingConstraint, mean: np.ndarray, ways: np.ndarray) -> JumpProcess:
    """Sojourns of the dwell time and an exponential time; each next mode uniform over the others.

    Where there is a longest sojourn, given that they are no longer.
    """
    shift, most = np.array(allowed.dwell_time), np.array(allowed.maximum_dwell)
    drawn = [
        Fixed(low) if wide == 0.0 or high == low else ShiftedExponential(low, wide)
        for low, wide, high in zip(
            shift.tolist(), (mean - shift).tolist(), most.tolist(), strict=True
        )
    ]
    ends = zip(drawn, allowed.dwell_time, allowed.maximum_dwell, strict=True)
    sojourn = [truncate("dwell_time", *each) for each in ends]
    return JumpProcess(Quantiles.of(sojourn), ways, min(float(mean.max()), float(most.max())))


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
