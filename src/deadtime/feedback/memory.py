"""The state that a law keeps between samples, as a table for compiled loops.

Beside its `Feedback`, such a law has a state z = (x̂, q, r), by which its rows are multiplied: an
estimate, sums of errors, and a reference. In mode i, from the past inputs u that the law has and
a measurement y,

    x̄_k = Φ_j x̂_{k−1} + Σ_l Γ_jl u_{k−1−l},    j the mode of the sample before,
    x̂_k = x̄_k + L_i (y_k − C_i x̄_k),   or x̄_k where y_k is missing,
    q_k = q_{k−1} + h (v_{k−1} + v_k)/2 − h r_{k−1},   v = H y,

where the sum stops while it would drive a saturated input further beyond its limit
(`loop/observer_steps.py`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.feedback.belief import BankForm, Belief
from deadtime.feedback.preview import Preview
from deadtime.feedback.table import Feedback


class MemorySizes(NamedTuple):
    """Of a `Memory`: estimates, outputs, sums of errors, tracked outputs, inputs and lags."""

    n: int
    p: int
    q: int
    r: int
    m: int
    lags: int


class Memory(NamedTuple):
    """How z moves: data that no run changes.

    matrices : (modes, size), of each mode Φ (n, n), Γ (lags, n, m), C (p, n), L (n, p) and `push`
        (m, q), how the input answers q, one after the other
    lag : (lags,), of the inputs that reach the model over a period, the oldest first
    sizes : MemorySizes, or in batches the same as constants of compiled code
    start : (z,), z before the first measurement
    tracked : (r, p), H
    reference : (samples, r)
    step : float, h in seconds
    """

    matrices: Float[np.ndarray, "mode size"]
    lag: Int[np.ndarray, " lag"]
    sizes: MemorySizes
    start: Float[np.ndarray, " z"]
    tracked: Float[np.ndarray, "r p"]
    reference: Float[np.ndarray, "sample r"]
    step: float

    def _part(self, place: int) -> np.ndarray:
        n, p, q, _, m, lags = self.sizes
        shapes = (n, n), (lags, n, m), (p, n), (n, p), (m, q)
        ends = np.cumsum([0, *map(math.prod, shapes)])
        part = self.matrices[:, ends[place] : ends[place + 1]]
        return part.reshape(len(part), *shapes[place])

    @property
    def Phi(self) -> Float[np.ndarray, "mode n n"]:
        return self._part(0)

    @property
    def Gamma(self) -> Float[np.ndarray, "mode lag n m"]:
        return self._part(1)

    @property
    def C(self) -> Float[np.ndarray, "mode p n"]:
        return self._part(2)

    @property
    def gain(self) -> Float[np.ndarray, "mode n p"]:
        return self._part(3)

    @property
    def push(self) -> Float[np.ndarray, "mode m q"]:
        return self._part(4)

    @property
    def reads_mode(self) -> bool:
        """Whether how z moves depends on the mode."""
        return bool((self.matrices != self.matrices[:1]).any())


class Tables(NamedTuple):
    """A law as tables: its rows, and the state that they act on where that is not x or y.

    A law that knows the signal has a preview in place of rows; one with a belief weights its rows
    by it in place of selecting one by the mode. With a bank around it the belief is one from
    outputs, and the law is a table in batches and controllers alone.
    """

    feedback: Feedback | None
    memory: Memory | None = None
    preview: Preview | None = None
    belief: Belief | None = None
    bank: BankForm | None = None
