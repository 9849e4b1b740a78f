"""Numbers of every scenario and sample, eight scenarios side by side, for the compiled loop.

(scenario, sample, …) goes to (group, sample, …, lane), flat: group g has the scenarios 8g, …,
8g + 7, and the last of all fills the last group. At a sample the loop reads one contiguous block:

    scenario     0  1  2 … 7 | 0  1  2 … 7 | … | 8  9 10 … 15 | …
    sample       0           | 1           | … | 0            | …
    group        0                             | 1
"""

from __future__ import annotations

import numpy as np

from deadtime.numerics.kernels import kernel
from deadtime.numerics.lanes.code import LANES


def groups(scenarios: int) -> int:
    """How many groups there are."""
    return -(-scenarios // LANES)


def from_scenario(in_lanes: np.ndarray, begin: int, scenarios: int) -> np.ndarray:
    """The part of lane-ordered data from a scenario on whose number is a multiple of eight."""
    return in_lanes[begin // LANES * (in_lanes.size // groups(scenarios)) :]


@kernel(eager=True, nogil=True)
def fill_numbers(numbers, begin, in_lanes):
    """Fill `in_lanes` from group `begin` on with numbers (scenario, sample, n)."""
    scenarios, samples, n = numbers.shape
    at = begin * samples * n * LANES
    for first in range(0, scenarios, LANES):
        for k in range(samples):
            for i in range(n):
                for lane in range(LANES):
                    in_lanes[at] = numbers[min(first + lane, scenarios - 1), k, i]
                    at += 1


@kernel(eager=True, nogil=True)
def fill_forces(in_lanes, begin, few, draws, maps, first, step, which, samples, states, numbers):
    """Add a disturbance's draws to `in_lanes`, for `few` scenarios from `begin` on.

    draws : (stretch, few or 1, sample, r);  maps : (map, stretch, n, r)
    first, step, which : of `Records`, `which` being its `map`
    states, numbers : n and r as the lengths of tuples, so that sums over them are unrolled
    """
    stretches, runs, periods, _ = draws.shape
    n, r = len(states), len(numbers)
    drawn, flat = draws.reshape(-1), maps.reshape(-1)
    for f in range(few + -few % LANES):
        # Lanes beyond the last scenario repeat it, so that they hold numbers of a run, too.
        run = min(f, few - 1, runs - 1)
        at = (begin + f) // LANES * samples * stretches * n * LANES + f % LANES
        record, last = first[begin + min(f, few - 1)], first[begin + min(f, few - 1) + 1] - 1
        for k in range(samples):
            while record < last and step[record + 1] <= k:
                record += 1
            entry = which[record] * stretches * n * r
            for s in range(stretches):
                of = ((s * runs + run) * periods + k) * r
                for i in range(n):
                    total = in_lanes[at + i * LANES]
                    for j in range(r):
                        total += flat[entry + i * r + j] * drawn[of + j]
                    in_lanes[at + i * LANES] = total
                entry += n * r
                at += n * LANES
