"""A loop with an observer in it at the limit of stability; see `deadtime.spectrum.observed`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deadtime.feedback import Feedback, Law
from deadtime.plant import SwitchedSystem
from deadtime.plant.pieces import Period
from deadtime.spectrum.digital_response import DigitalResponse
from deadtime.spectrum.input_units import in_units, units_of
from deadtime.spectrum.lifted import aged_row
from deadtime.spectrum.observed import Joined, periods_of
from deadtime.spectrum.response import Samples, offsets_of
from deadtime.switching import SwitchingSignal


@dataclass(frozen=True, eq=False)
class ObservedResponse(DigitalResponse):
    """A loop with an observer in it: only the plant's own delay line knows the true delay.

    Φ and F are those of X. The observer's delay line p_o is fed by the same inputs, so that in
    det Δ = det(zI − Φ) det(M − r p) it belongs to the law, M = I − G(z) − r_o p_o.

    Attributes
    ----------
    model : Period
        Of the observer's model: its inputs are p_o's.
    true : int
        How many of X are the plant's.
    """

    model: Period
    true: int

    @classmethod
    def beside(
        cls, plant: SwitchedSystem, law: Law, feedback: Feedback, mode: int
    ) -> ObservedResponse:
        """The loop with one mode held."""
        row, (x, x_bar) = aged_row(feedback, mode), periods_of(plant, law, mode)
        F, G = feedback.state_gain[row], feedback.input_gain[row]
        X = Joined.of(law, x, x_bar, F, mode)
        A, B, count = plant.A[mode], plant.B[mode], len(x_bar.lags)
        effect, gain, G = in_units(units_of(B), np.vstack((B, *x_bar.Gamma)), X.gain, G)
        B, Gamma = effect[: len(B)], effect[len(B) :].reshape(count, -1, B.shape[1])
        model = x_bar._replace(Gamma=Gamma)
        offsets = offsets_of(plant, mode)
        return cls(A, B, gain, G, feedback.step, X.Phi, offsets, model, X.true)

    def free(self, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        z = np.exp(1j * omega * self.step)[:, None, None] * np.eye(len(self.Phi))
        return z - self.Phi, 1j * self.step * z

    def _observer_delay_line(self, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """p_o and its slope by ω, (points, size − n, m)."""
        n_o, m = self.model.Gamma.shape[1:]
        p, slope = np.zeros((2, omega.size, len(self.Phi) - self.true, m), complex)
        for lag, Gamma in zip(self.model.lags, self.model.Gamma, strict=True):
            arriving = np.exp(-1j * omega * self.step * lag)[:, None, None] * Gamma
            p[:, :n_o] += arriving
            slope[:, :n_o] += -1j * self.step * lag * arriving
        return p, slope

    def samples(self, omega: np.ndarray, even: bool = False) -> Samples:
        whole, n = super().samples(omega, even), self.true
        p, slope = self._observer_delay_line(omega)
        r, r_slope = whole.r[:, :, n:], whole.r_slope[:, :, n:]
        return whole._replace(
            M=whole.M - r @ p,
            M_slope=whole.M_slope - r_slope @ p - r @ slope,
            r=whole.r[:, :, :n],
            r_slope=whole.r_slope[:, :, :n],
        )

    def matrix(
        self, omega: np.ndarray, delay: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        m, size = self.F.shape
        n, (p_o, p_o_slope) = self.true, self._observer_delay_line(omega)
        p, p_slope, p_speed = self.delay_line(omega, delay)
        Delta, slope, speed = np.zeros((3, omega.size, size + m, size + m), complex)
        Delta[:, :size, :size], slope[:, :size, :size] = self.free(omega)
        Delta[:, size:, size:], slope[:, size:, size:] = self.law(omega)
        Delta[:, size:, :size] = -self.F
        Delta[:, :n, size:], slope[:, :n, size:], speed[:, :n, size:] = -p, -p_slope, -p_speed
        Delta[:, n:size, size:], slope[:, n:size, size:] = -p_o, -p_o_slope
        return Delta, slope, speed


def digital_response(plant: SwitchedSystem, law: Law, mode: int, step: float) -> DigitalResponse:
    """The loop of any linear law with one mode held."""
    signal = SwitchingSignal.constant(mode)
    if law.observer is None:
        return DigitalResponse.of(plant, law.digital(step, signal, 1), mode)
    law.require_step(step)
    return ObservedResponse.beside(plant, law, law.inner.digital(step, signal, 1), mode)
