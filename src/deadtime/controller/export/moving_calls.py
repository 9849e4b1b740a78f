"""Test calls for controllers with an observer or a belief: measurements of a plant in motion.

The plant follows the model under the inputs of the controller or of `applied`, in modes that last
for a while. A state that has grown too large is replaced by a new one, and the estimate converges
to it. With a mode filter the model has noise, as no mode could be identified from states drawn at
random, and a new state comes after a missing one, so that the filter sees no jump.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.controller.controller_state import Observing
from deadtime.controller.running import RunningLaw
from deadtime.feedback.belief import held_noise

FAR = 30.0  # amplitudes beyond which a state is replaced
_HOSTILE = 300


class Slot(NamedTuple):
    """The time of a call: after missed periods, out of order, or without a time."""

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
    """A mode for every call: short stays, one long stay in each mode, the short stays again.

    Long stays last at least `least` calls each, and two windows together.
    """
    count = run.law.plant.modes
    stay = max(least, -(-(2 * run.table.taps + 10) // count))
    short = np.repeat(rng.integers(0, count, _HOSTILE), rng.integers(1, 30, _HOSTILE))
    half = short[: _HOSTILE // 2]
    return np.concatenate((half, np.repeat(np.arange(count), stay), half))


def inputs_of(
    run: RunningLaw, rng: np.random.Generator, amplitude: float, k: int, reported: bool
) -> tuple[Float[np.ndarray, " m"] | None, Float[np.ndarray, " m"]]:
    """The `applied` of call k, sometimes NaN, and the input that acts on the plant."""
    applied = rng.normal(size=run.law.plant.inputs) * amplitude if reported else None
    if k % 61 == 30:
        return np.full(run.law.plant.inputs, math.nan), run._u
    return applied, run._u if applied is None else applied


_NOISE = 1e-3  # amplitudes

Call = tuple[int, float | None, int, np.ndarray, np.ndarray | None, np.ndarray | None]


class _ObserverMotion:
    """A state of the observer's model, and its measurements."""

    def __init__(self, observing: Observing, rng: np.random.Generator, amplitude: float) -> None:
        self.memory, self.rng, self.amplitude = observing.memory, rng, amplitude
        self.sent = np.zeros((int(self.memory.lag.max()) + 1, self.memory.sizes.m))
        self.draw_state()

    def draw_state(self) -> None:
        """Draw a new state."""
        self.x = self.amplitude * self.rng.normal(size=self.memory.gain.shape[1])

    def go(self, mode: int, u: Float[np.ndarray, " m"]) -> None:
        """Move over a period under u."""
        memory = self.memory
        self.sent = np.vstack((self.sent[1:], u))
        self.x = memory.Phi[mode] @ self.x
        for drive, lag in zip(memory.Gamma[mode], memory.lag, strict=True):
            self.x += drive @ self.sent[-1 - lag]
        if np.abs(self.x).max() > FAR * self.amplitude:
            self.draw_state()

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
        if r and k % 40 == 20:  # at times the law's own
            reference = rng.normal(size=r) * amplitude if k % 120 != 20 else None
        given = np.full(r, math.nan) if r and k % 67 == 50 else reference
        yield 0, when, run.law.plant.modes + k if k % 71 == 45 else mode, y, applied, given


_MOST_STAY = 400

_Call = tuple[int, float | None, int, np.ndarray, np.ndarray | None]


class _FilterMotion:
    """A state that follows the filter's model, mode by mode."""

    def __init__(self, run: RunningLaw, rng: np.random.Generator, amplitude: float) -> None:
        assert run.mode_belief is not None
        self.belief, self.rng, self.amplitude = run.mode_belief, rng, amplitude
        self.roots = [_root(Q) for Q in held_noise(run.mode_belief.form)]
        self.draw_state()

    def draw_state(self) -> None:
        """Draw a new state."""
        self.x = self.amplitude * self.rng.normal(size=self.belief.form.Phi.shape[1])

    @property
    def far(self) -> bool:
        """Whether the state is too large."""
        return bool(np.abs(self.x).max() > FAR * self.amplitude)

    def next(self, mode: int, u: Float[np.ndarray, " m"], periods: int) -> Float[np.ndarray, " n"]:
        """x after some periods under u."""
        form, x, sent = self.belief.form, self.x, self.belief.inputs
        for _ in range(periods):
            sent = np.vstack((sent[1:], u))
            x = form.Phi[mode] @ x + self.roots[mode] @ self.rng.normal(size=x.size)
            for drive, lag in zip(form.Gamma[mode], form.lag, strict=True):
                x += drive @ sent[-1 - lag]
        return x

    def seen(self, mode: int, x: Float[np.ndarray, " n"]) -> Float[np.ndarray, " seen"]:
        """The measurement of x: x itself, or noisy outputs where the law runs on those."""
        bank = self.belief.bank
        if bank is None:
            return x.copy()
        noise = np.sqrt(bank.variance) * self.rng.normal(size=bank.variance.size)
        return bank.C[mode] @ x + noise


def _root(Q: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    """R with R Rᵀ = Q."""
    U, values, _ = np.linalg.svd(Q)
    return U * np.sqrt(values)


def belief_calls(run: RunningLaw, amplitude: float) -> Iterator[_Call]:
    """(skip, time, mode, x, applied): modes that last, missing and jumping states, clocks."""
    rng = np.random.default_rng(0)
    motion = _FilterMotion(run, rng, amplitude)
    # A filter of states would read a jump as a switch: a missing state hides it.
    hidden = run.mode_belief is not None and run.mode_belief.bank is None
    modes = lasting_modes(run, rng, min(run.table.ages + 12, _MOST_STAY))
    for k, (mode, missed, early, when) in enumerate(slots(modes, run.step)):
        applied, u = inputs_of(run, rng, amplitude, k, k % 3 == 0)
        x = motion.next(mode, u, 1 if hidden else 1 + missed)
        if not early and k:
            motion.x = x.copy()
        lost = not missed and (motion.far or k % 53 == 20)
        if missed and hidden:
            motion.draw_state()
            x = motion.x.copy()
        elif lost and (hidden or motion.far):
            motion.draw_state()
        seen = motion.seen(mode, x if k else motion.x)
        if lost:
            seen[k % seen.size] = (math.nan, math.inf, -math.inf)[k % 3]
        yield 0, when, k, seen, applied  # the mode is ignored: any number will do
