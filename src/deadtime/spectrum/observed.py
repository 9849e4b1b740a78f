"""The digital loop of one mode with an observer in it, as a lifted loop of a larger plant.

Before the sample at t_k the loop's state, besides the past inputs, is X = (x, x̄, s): the plant's,
the observer's prediction, and for tracking s = q_{k−1} + h v_{k−1}/2 with v = H C x. Then

    x̂ = x̄ + L (C x − C_o x̄),   q = s + h v/2,   u_k = F (x̂, q) + Σ_j G_j u_{k−j},
    x' = Φ x + …,   x̄' = Φ_o x̂ + …,   s' = s + h v,

the dots being the inputs that arrive, with the lags of the plant and of the observer's model,
which may differ.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.estimation import OutputFeedback
from deadtime.feedback import Feedback
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.plant.pieces import Period
from deadtime.spectrum.lifted import LiftedLoop


class Joined(NamedTuple):
    """X' = Phi X + …, u_k = gain X + …, X = (x, x̄, s), its first `true` those of the plant."""

    Phi: Float[np.ndarray, "size size"]
    gain: Float[np.ndarray, "m size"]
    true: int

    @classmethod
    def of(cls, law: OutputFeedback, x: Period, x_bar: Period, F: np.ndarray, mode: int) -> Joined:
        """Plant and observer side by side, each with its own inputs, under F of the law inside."""
        h, observer = law.observer.step, law.observer
        assert law.outputs is not None
        C, C_o, L = law.outputs[mode], observer.C[mode], observer.gain[mode]
        H = np.zeros((0, len(C))) if law.servo is None else law.servo.tracked[: law.servo.sums]
        n, n_o, q = len(x.Phi), len(x_bar.Phi), len(H)
        size = n + n_o + q
        estimate, v = np.zeros((n_o, size)), np.zeros((q, size))
        estimate[:, :n], estimate[:, n : n + n_o] = L @ C, np.eye(n_o) - L @ C_o
        v[:, :n] = H @ C
        q_now = h / 2.0 * v
        q_now[:, n + n_o :] += np.eye(q)
        Phi = np.zeros((size, size))
        Phi[:n, :n] = x.Phi
        Phi[n : n + n_o] = x_bar.Phi @ estimate
        Phi[n + n_o :] = h * v
        Phi[n + n_o :, n + n_o :] += np.eye(q)
        return cls(Phi, F[:, :n_o] @ estimate + F[:, n_o : n_o + q] @ q_now, n)

    def arrivals(self, x: Period, x_bar: Period) -> Period:
        """The same with its inputs: those of the plant and of the observer's model, lag by lag."""
        n, m = x.Gamma.shape[1:]
        rows = {"plant": slice(0, n), "model": slice(n, n + x_bar.Gamma.shape[1])}
        lags = tuple(sorted({*x.lags, *x_bar.lags}, reverse=True))
        Gamma = np.zeros((len(lags), len(self.Phi), m))
        for name, period in (("plant", x), ("model", x_bar)):
            for lag, part in zip(period.lags, period.Gamma, strict=True):
                Gamma[lags.index(lag), rows[name]] = part
        return Period(self.Phi, Gamma, lags)


def periods_of(plant: SwitchedSystem, law: OutputFeedback, mode: int) -> tuple[Period, Period]:
    """A period of the plant, and of the observer's model of it."""
    step, model = law.observer.step, law.observer.plant
    return SampledPlant(plant, step).period(mode), SampledPlant(model, step).period(mode)


def observed_loop(
    plant: SwitchedSystem, law: OutputFeedback, feedback: Feedback, mode: int, row: int
) -> LiftedLoop:
    """The loop of plant, observer and one row of the table of the law inside, reference 0."""
    x, x_bar = periods_of(plant, law, mode)
    X = Joined.of(law, x, x_bar, feedback.state_gain[row], mode)
    return LiftedLoop(X.arrivals(x, x_bar), X.gain, feedback.input_gain[row])
