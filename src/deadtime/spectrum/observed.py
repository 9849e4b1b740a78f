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

from deadtime.feedback import Feedback, Law
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.plant.pieces import Period
from deadtime.spectrum.lifted import LiftedLoop


class LawSide(NamedTuple):
    """What observer and law make of what is seen, w = (x̄, s): w' = A w + B y, u = E w + D y.

    Without the inputs that arrive, and without the law's taps.
    """

    A: Float[np.ndarray, "w w"]
    B: Float[np.ndarray, "w seen"]
    E: Float[np.ndarray, "m w"]
    D: Float[np.ndarray, "m seen"]

    @classmethod
    def of(
        cls,
        law: Law,
        C: Float[np.ndarray, "p seen"],
        x_bar: Period,
        F: Float[np.ndarray, "m z"],
        mode: int,
    ) -> LawSide:
        """Under F of the law inside, with C the measurement; the identity for y itself."""
        h, observer = law.observer.step, law.observer
        C_o, L = observer.C[mode], observer.gain[mode]
        H = np.zeros((0, len(C))) if law.servo is None else law.servo.tracked[: law.servo.sums]
        seen, n_o, q = C.shape[1], len(x_bar.Phi), len(H)
        estimate, v = np.zeros((n_o, seen + n_o + q)), np.zeros((q, seen + n_o + q))
        estimate[:, :seen], estimate[:, seen : seen + n_o] = L @ C, np.eye(n_o) - L @ C_o
        v[:, :seen] = H @ C
        q_now = h / 2.0 * v
        q_now[:, seen + n_o :] += np.eye(q)
        after = np.vstack((x_bar.Phi @ estimate, h * v))
        after[n_o:, seen + n_o :] += np.eye(q)
        gain = F[:, :n_o] @ estimate + F[:, n_o : n_o + q] @ q_now
        return cls(after[:, seen:], after[:, :seen], gain[:, seen:], gain[:, :seen])


class Joined(NamedTuple):
    """X' = Phi X + …, u_k = gain X + …, X = (x, x̄, s), its first `true` those of the plant."""

    Phi: Float[np.ndarray, "size size"]
    gain: Float[np.ndarray, "m size"]
    true: int

    @classmethod
    def of(cls, law: Law, x: Period, x_bar: Period, F: np.ndarray, mode: int) -> Joined:
        """Plant and observer side by side, each with its own inputs, under F of the law inside."""
        assert law.outputs is not None
        side, n = LawSide.of(law, law.outputs[mode], x_bar, F, mode), len(x.Phi)
        Phi = np.zeros((n + len(side.A), n + len(side.A)))
        Phi[:n, :n] = x.Phi
        Phi[n:, :n], Phi[n:, n:] = side.B, side.A
        return cls(Phi, np.hstack((side.D, side.E)), n)

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


def periods_of(plant: SwitchedSystem, law: Law, mode: int) -> tuple[Period, Period]:
    """A period of the plant, and of the observer's model of it."""
    step, model = law.observer.step, law.observer.plant
    return SampledPlant(plant, step).period(mode), SampledPlant(model, step).period(mode)


def observed_loop(
    plant: SwitchedSystem, law: Law, feedback: Feedback, mode: int, row: int
) -> LiftedLoop:
    """The loop of plant, observer and one row of the table of the law inside, reference 0."""
    x, x_bar = periods_of(plant, law, mode)
    X = Joined.of(law, x, x_bar, feedback.state_gain[row], mode)
    return LiftedLoop(X.arrivals(x, x_bar), X.gain, feedback.input_gain[row])
