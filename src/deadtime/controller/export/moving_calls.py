"""What the calls of a plant in motion share: modes that last, clocks and inputs as applied."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.controller.running import RunningLaw

FAR = 30.0  # amplitudes beyond which a state is put elsewhere
_HOSTILE = 300


class Slot(NamedTuple):
    """When a call comes: after periods without one, out of order, or without a clock."""

    mode: int
    missed: int
    early: bool
    when: float | None


def slots(modes: np.ndarray, step: float) -> Iterator[Slot]:
    """One for every mode; in their second half jitter, missed periods and calls out of order."""
    time, half = 0.0, len(modes) // 2
    for k, mode in enumerate(modes.tolist()):
        clocked = k > half
        missed, early = (1 + k % 5) * (clocked and k % 29 == 7), clocked and k % 47 == 5
        time += step * (1 + missed) * (clocked and not early)
        yield Slot(mode, missed, early, time + 0.3 * step * math.sin(k) if clocked else None)


def lasting_modes(run: RunningLaw, rng: np.random.Generator, least: int) -> np.ndarray:
    """A mode for every call: short ones, and each `least` calls and two windows by all of them."""
    count = run.law.plant.modes
    stay = max(least, -(-(2 * run.table.taps + 10) // count))
    short = np.repeat(rng.integers(0, count, _HOSTILE), rng.integers(1, 30, _HOSTILE))
    half = short[: _HOSTILE // 2]
    return np.concatenate((half, np.repeat(np.arange(count), stay), half))


def inputs_of(
    run: RunningLaw, rng: np.random.Generator, amplitude: float, k: int, reported: bool
) -> tuple[Float[np.ndarray, " m"] | None, Float[np.ndarray, " m"]]:
    """The input reported to call k, NaN now and then, and the one that acts."""
    applied = rng.normal(size=run.law.plant.inputs) * amplitude if reported else None
    if k % 61 == 30:
        return np.full(run.law.plant.inputs, math.nan), run._u
    return applied, run._u if applied is None else applied
