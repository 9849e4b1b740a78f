"""The state that a controller keeps between samples: its observer, or its mode belief."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import as_floats, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.controller.past_inputs import DensePast
from deadtime.estimation.servo import Reference
from deadtime.feedback import Feedback
from deadtime.feedback.belief import BeliefForm
from deadtime.feedback.memory import Memory
from deadtime.loop.running_belief import running_belief
from deadtime.loop.running_observer import RunningObserver


class Observing:
    """A running observer and its reference.

    Attributes
    ----------
    reference : Reference or None
        The law's own.
    reads_mode : bool
        Whether it depends on the mode.
    """

    def __init__(self, memory: Memory, reference: Reference | None) -> None:
        self._running = RunningObserver(memory)
        self.reference, self._step = reference, memory.step
        self._r = np.zeros(reference.size if reference else 0)
        self.reads_mode = self.memory.reads_mode

    def begin(self, history: Float[np.ndarray, "N m"]) -> None:
        """Start after these inputs, oldest first."""
        self._running.begin(history)
        if self.reference:
            self._r[:] = self.reference(0.0)

    def update(
        self,
        latest: Float[np.ndarray, " m"],
        y: Float[np.ndarray, " p"],
        mode: int,
        reference: ArrayLike | None,
        samples: int,
    ) -> tuple[Float[np.ndarray, " z"], bool, bool]:
        """The vector for the law, whether y was unusable, and whether the reference was unusable.

        A mode below 0 is unknown: an observer that depends on it then predicts without y.
        """
        bad_reference = self._take_reference(reference, samples)
        unknown = mode < 0 and self.reads_mode
        z = self._running.update(latest, None if unknown else y, mode, self._r)
        return z, not self._running.corrected, bad_reference

    def _take_reference(self, reference: ArrayLike | None, samples: int) -> bool:
        """Take a finite reference, None for the law's own; return whether it is refused."""
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

    def set_command(self, u: Float[np.ndarray, " m"]) -> None:
        """Store the law's command, to which anti-windup compares the applied input."""
        self._running.asked[:] = u

    @property
    def memory(self) -> Memory:
        """The observer as data; of the reference it has the first sample only."""
        return self._running.memory

    @property
    def tracked(self) -> int:
        """Size of the reference."""
        return self._r.size

    @property
    def z(self) -> Float[np.ndarray, " z"]:
        """The vector that the law's rows multiply, at the last sample; a view that changes."""
        return self._running.z

    def snapshot(self) -> dict[str, Any]:
        """Copies of the state."""
        own = {f"observer_{name}": value for name, value in self._running.snapshot().items()}
        return {**own, "reference": self._r.copy()}

    def load(self, saved: dict[str, Any]) -> None:
        """Restore a `snapshot`."""
        own = {name: saved[f"observer_{name}"] for name in self._running.arrays}
        self._running.load(own)
        self._r[:] = saved["reference"]


class ModeBelief:
    """A running mode filter on the applied inputs, and its weights of the rows of a table.

    Attributes
    ----------
    running : deadtime.loop.running_belief.RunningBelief
    form, bank : Belief, BankForm or None
        The filter as data; `bank` where it receives outputs.
    """

    def __init__(self, form: BeliefForm, table: Feedback) -> None:
        self.running = running_belief(form, len(table.state_gain))
        self._gains, (_, m, n) = table.state_gain, table.state_gain.shape
        self.form, self.bank = self.running.form, self.running.bank
        # In period k the model reads u_{k−N}, so at sample k + 1 one input more than a law does.
        self._count = int(self.running.form.lag.max()) + 1
        self._ring = np.zeros((2 * self._count, m))
        self._place, self._zero = np.zeros(3, np.int64), np.zeros(n)

    def begin(self) -> None:
        """Start; earlier inputs are pushed afterwards."""
        self.running.begin()
        self._ring[:], self._place[:] = 0.0, 0

    def push(self, u: Float[np.ndarray, " m"]) -> None:
        """Add an applied input."""
        from deadtime.controller.past_input_sums import push

        push(u, self._place, self._ring)

    @property
    def inputs(self) -> Float[np.ndarray, "lag m"]:
        """The last inputs as applied, the oldest first; a view that changes."""
        return self._ring[self._place[0] :][: self._count]

    def update(self, x: Float[np.ndarray, " n_or_p"]) -> None:
        """Update the belief at a sample; numbers that are not finite are missing."""
        self.running.see(x, self._ring, int(self._place[0]) + self._count - 1)

    def command(self, past: DensePast, x: np.ndarray, u: Float[np.ndarray, " m"]) -> None:
        """Write into u the mean of the rows' commands by their weights."""
        running, share = self.running, self.running.share()
        if self.bank is None:
            past.mean(share, x, u)
            return
        past.mean(share, self._zero, u)
        running.add_states(self._gains, u)

    def known(self, rows: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The weight of every row, the state that it multiplies, and its covariance."""
        running = self.running
        return running.share().copy(), running.states(rows), running.covariances(rows)

    def snapshot(self) -> dict[str, Any]:
        """Copies of the state."""
        own = {"belief_inputs": self._ring.copy(), "belief_place": self._place.copy()}
        return self.running.snapshot() | own

    def load(self, saved: dict[str, Any], begun: bool) -> None:
        """Restore a `snapshot`; `ArgumentError` if its belief is not one."""
        self.running.load(saved)
        self.running.begun = begun
        self._ring[:], self._place[:] = saved["belief_inputs"], saved["belief_place"]
