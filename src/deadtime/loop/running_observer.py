"""An observer that runs, one sample per call, in laws and controllers."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from deadtime.feedback.memory import Memory
from deadtime.loop.observer_steps import (
    ObserverState,
    begin_observer,
    correct_observer,
    predict_observer,
)


class RunningObserver:
    """A `Memory` that runs; `begin`, then `update` once a period.

    Attributes
    ----------
    memory : Memory
    state : ObserverState
        `state.z` is the vector that the law's rows multiply, as of the last update; the caller
        writes the law's command into `state.asked`.
    """

    # The state: z; the ring of inputs; the numbers of samples, place in the ring and mode; the last
    # command; the tracked outputs before.
    arrays: ClassVar = ("z", "ring", "counters", "asked", "before")

    def __init__(self, memory: Memory) -> None:
        self.memory, self.state = memory, ObserverState.of(memory)
        _, p, _, r, m, _ = memory.sizes
        self.ring = np.zeros((int(memory.lag.max()) + 1, m))
        self.counters, self._known = np.zeros(3, np.int64), np.full(1, -1)
        self._nothing, self._none = np.full(p, np.nan), np.zeros(r)

    @property
    def z(self) -> Float[np.ndarray, " z"]:
        return self.state.z

    @property
    def asked(self) -> Float[np.ndarray, " m"]:
        return self.state.asked

    @property
    def before(self) -> Float[np.ndarray, " r"]:
        """Tracked outputs of the last sample."""
        return self.state.value[1]

    @property
    def corrected(self) -> bool:
        """Whether the last update had a finite measurement."""
        return bool(self.state.used[0])

    def begin(self, history: Float[np.ndarray, "past m"]) -> None:
        """Start again; `history` are at least N inputs before, oldest first."""
        for name in self.arrays:
            getattr(self, name)[...] = 0
        begin_observer.function(self.memory, self.state)
        # Row 0 is written by the first update, with the last input of the history, and row 1 by the
        # second: no lag reaches either before.
        self.ring[2:] = history[len(history) + 1 - len(self.ring) : -1]
        self.asked[:] = history[-1]

    def update(
        self,
        latest: Float[np.ndarray, " m"],
        y: Float[np.ndarray, " p"] | None,
        mode: int,
        reference: Float[np.ndarray, " r"] | None = None,
    ) -> Float[np.ndarray, " z"]:
        """z at this sample, from the input applied in the period that ended and from y.

        A y that is None or not finite corrects nothing. `mode` is the sampled mode; below 0 it is
        not known, and the last known one continues, mode 0 before any.
        """
        samples, place, before = self.counters.tolist()
        self.ring[place], self.counters[1] = latest, (place + 1) % len(self.ring)
        if samples:
            # The period that ended was spent in the mode at its begin, not in the one at its end.
            self._select(before)
            predict_observer(self.memory, self.state, self.ring, place)
        mode = before if mode < 0 else mode
        self._select(mode)
        y = self._nothing if y is None else y
        r = self._none if reference is None else reference
        correct_observer(self.memory, self.state, y, self.ring[place], r, samples)
        self.counters[0], self.counters[2] = samples + 1, mode
        return self.z

    def _select(self, mode: int) -> None:
        if self._known[0] != mode:
            self.state.own[:], self._known[0] = self.memory.matrices[mode], mode

    def snapshot(self) -> dict[str, Any]:
        """Copies of the state."""
        return {name: getattr(self, name).copy() for name in self.arrays}

    def load(self, saved: dict[str, Any]) -> None:
        """Restore a `snapshot`."""
        for name in self.arrays:
            getattr(self, name)[...] = saved[name]
