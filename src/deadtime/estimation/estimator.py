"""What an observer remembers from one period to the next, and for tracking the sum of the errors.

The law is given z = (x̂, d̂, q, r): the observer's estimate, the sum of the tracking errors and the
reference (`deadtime.estimation`; of a law that tracks nothing z = x̂). The sum is the trapezoid of
what was *measured*,

    q_k = q_{k−1} + h (v_{k−1} + v_k)/2 − h r_{k−1},    v = H y,

so that an equilibrium has v = r whatever the model; a sum of estimates would settle where the
model believes the error to be 0. It follows the integral of the model to O(h²).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import read_only
from deadtime.estimation.observer import Observer
from deadtime.estimation.reference import Reference
from deadtime.feedback.memory import Memory
from deadtime.plant import SampledPlant


class Tracked:
    """What an estimator must know of a servo: H (tracked, p), whether to sum, the law's answer.

    `push` (modes, m, sums) is how the law's input answers q, for the sum to stop in time.
    """

    def __init__(
        self, H: Float[np.ndarray, "r p"], push: Float[np.ndarray, "mode m q"], integral: bool
    ) -> None:
        self.H, self.push, self.integral = H, np.ascontiguousarray(push), integral


class Estimator:
    """An observer that runs; `begin`, then `update` once a period.

    Attributes
    ----------
    z : (states of the law's model,)
        What the law is given, as of the last update.
    asked : (m,)
        What the law asked for; whoever runs it writes it here.
    corrected : bool
        Whether the last update had a measurement that it could use.
    """

    arrays = ("z", "ring", "counters", "asked", "before")

    def __init__(
        self,
        observer: Observer,
        estimate: Float[np.ndarray, " n"],
        tracked: Tracked | None = None,
    ) -> None:
        plant = observer.plant
        self.observer, self.tracked, self._start = observer, tracked, estimate
        sampled = SampledPlant(plant, observer.step)
        self._pieces = [sampled.pieces(mode) for mode in range(plant.modes)]
        self._channels = np.arange(plant.inputs)
        r = 0 if tracked is None else tracked.H.shape[0]
        q = r if tracked is not None and tracked.integral else 0
        n = plant.states
        self.z = np.zeros(n + q + r)
        self._parts = slice(0, n), slice(n, n + q), slice(n + q, n + q + r)
        self.corrected = False
        self.ring = np.zeros((sampled.longest_lag + 1, plant.inputs))
        self._spare = np.zeros(n)
        self.counters = np.zeros(3, np.int64)  # samples, place in the ring, mode
        self.asked = np.zeros(plant.inputs)
        self.before, self._now = np.zeros(r), np.zeros(r)
        self._innovation = np.zeros(observer.outputs)
        self._nothing = np.full(observer.outputs, np.nan)

    # Views that are made when they are used: a copy's are of its own z.
    @property
    def _x(self) -> Float[np.ndarray, " n"]:
        return self.z[self._parts[0]]

    @property
    def _q(self) -> Float[np.ndarray, " q"]:
        return self.z[self._parts[1]]

    @property
    def _r(self) -> Float[np.ndarray, " r"]:
        return self.z[self._parts[2]]

    def begin(self, history: Float[np.ndarray, "past m"]) -> None:
        """Start anew; `history` are the inputs before, at least N of them, the oldest first."""
        for name in self.arrays:
            getattr(self, name)[...] = 0
        self._x[:] = self._start
        self.ring[2:] = history[len(history) + 1 - len(self.ring) : -1]
        self.asked[:] = history[-1]

    def update(
        self,
        latest: Float[np.ndarray, " m"],
        y: Float[np.ndarray, " p"] | None,
        mode: int,
        reference: Float[np.ndarray, " r"] | None = None,
    ) -> Float[np.ndarray, " z"]:
        """z at this sample, from the input that ends as applied and from what was measured.

        A y that is None or not finite corrects nothing. `mode` is the sampled mode; below 0 it is
        not known, and the last one goes on, mode 0 before any was known.
        """
        from deadtime.loop.observer_steps import correct, integrate, measure

        samples, place, before = self.counters
        self.ring[place], self.counters[1] = latest, (place + 1) % len(self.ring)
        if samples:
            self._predict(int(before), int(place))
        mode = int(before) if mode < 0 else mode
        C = self.observer.C[mode]
        y = self._nothing if y is None else y
        gain = self.observer.gain[mode]
        use = correct(C, gain, y, self._x, self._spare, self._innovation)
        self.corrected = use
        if self.tracked is not None:
            measure(C, self.tracked.H, self._x, y, use, self._now)
            if samples and self._q.size:
                push = self.tracked.push[mode]
                integrate(
                    self.observer.step,
                    self.before,
                    self._now,
                    self._r,
                    self.asked,
                    latest,
                    push,
                    self._q,
                )
            self.before[:] = self._now
            self._r[:] = 0.0 if reference is None else reference
        self.counters[0], self.counters[2] = samples + 1, mode
        return self.z

    def _predict(self, mode: int, latest: int) -> None:
        """Take x̂ over the period that ends; its own input is at `latest` in the ring."""
        from deadtime.numerics.exponential import advance

        size = len(self.ring)
        for Phi, Gamma, (_, _, lag) in self._pieces[mode]:
            acting = self.ring[(latest - lag) % size, self._channels]
            advance(Phi, Gamma, self._x, acting, self._spare)
            self._x[:] = self._spare

    def memory(self, reference: Reference | None, samples: int) -> Memory:
        """All of it as arrays, for a run of so many samples."""
        observer, pieces = self.observer, [part for parts in self._pieces for part in parts]
        time, r = np.arange(samples) * observer.step, np.zeros((samples, self._r.size))
        tracked = self.tracked
        if tracked is None:
            tracked = Tracked(np.zeros((0, observer.outputs)), np.zeros((0, 0, 0)), False)
        if reference is not None:
            r = reference.along(time)
        start = np.zeros(self.z.size)
        start[: self._start.size] = self._start
        return Memory(
            read_only(start),
            read_only(np.cumsum([0, *map(len, self._pieces)])),
            read_only(np.stack([Phi for Phi, _, _ in pieces])),
            read_only(np.stack([Gamma for _, Gamma, _ in pieces])),
            read_only(np.stack([stretch.lag for _, _, stretch in pieces])),
            read_only(observer.C),
            read_only(observer.gain),
            read_only(tracked.H),
            read_only(tracked.push),
            read_only(r),
            np.empty(r.shape),
            observer.step,
        )

    def snapshot(self) -> dict[str, Any]:
        """Copies of everything that changes."""
        return {name: getattr(self, name).copy() for name in self.arrays}

    def load(self, saved: dict[str, Any]) -> None:
        """The opposite of `snapshot`."""
        for name in self.arrays:
            getattr(self, name)[...] = saved[name]
