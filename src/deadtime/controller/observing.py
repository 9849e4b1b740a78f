"""The observer of a controller whose law measures outputs."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import as_floats, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.estimation.reference import Reference
from deadtime.feedback.memory import Memory
from deadtime.loop.running_observer import RunningObserver


class Observing:
    """An observer that runs, and the reference that goes with it.

    Attributes
    ----------
    reference : Reference or None
        The law's own.
    reads_mode : bool
        Whether what it does depends on the mode.
    """

    def __init__(self, memory: Memory, reference: Reference | None) -> None:
        self._running = RunningObserver(memory)
        self.reference, self._step = reference, memory.step
        self._r = np.zeros(reference.size if reference else 0)
        self.reads_mode = self.memory.reads_mode

    def begin(self, history: Float[np.ndarray, "N m"]) -> None:
        """Start anew after these inputs, the oldest first."""
        self._running.begin(history)
        if self.reference:
            self._r[:] = self.reference(0.0)

    def see(
        self,
        latest: Float[np.ndarray, " m"],
        y: Float[np.ndarray, " p"],
        mode: int,
        reference: ArrayLike | None,
        samples: int,
    ) -> tuple[Float[np.ndarray, " z"], bool, bool]:
        """What the law is given; whether y was of no use, and whether the reference was unusable.

        A mode below 0 is not known: then y corrects nothing, if what it would depends on the mode.
        """
        astray = self._follow(reference, samples)
        unknown = mode < 0 and self.reads_mode
        z = self._running.update(latest, None if unknown else y, mode, self._r)
        return z, not self._running.corrected, astray

    def _follow(self, reference: ArrayLike | None, samples: int) -> bool:
        if self.reference is None:
            return False
        if reference is None:
            self._r[:] = self.reference(samples * self._step)
            return False
        r = self.require(reference)
        if not np.isfinite(r).all():
            return True
        self._r[:] = r
        return False

    def require(self, reference: ArrayLike) -> Float[np.ndarray, " r"]:
        """A reference of the right shape; its entries need not be finite."""
        if self.reference is None:
            raise ArgumentError("reference needs a law with a servo; this one tracks nothing.")
        r = as_floats("reference", reference, f"shape {self._r.shape}")
        return require_shape("reference", r, self._r.shape, "(tracked,)")

    def note(self, asked: Float[np.ndarray, " m"]) -> None:
        """What the law asked for, to be compared with what is applied."""
        self._running.asked[:] = asked

    @property
    def memory(self) -> Memory:
        """The observer as data, with the reference of the first sample alone."""
        return self._running.memory

    @property
    def tracked(self) -> int:
        """Size of the reference."""
        return self._r.size

    @property
    def z(self) -> Float[np.ndarray, " z"]:
        """What the law was given last; a view that changes."""
        return self._running.z

    def snapshot(self) -> dict[str, Any]:
        """Copies of everything that changes."""
        own = {f"observer_{name}": value for name, value in self._running.snapshot().items()}
        return {**own, "reference": self._r.copy()}

    def load(self, saved: dict[str, Any]) -> None:
        """The opposite of `snapshot`."""
        own = {name: saved[f"observer_{name}"] for name in self._running.arrays}
        self._running.load(own)
        self._r[:] = saved["reference"]
