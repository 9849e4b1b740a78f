"""What a law remembers from sample to sample, as a table for compiled loops.

Beside its `Feedback`, such a law has a state z = (x̂, q, r) that its rows are multiplied with: an
estimate, sums of errors, and a reference. In mode i, from the past inputs u that the law has and
a measurement y,

    x̄_k = Φ_j x̂_{k−1} + Σ Γ_j u,       j the mode of the sample before,
    x̂_k = x̄_k + L_i (y_k − C_i x̄_k),   or x̄_k where y_k is missing,
    q_k = q_{k−1} + h (v_{k−1} + v_k)/2 − h r_{k−1},   v = H y,

the sum stopping where it asks for more of what an input was refused
(`loop/observer_steps.py`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.errors import ArgumentError
from deadtime.feedback.bank import BankForm
from deadtime.feedback.belief import Belief
from deadtime.feedback.law import Law, TableLaw
from deadtime.feedback.preview import Foresight
from deadtime.feedback.table import Feedback
from deadtime.switching import SwitchingSignal


class Memory(NamedTuple):
    """How z moves.

    start : (z,), z before the first measurement
    first : (modes + 1,), the pieces of mode i are first[i], …, first[i + 1] − 1
    Phi : (pieces, n, n), Gamma : (pieces, n, m), lag : (pieces, m), as in a `PieceTable`
    C : (modes, p, n), gain : (modes, n, p)
    tracked : (r, p), H; push : (modes, m, q), how the input answers q
    reference : (samples, r); value : (samples, r), v, which a run fills
    step : float, h in seconds
    """

    start: Float[np.ndarray, " z"]
    first: Int[np.ndarray, " mode+1"]
    Phi: Float[np.ndarray, "piece n n"]
    Gamma: Float[np.ndarray, "piece n m"]
    lag: Int[np.ndarray, "piece m"]
    C: Float[np.ndarray, "mode p n"]
    gain: Float[np.ndarray, "mode n p"]
    tracked: Float[np.ndarray, "r p"]
    push: Float[np.ndarray, "mode m q"]
    reference: Float[np.ndarray, "sample r"]
    value: Float[np.ndarray, "sample r"]
    step: float

    @property
    def reads_mode(self) -> bool:
        """Whether how z moves depends on the mode."""
        counts = np.diff(self.first)
        if (counts != counts[0]).any():
            return True
        each = [part.reshape(counts.size, -1) for part in (self.Phi, self.Gamma, self.lag)]
        each += [self.C, self.gain, self.push]
        return any(bool((part != part[:1]).any()) for part in each)


class Tables(NamedTuple):
    """A law as tables: its rows, and what they are multiplied with where that is not x or y.

    A law that knows the signal has a foresight in place of rows; one with a belief weighs its rows
    by that in place of choosing one by the mode. One with a bank does so on outputs, and is a table
    in batches alone.
    """

    feedback: Feedback | None
    memory: Memory | None = None
    foresight: Foresight | None = None
    belief: Belief | None = None
    bank: BankForm | None = None


class WithMemory(ABC):
    """A base beside `Law`, by which compiled loops know a law that is a table of what it keeps."""

    @abstractmethod
    def tables(self, step: float, signal: SwitchingSignal, steps: int) -> Tables | None:
        """Its tables for a run, as `Law.digital` makes them; None where it has none."""

    def beginning_at(self, memory: Float[np.ndarray, " w"]) -> Law:
        """The law with no reference that remembers w before its first sample, as it can be told."""
        raise ArgumentError(
            f"law must remember what can be set for it, as `OutputFeedback` does, got {self!r}."
        )


def tables_of(law: Law, step: float, signal: SwitchingSignal, steps: int) -> Tables | None:
    """A law's tables for a run along a signal; None of a law that must be called."""
    if isinstance(law, TableLaw):
        foresight = law.foresight(step, signal, steps)
        feedback = None if foresight else law.digital(step, signal, steps)
        return Tables(feedback, foresight=foresight)
    return law.tables(step, signal, steps) if isinstance(law, WithMemory) else None
