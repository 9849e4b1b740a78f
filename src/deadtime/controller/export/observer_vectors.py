"""Calls for a controller with an observer: outputs that a plant of its model could have.

x follows the observer's own model, in modes that last for a while, under the inputs that the
controller or `applied` gives. Where it has gone too far it is put elsewhere: the estimate follows.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from deadtime.controller.export.moving_calls import FAR, inputs_of, lasting_modes, slots
from deadtime.controller.observing import Observing
from deadtime.controller.running import RunningLaw

_NOISE = 1e-3  # amplitudes

Call = tuple[int, float | None, int, np.ndarray, np.ndarray | None, np.ndarray | None]


class _ObserverMotion:
    """A state of the observer's model, and what is measured of it."""

    def __init__(self, observing: Observing, rng: np.random.Generator, amplitude: float) -> None:
        self.memory, self.rng, self.amplitude = observing.memory, rng, amplitude
        self.sent = np.zeros((int(self.memory.lag.max()) + 1, self.memory.sizes.m))
        self.put()

    def put(self) -> None:
        """Anywhere within the amplitude."""
        self.x = self.amplitude * self.rng.normal(size=self.memory.gain.shape[1])

    def go(self, mode: int, u: Float[np.ndarray, " m"]) -> None:
        """Over a period in which u was sent."""
        memory = self.memory
        self.sent = np.vstack((self.sent[1:], u))
        self.x = memory.Phi[mode] @ self.x
        for drive, lag in zip(memory.Gamma[mode], memory.lag, strict=True):
            self.x += drive @ self.sent[-1 - lag]
        if np.abs(self.x).max() > FAR * self.amplitude:
            self.put()

    def outputs(self, mode: int) -> Float[np.ndarray, " p"]:
        """y, with noise."""
        C = self.memory.C[mode]
        return C @ self.x + _NOISE * self.amplitude * self.rng.normal(size=len(C))


def observer_calls(run: RunningLaw, amplitude: float) -> Iterator[Call]:
    """Modes that last; missing outputs, unknown modes, references good and bad, clocks."""
    assert run.observing is not None
    rng = np.random.default_rng(0)
    motion = _ObserverMotion(run.observing, rng, amplitude)
    modes, r = lasting_modes(run, rng, run.table.ages + 2), len(motion.memory.tracked)
    reference = None
    for k, (mode, missed, early, when) in enumerate(slots(modes, run.step)):
        applied, u = inputs_of(run, rng, amplitude, k, k % 7 == 3)
        for _ in range(0 if early or not k else 1 + missed):
            motion.go(int(modes[k - 1]), u)
        y = motion.outputs(mode)
        if rng.random() < 0.1:
            y[k % y.size] = (math.nan, math.inf, -math.inf)[k % 3]
        if r and k % 40 == 20:  # one of its own now and then
            reference = rng.normal(size=r) * amplitude if k % 120 != 20 else None
        told = np.full(r, math.nan) if r and k % 67 == 50 else reference
        yield 0, when, run.law.plant.modes + k if k % 71 == 45 else mode, y, applied, told
