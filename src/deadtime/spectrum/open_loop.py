"""The plant and the law of a loop with one mode held, as two systems.

At samples the plant maps the inputs v to the outputs y, and the law maps y to the commanded inputs
u,

    x_{k+1} = Φ x_k + Σ_l Γ_l v_{k−l},    y_k = C x_k,
    w_{k+1} = A w_k + B y_k + Σ_l Γʷ_l u_{k−l},    u_k = E w_k + D y_k + Σ_j G_j u_{k−j}:

a law on the state has no w, D = F and C = I; one with an observer has w = (x̄, s)
(`deadtime.spectrum.lifted`). The closed loop has v = u.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from deadtime.feedback import Law
from deadtime.numerics.exponential import balance
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.plant.pieces import Period
from deadtime.spectrum.ideal import IdealLoop
from deadtime.spectrum.lifted import (
    LawSide,
    aged_row,
    held_table,
    input_row,
    periods_of,
    transform,
    with_line,
)


class StateSpace(NamedTuple):
    """z_{k+1} = A z_k + B v_k, y_k = C z_k + D v_k."""

    A: Float[np.ndarray, "z z"]
    B: Float[np.ndarray, "z v"]
    C: Float[np.ndarray, "y z"]
    D: Float[np.ndarray, "y v"]


@dataclass(frozen=True, eq=False)
class OpenLoop:
    """The plant and the law of a loop in one mode (immutable).

    Attributes
    ----------
    C : (p, n)
        The measurement y = C x.
    plant : Period
        Φ, Γ and lags of the plant.
    law : LawSide
        A, B, E and D of w.
    arriving : Period
        Γʷ and their lags; without states if the law has none.
    G : (taps, m, m)
        The law's gains on past inputs, the latest first.
    """

    C: Float[np.ndarray, "p n"]
    plant: Period
    law: LawSide
    arriving: Period
    G: Float[np.ndarray, "tap m m"]

    @classmethod
    def of(cls, plant: SwitchedSystem, law: Law, mode: int, step: float) -> OpenLoop:
        """The loop of any linear law with one mode held."""
        feedback = held_table(law, mode, step)
        row = aged_row(feedback, mode)
        F, G = feedback.state_gain[row], feedback.input_gain[row]
        if law.observer is not None:
            law.require_step(step)
            assert law.outputs is not None
            x, model = periods_of(plant, law, mode)
            C = law.outputs[mode]
            side = LawSide.of(law, np.eye(len(C)), model, F, mode)
            idle = np.zeros((len(model.lags), len(side.A) - model.Gamma.shape[1], len(F)))
            arriving = model._replace(Gamma=np.concatenate((model.Gamma, idle), axis=1))
            return cls(C, x, side, arriving, G)
        n, m = plant.states, plant.inputs
        side = LawSide(np.zeros((0, 0)), np.zeros((0, n)), np.zeros((m, 0)), F)
        nothing = Period(side.A, np.zeros((0, 0, m)), ())
        return cls(np.eye(n), SampledPlant.of(plant, step).period(mode), side, nothing, G)

    def plant_system(self) -> StateSpace:
        """The plant from v to y, z = (x_k, v_{k−1}, …, v_{k−N})."""
        n, m = self.plant.Gamma.shape[1:]
        A, B = with_line(self.plant, n + max(self.plant.lags) * m)
        C = np.hstack((self.C, np.zeros((len(self.C), len(A) - n))))
        return StateSpace(A, B, C, np.zeros((len(self.C), m)))

    def law_system(self) -> StateSpace:
        """The law from y to u, z = (w_k, u_{k−1}, …, u_{k−W})."""
        side, (taps, m, _), w = self.law, self.G.shape, len(self.law.A)
        size = w + max(taps, *self.arriving.lags, 0) * m
        A, B = with_line(self.arriving._replace(Phi=side.A), size)
        C = input_row(side.E, self.G, size)
        # u_k enters the line, and contains D y_k.
        A, into = A + B @ C, B @ side.D
        into[:w] += side.B
        return StateSpace(A, into, C, side.D)

    def responses(
        self, omega: Float[np.ndarray, " point"], step: float
    ) -> tuple[Complex[np.ndarray, "point p m"], Complex[np.ndarray, "point m p"]]:
        """The plant and the law at frequencies, rad/s; the cost does not depend on the delay."""
        z = np.exp(1j * omega * step)
        w, m = len(self.law.A), self.G.shape[1]
        plant = self.C @ _resolvent(z, self.plant.Phi) @ _transform_line(self.plant, z)
        own = self.law.E @ _resolvent(z, self.law.A)
        before = np.eye(m) - transform(self.G, 1.0 / z)[0]
        if w:
            before = before - own @ _transform_line(self.arriving, z)
        return plant, np.linalg.solve(before, self.law.D + own @ self.law.B)


def ideal_responses(
    plant: SwitchedSystem, law: Law, mode: int, omega: Float[np.ndarray, " point"]
) -> tuple[Complex[np.ndarray, "point n m"], Complex[np.ndarray, "point m n"]]:
    """The plant from v to x and the law from x to u, updated continuously, at frequencies.

    (sI − A)⁻¹ B diag(e^{−sD_j}),    (I − W(s))⁻¹ F,    s = iω
    """
    loop, s = IdealLoop.of(plant, law, mode), 1j * omega
    late = np.exp(-s[:, None] * plant.delays[mode])[:, None, :] * plant.B[mode]
    F = loop.F / balance(plant.A[mode])  # whose states are in other units
    before = np.eye(plant.inputs) - loop.memory(s)[0]
    return _resolvent(s, plant.A[mode]) @ late, np.linalg.solve(before, F + 0j)


def _resolvent(
    z: Complex[np.ndarray, " point"], A: Float[np.ndarray, "n n"]
) -> Complex[np.ndarray, "point n n"]:
    """(zI − A)⁻¹."""
    return np.linalg.inv(z[:, None, None] * np.eye(len(A)) - A)


def _transform_line(
    period: Period, z: Complex[np.ndarray, " point"]
) -> Complex[np.ndarray, "point n m"]:
    """Σ_l Γ_l z^{−l}."""
    return np.tensordot(z[:, None] ** -np.array(period.lags, float), period.Gamma, 1)
