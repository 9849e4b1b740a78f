"""Calls for a controller with a mode filter: states that a plant of its model could have.

Of states drawn at random no mode could be told: evidence must be of the plant. So x follows the
model in a mode that lasts for a while, with noise, under the inputs that the controller or
`applied` gives; before it is put elsewhere it is missing for a call, so that nobody takes the jump
for a motion.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from deadtime.controller.export.moving_calls import FAR, inputs_of, lasting_modes, slots
from deadtime.controller.running import RunningLaw
from deadtime.feedback.belief import held_noise

_MOST_STAY = 400

_Call = tuple[int, float | None, int, np.ndarray, np.ndarray | None]


class _FilterMotion:
    """A state that follows the filter's model, mode by mode."""

    def __init__(self, run: RunningLaw, rng: np.random.Generator, amplitude: float) -> None:
        assert run.believing is not None
        self.belief, self.rng, self.amplitude = run.believing, rng, amplitude
        self.roots = [_root(Q) for Q in held_noise(run.believing.form)]
        self.put()

    def put(self) -> None:
        """Anywhere within the amplitude."""
        self.x = self.amplitude * self.rng.normal(size=self.belief.form.Phi.shape[1])

    @property
    def far(self) -> bool:
        """Whether it has left where the controller works."""
        return bool(np.abs(self.x).max() > FAR * self.amplitude)

    def next(self, mode: int, u: Float[np.ndarray, " m"], periods: int) -> Float[np.ndarray, " n"]:
        """x after periods in which u was sent."""
        form, x, sent = self.belief.form, self.x, self.belief.inputs
        for _ in range(periods):
            sent = np.vstack((sent[1:], u))
            x = form.Phi[mode] @ x + self.roots[mode] @ self.rng.normal(size=x.size)
            for drive, lag in zip(form.Gamma[mode], form.lag, strict=True):
                x += drive @ sent[-1 - lag]
        return x

    def seen(self, mode: int, x: Float[np.ndarray, " n"]) -> Float[np.ndarray, " seen"]:
        """What is measured of x: with noise where that is an output."""
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
    # A jump is hidden by a state that is missing.
    hidden = run.believing is not None and run.believing.bank is None
    modes = lasting_modes(run, rng, min(run.table.ages + 12, _MOST_STAY))
    for k, (mode, missed, early, when) in enumerate(slots(modes, run.step)):
        applied, u = inputs_of(run, rng, amplitude, k, k % 3 == 0)
        x = motion.next(mode, u, 1 if hidden else 1 + missed)
        if not early and k:
            motion.x = x.copy()
        lost = not missed and (motion.far or k % 53 == 20)
        if missed and hidden:
            motion.put()
            x = motion.x.copy()
        elif lost and (hidden or motion.far):
            motion.put()
        seen = motion.seen(mode, x if k else motion.x)
        if lost:
            seen[k % seen.size] = (math.nan, math.inf, -math.inf)[k % 3]
        yield 0, when, k, seen, applied  # no mode is read: any number does
