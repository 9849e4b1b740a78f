"""The digital loop of one mode with an observer in it, as a lifted loop of a larger plant.

Before the sample at t_k the loop's state, besides the past inputs, is X = (x, x̄, s): the plant's,
the observer's prediction, and for tracking s = q_{k−1} + h v_{k−1}/2 with v = H C x. Then

    x̂ = x̄ + L (C x − C_o x̄),   q = s + h v/2,   u_k = F (x̂, q) + Σ_j G_j u_{k−j},
    x' = Φ x + …,   x̄' = Φ_o x̂ + …,   s' = s + h v,

the dots being the inputs u_{k−N} and u_{k−N+1}, N and Φ those of the plant and of the observer's
model, which may differ. Where they do in N, the one with fewer inputs on their way is given states
that hold the others.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.feedback import Feedback
from deadtime.output_feedback import OutputFeedback
from deadtime.plant import SwitchedSystem
from deadtime.spectrum.lifted import LiftedLoop
from deadtime.steps import Window


class Period(NamedTuple):
    """x' = Phi x + early u_{k−N} + late u_{k−N+1}, N = `taps`."""

    Phi: Float[np.ndarray, "n n"]
    early: Float[np.ndarray, "n m"]
    late: Float[np.ndarray, "n m"]
    taps: int

    @classmethod
    def of(cls, plant: SwitchedSystem, mode: int, step: float) -> Period:
        """One mode over a period."""
        from deadtime.exponential import held

        window = Window.of_plant(plant, step)
        A, B = plant.A[mode], plant.B[mode]
        Phi, early = held(A, B, window.phase)
        rest, late = held(A, B, step - window.phase)
        return cls(rest @ Phi, rest @ early, late, window.count)

    def reading(self, count: int) -> Period:
        """The same, reading inputs of N = `count` only; older ones are states w after x.

        With w_1 = u_{k−count−1}, …, w_δ = u_{k−count−δ}, δ = N − count > 0.
        """
        extra, (n, m) = self.taps - count, self.early.shape
        if extra <= 0:
            return self
        Phi, early, late = np.zeros((n + extra * m, n + (extra + 2) * m)), None, None
        Phi[:n, :n] = self.Phi
        # Columns: x, w_1 … w_δ, then u_{k−count} and u_{k−count+1}.
        oldest = n + (extra - 1) * m
        Phi[:n, oldest : oldest + m] = self.early
        second = n + (extra - 2) * m if extra > 1 else n + extra * m
        Phi[:n, second : second + m] += self.late
        Phi[n : n + m, n + extra * m : n + (extra + 1) * m] = np.eye(m)
        Phi[n + m :, n : n + (extra - 1) * m] = np.eye((extra - 1) * m)
        square = n + extra * m
        early, late = Phi[:, square : square + m], Phi[:, square + m :]
        return Period(Phi[:, :square], early, late, count)


class Joined(NamedTuple):
    """X' = Phi X + early u_{k−N} + late u_{k−N+1}, u_k = gain X + …, X = (x, x̄, s).

    The first `true` of X are the plant's.
    """

    Phi: Float[np.ndarray, "size size"]
    early: Float[np.ndarray, "size m"]
    late: Float[np.ndarray, "size m"]
    gain: Float[np.ndarray, "m size"]
    true: int

    @classmethod
    def of(cls, law: OutputFeedback, x: Period, x_bar: Period, F: np.ndarray, mode: int) -> Joined:
        """Plant and observer side by side, each with its own inputs, under F of the law inside."""
        h, observer = law.observer.step, law.observer
        assert law.outputs is not None
        C, C_o, L = law.outputs[mode], observer.C[mode], observer.gain[mode]
        H = np.zeros((0, len(C))) if law.servo is None else law.servo.tracked[: law.servo.sums]
        n, n_o, q, m = C.shape[1], C_o.shape[1], len(H), x.early.shape[1]
        a, b = len(x.Phi), len(x_bar.Phi)
        size = a + b + q
        estimate, v = np.zeros((n_o, size)), np.zeros((q, size))
        estimate[:, :n], estimate[:, a : a + n_o] = L @ C, np.eye(n_o) - L @ C_o
        v[:, :n] = H @ C
        q_now = h / 2.0 * v
        q_now[:, a + b :] += np.eye(q)
        Phi = np.zeros((size, size))
        Phi[:a, :a] = x.Phi
        Phi[a : a + b] = x_bar.Phi[:, :n_o] @ estimate
        Phi[a : a + b, a + n_o : a + b] += x_bar.Phi[:, n_o:]
        Phi[a + b :] = h * v
        Phi[a + b :, a + b :] += np.eye(q)
        early, late = np.zeros((2, size, m))
        early[: a + b] = np.vstack((x.early, x_bar.early))
        late[: a + b] = np.vstack((x.late, x_bar.late))
        return cls(Phi, early, late, F[:, :n_o] @ estimate + F[:, n_o : n_o + q] @ q_now, a)


def observed_loop(
    plant: SwitchedSystem, law: OutputFeedback, feedback: Feedback, mode: int, row: int
) -> LiftedLoop:
    """The loop of plant, observer and one row of the table of the law inside, reference 0."""
    h = feedback.step
    true, model = Period.of(plant, mode, h), Period.of(law.observer.plant, mode, h)
    count = min(true.taps, model.taps)
    F = feedback.state_gain[row]
    X = Joined.of(law, true.reading(count), model.reading(count), F, mode)
    return LiftedLoop(X.Phi, X.early, X.late, X.gain, feedback.input_gain[row], count)
