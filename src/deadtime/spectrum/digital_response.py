"""The digital loop at the limit of stability, with or without an observer."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import read_only
from deadtime.feedback import Feedback, Law
from deadtime.numerics.exponential import ROUND_OFF, balanced, discretise, discretise_all
from deadtime.plant import SwitchedSystem
from deadtime.plant.discretisation import finite_discretisation
from deadtime.plant.pieces import Period
from deadtime.spectrum.lifted import (
    Joined,
    aged_row,
    held_table,
    in_units,
    periods_of,
    transform,
    units_of,
)
from deadtime.spectrum.response import LoopResponse, Samples, offsets_of

_CUTS = 5  # delays within a period at which the delay line is tried
_SHORT = 2.0  # |A| h up to which a power series is used: larger terms would cancel


@dataclass(frozen=True, eq=False)
class DigitalResponse(LoopResponse):
    """A plant in one mode under a row (F, G) of a table, at the table's period (immutable).

    Inputs are in `units_of` B.
    """

    A: Float[np.ndarray, "n n"]
    B: Float[np.ndarray, "n m"]
    F: Float[np.ndarray, "m size"]
    G: Float[np.ndarray, "tap m m"]
    step: float
    Phi: Float[np.ndarray, "size size"]
    offsets: Float[np.ndarray, " m"]

    @classmethod
    def of(cls, plant: SwitchedSystem, feedback: Feedback, mode: int) -> DigitalResponse:
        """The loop with one mode held."""
        row = aged_row(feedback, mode)
        A, B, h = plant.A[mode], plant.B[mode], feedback.step
        F, G = feedback.state_gain[row], feedback.input_gain[row]
        B, F, G = in_units(units_of(B), B, F, G)
        return cls(A, B, F, G, h, finite_discretisation(A, B, h)[0], offsets_of(plant, mode))

    @property
    def taps(self) -> float:
        return self.G.shape[0] * self.step

    @property
    def highest(self) -> float:
        return np.pi / self.step

    def free(self, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        z = np.exp(1j * omega * self.step)[:, None, None] * np.eye(len(self.Phi))
        return z - self.Phi, 1j * self.step * z

    def law(self, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        g, slope = transform(self.G, np.exp(-1j * omega * self.step))
        return np.eye(g.shape[1]) - g, 1j * self.step * slope

    def even_law(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        taps, m, _ = self.G.shape
        j = np.arange(1, taps + 1)[:, None, None]
        # The half point is turned into the taps; the rest is one transform of 2·count points.
        turned = np.zeros((2, 2 * count, m, m), complex)
        turned[0, 1 : taps + 1] = self.G * np.exp(-0.5j * np.pi * j / count)
        turned[1, 1 : taps + 1] = turned[0, 1 : taps + 1] * (j * self.step)
        g, slope = np.fft.fft(turned, axis=1)[:, :count]
        return np.eye(m) - g, 1j * slope

    def arriving(
        self, inputs: slice | np.ndarray, omega: np.ndarray, delay: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        B = np.ascontiguousarray(self.B[:, inputs])
        count, early, late, last = cut_inputs(self.A, B, self.step, delay)
        z = np.exp(1j * omega * self.step)
        old, new = ((z**-c)[:, None, None] for c in (count, count - 1.0))
        rate = -1j * self.step * count[:, None, None]
        p = old * early + new * late
        return p, rate * p + 1j * self.step * new * late, (old - new) * last

    @property
    def cuts(self) -> Float[np.ndarray, " cut"]:
        return self.step * np.arange(1, _CUTS + 1) / _CUTS

    @property
    def period(self) -> float | None:
        return self.step


def cut_inputs(
    A: Float[np.ndarray, "n n"],
    B: Float[np.ndarray, "n m"],
    step: float,
    delay: Float[np.ndarray, " point"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """N, Γ_early, Γ_late and e^{A(h − φ)} B for each delay, also a little below 0.

    Γ_late = Γ(h − φ) and Γ_early = Γ(h) − Γ(h − φ), whose round-off is no larger than that of p.
    While |A| h is small, Γ(τ) = Σ_k A^k B τ^{k+1}/(k + 1)! has the same terms for all delays.
    """
    # Not snapped to whole periods as a `Window` is: p must be continuous in the delay.
    count = np.maximum(1.0, np.ceil(delay / step))
    rest = count * step - delay
    longest = max(step, float(rest.max(initial=0.0)))
    size = float(balanced(A[None])[1][0]) * longest
    if size > _SHORT:
        late = discretise_all(A[None], B[None], np.zeros(rest.size, np.int64), rest)[1]
    else:
        terms, bound = [B], 1.0
        while bound > ROUND_OFF:
            terms.append(A @ terms[-1] / (len(terms) + 1.0))
            bound *= size / len(terms)
        late, tau = np.zeros((delay.size, *B.shape)), rest[:, None, None]
        for term in reversed(terms):
            late = tau * (late + term)
    return count, _entering(A.tobytes(), B.tobytes(), B.shape, step) - late, late, B + A @ late


@lru_cache(maxsize=64)  # the same for all frequencies and delays of a margin
def _entering(A: bytes, B: bytes, shape: tuple[int, int], step: float) -> np.ndarray:
    """Γ(h)."""
    n = shape[0]
    Phi_and_Gamma = discretise(
        np.frombuffer(A).reshape(n, n), np.frombuffer(B).reshape(shape), step
    )
    return read_only(Phi_and_Gamma[1])


@dataclass(frozen=True, eq=False)
class ObservedResponse(DigitalResponse):
    """A loop with an observer: only the plant's own delay line depends on the true delay.

    Φ and F are those of X. The observer's delay line p_o has the same inputs and a fixed delay, so
    that in det Δ = det(zI − Φ) det(M − r p) it belongs to the law, M = I − G(z) − r_o p_o.

    Attributes
    ----------
    model : Period
        Of the observer's model; its lags and Γ give p_o.
    true : int
        The number of plant states in X.
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
        Delta, slope, speed = super().matrix(omega, delay)
        size, (p_o, p_o_slope) = len(self.Phi), self._observer_delay_line(omega)
        Delta[:, self.true : size, size:] = -p_o
        slope[:, self.true : size, size:] = -p_o_slope
        return Delta, slope, speed


def digital_response(plant: SwitchedSystem, law: Law, mode: int, step: float) -> DigitalResponse:
    if law.observer is None:
        return DigitalResponse.of(plant, held_table(law, mode, step), mode)
    law.require_step(step)
    return ObservedResponse.beside(plant, law, held_table(law, mode, step), mode)
