"""Test vectors: arguments of calls, hostile ones among them, and the results of a controller.

A line may stand for many calls whose arguments check.c draws itself (`Draws`). Their inputs u are
compared as a sum, so that a short table covers long windows and many rows.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from deadtime.base.version import __version__
from deadtime.controller.export.moving_calls import Call, belief_calls, observer_calls
from deadtime.controller.running import RunningLaw

_SHARE = 1e-3  # least weight of a row that counts as visited, with a belief
_HOSTILE, _MOST_LINES = 300, 800


_Call = tuple[int, float | None, int, np.ndarray, np.ndarray | None]


class Vectors(NamedTuple):
    """A CSV table, constants for check.c, and the coverage."""

    csv: str
    scale: float  # the largest sum of moduli of terms
    line: int  # characters of the longest line
    amplitude: float  # of the numbers that check.c draws
    mode_age: int  # at reset
    calls: int
    rows: int  # visited


class Draws:
    """Numbers in [-amplitude, amplitude) that C draws to the last bit, in single precision too."""

    def __init__(self, amplitude: float) -> None:
        self.amplitude, self.seed = amplitude, 1

    def __call__(self, size: int) -> np.ndarray:
        found = np.empty(size)
        for i in range(size):
            self.seed = (1664525 * self.seed + 1013904223) % 2**32
            found[i] = (self.seed // 2**8) / 2.0**23 - 1.0
        return self.amplitude * found


def vectors(controller: RunningLaw) -> Vectors:
    """Run a copy of the controller from random past inputs through all rows, with bad calls."""
    point, rest = controller.operating_point, controller.rest
    run = RunningLaw(
        controller.law, controller.step, limits=controller.limits, operating_point=point
    )
    plant, table = run.law.plant, run.table
    n, m = run.measured, plant.inputs
    amplitude = _amplitude(run)
    # Drawn in the order in which check.c draws: past inputs, then call by call.
    draws, age = Draws(amplitude), 7 if plant.modes > 1 else 0
    run.reset((rest.u + draws(table.taps * m).reshape(table.taps, m)).T, age)
    observed = run.observing
    heading = [
        *("skip", "time", "mode"),
        *(f"{'y' if observed else 'x'}{i}" for i in range(n)),
        *(f"r{i}" for i in range(observed.tracked if observed else 0)),
        *(f"applied{i}" for i in range(m)),
        "status",
        *(f"u{i}" for i in range(m)),
    ]
    lines = [f"# Written by deadtime {__version__}", ",".join(heading)]
    seen, calls, visited = amplitude, 0, set()
    widest = np.full(table.state_gain.shape[2], 5.0 * amplitude)
    for skip, when, mode, x, applied, *more in _calls_of(run, amplitude):
        x = rest.given + x
        applied = None if applied is None else rest.u + applied
        r = None if not more or more[0] is None else rest.reference + more[0]
        u = np.zeros(m)
        for _ in range(skip):
            u += run.update(rest.given + draws(n), mode, rest.u + draws(m))
            visited.update(_rows(run))
        u += run.update(x, mode, applied, time=when, reference=r)
        visited.update(_rows(run))
        calls += skip + 1
        seen = max(seen, float(np.abs(u).max()) / (skip + 1))
        if observed:
            widest = np.maximum(widest, np.abs(observed.z))
        fields = [str(skip), "" if when is None else repr(when), str(mode), *map(repr, x.tolist())]
        if observed:
            fields += [""] * observed.tracked if r is None else map(repr, r.tolist())
        fields += [""] * m if applied is None else map(repr, applied.tolist())
        lines.append(",".join([*fields, str(int(run.status)), *map(repr, u.tolist())]))
    scale = float(np.abs(table.state_gain).sum(axis=2).max()) * 5.0 * amplitude
    if observed:
        scale = float((np.abs(table.state_gain) @ widest).max())
    scale += float(np.abs(table.input_gain).sum(axis=(1, 3)).max()) * max(seen, 5.0 * amplitude)
    if point is not None:  # the operating point has round-off, too
        scale += float((np.abs(table.state_gain) @ np.abs(rest.z)).max() + np.abs(rest.u).max())
    csv, longest = "\n".join(lines) + "\n", max(map(len, lines))
    return Vectors(csv, scale, longest, amplitude, age, calls, len(visited))


def _calls_of(run: RunningLaw, amplitude: float) -> Iterator[_Call | Call]:
    """The calls for a kind of controller."""
    if run.observing is not None:
        return observer_calls(run, amplitude)
    return (_calls if run.mode_belief is None else belief_calls)(run, amplitude)


def _calls(run: RunningLaw, amplitude: float) -> Iterator[_Call]:
    """(skip, time, mode, x, applied): bad values, all rows, then times."""
    plant, rng = run.law.plant, np.random.default_rng(0)
    modes = np.repeat(rng.integers(0, plant.modes, _HOSTILE), rng.integers(1, 30, _HOSTILE))
    half, time = _HOSTILE // 2, 0.0
    for k in range(_HOSTILE):
        if k == half:
            yield from _through_rows(run, rng, amplitude, int(modes[k - 1]))
        x, applied, mode = rng.normal(size=plant.states) * amplitude, None, int(modes[k])
        if k % 3 == 0:
            applied = rng.normal(size=plant.inputs) * amplitude
        if k % 11 == 5:
            x *= 20.0  # into the limits
        if k % 53 == 20:
            x[k % plant.states] = (math.nan, math.inf, -math.inf)[k % 3]
        if k % 61 == 30:
            applied = np.full(plant.inputs, math.nan)
        if k % 71 == 40:
            mode = plant.modes + k
        when = None
        if k > half:  # clocks: jitter, periods without a call, calls out of order
            time += run.step * (k % 47 != 5) * (1 + (k % 29 == 7) * (1 + k % 5))
            when = time + 0.3 * run.step * math.sin(k)
        yield 0, when, mode, x, applied


def _through_rows(
    run: RunningLaw, rng: np.random.Generator, amplitude: float, last: int
) -> Iterator[_Call]:
    """At least two windows of inputs, and each mode until its rows no longer change."""
    plant, table = run.law.plant, run.table
    stay = max(table.ages + 2, -(-(2 * table.taps + 10) // plant.modes))
    skip = plant.modes * stay // _MOST_LINES
    for i in range(plant.modes):
        for _ in range(-(-stay // (skip + 1))):
            x, applied = (
                rng.normal(size=size) * amplitude for size in (plant.states, plant.inputs)
            )
            yield skip, None, (last + 1 + i) % plant.modes, x, applied


def _rows(run: RunningLaw) -> Iterable[int]:
    """The rows that contributed to the last input."""
    if run.mode_belief is not None:
        return np.flatnonzero(run.mode_belief.running.state.weight > _SHARE).tolist()
    mode, age = run._mode, run._age  # `state` would copy the past at every call
    return [run.table.row(mode, age) if mode >= 0 else 0]


def _amplitude(run: RunningLaw) -> float:
    """A power of two, so small that most inputs are within the limits: saturation hides errors."""
    table = run.table
    each = (table.state_gain**2).sum(axis=2) + (table.input_gain**2).sum(axis=(1, 3))
    spread = float(np.sqrt(each.max(axis=0)).max())
    reach = float(np.minimum(np.maximum(np.abs(run.low), np.abs(run.high)), 1e9).min())
    wanted = reach / (4.0 * max(spread, 1e-9))
    return float(2.0 ** np.floor(np.log2(min(max(wanted, 1e-6), 1.0))))
