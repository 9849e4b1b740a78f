"""Numbers of every scenario and sample, eight scenarios side by side, for the compiled loop.

(scenario, sample, …) goes to (group, sample, …, lane), flat: group g has the scenarios 8g, …,
8g + 7, the last of all filling the rest.
"""

from __future__ import annotations

import inspect

import numpy as np

from deadtime.feedback.table import age_after, row_at
from deadtime.numerics.kernels import inner_kernel, kernel
from deadtime.numerics.lanes.code import LANES

# Compiled from what is written: a checker of types may have wrapped it.
_age_after, row_of_mode = (inner_kernel(inspect.unwrap(rule)) for rule in (age_after, row_at))


def groups(scenarios: int) -> int:
    """How many groups there are."""
    return -(-scenarios // LANES)


def from_scenario(laid: np.ndarray, begin: int, scenarios: int) -> np.ndarray:
    """The part of lane-ordered data from a scenario on whose number is a multiple of eight."""
    return laid[begin // LANES * (laid.size // groups(scenarios)) :]


@kernel(eager=True, nogil=True)
def lay_lags(sample, scenarios, begin, lag, reach):
    """Fill `lag`, from group `begin` on; how long the longest is, `reach` at least.

    `sample` (scenario or 1, sample) is whose measurement is received, −1 for none.
    """
    samples, at = sample.shape[1], begin * sample.shape[1] * LANES
    for first in range(0, scenarios, LANES):
        for k in range(samples):
            for lane in range(LANES):
                s = min(first + lane, scenarios - 1, sample.shape[0] - 1)
                heard = sample[s, k]
                lag[at] = -1 if heard < 0 else k - heard
                reach = max(reach, lag[at])
                at += 1
    return reach


@kernel(eager=True, nogil=True)
def lay_numbers(numbers, begin, laid):
    """Fill `laid` from group `begin` on with numbers (scenario, sample, n)."""
    scenarios, samples, n = numbers.shape
    at = begin * samples * n * LANES
    for first in range(0, scenarios, LANES):
        for k in range(samples):
            for i in range(n):
                for lane in range(LANES):
                    laid[at] = numbers[min(first + lane, scenarios - 1), k, i]
                    at += 1


@kernel(eager=True, nogil=True)
def lay_forces(laid, begin, few, draws, maps, first, step, which, samples, states, numbers):
    """Add to `laid`, from scenario `begin` on, what a disturbance's draws make for `few` of them.

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
                    total = laid[at + i * LANES]
                    for j in range(r):
                        total += flat[entry + i * r + j] * drawn[of + j]
                    laid[at + i * LANES] = total
                entry += n * r
                at += n * LANES


@kernel(eager=True, nogil=True)
def lay_rows(told, sampled, begun, apart, ages, row):
    """Fill `row` with a table's rows by reported modes, −1 for none, as `feedback.table.follow`.

    told, sampled : (scenario, sample), the mode that is reported to a law, and the plant's
    begun : (scenario,), how old the first mode is at time 0, samples
    apart, ages : those of the `Feedback`
    """
    scenarios, samples = told.shape
    for s in range(scenarios + -scenarios % LANES):
        source = min(s, scenarios - 1)
        at = s // LANES * samples * LANES + s % LANES
        mode, age, before = -1, np.int64(begun[source]), sampled[source, 0]
        for k in range(samples):
            now, true = told[source, k], sampled[source, k]
            if mode >= 0:
                age = _age_after(mode, age, now)
            elif k > 0:
                # Before any is known, the age is that of the plant's mode.
                age = _age_after(before, age, true)
            mode, before = mode if now < 0 else now, true
            row[at] = row_of_mode(apart, ages, max(mode, 0), age)
            at += LANES
