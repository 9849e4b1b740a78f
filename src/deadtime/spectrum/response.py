"""A loop at the limit of stability: its characteristic matrix at a frequency and a true delay.

A root z = e^{iωh} of the digital loop makes

    Δ(ω, D) = [[zI − Φ, −p], [−F, M]]    singular,    M = I − Σ_j G_j z^{−j},

where p, the plant's delay line, is the only part that knows the true delay D = (N − 1) h + φ; the
law keeps its table:

    p = z^{−N} (Γ_early + z Γ_late),    ∂p/∂D = z^{−N} (1 − z) e^{A(h − φ)} B.

For a root s = iω of the ideal loop Φ, z and the sum are A, iω and W(iω), and p = e^{−iωD} B. Where
the plant has no eigenvalue at z, det Δ = det(zI − Φ) det(M − r p) with r = F (zI − Φ)⁻¹.

Where inputs have delays of their own, the delay that is varied is the shortest of them; the others
are longer by as much as ever, and each has its own column of p.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.numerics.small_matrices import inverses, traces
from deadtime.plant import SwitchedSystem


class Samples(NamedTuple):
    """What does not depend on the true delay, at frequencies ω (points,), slopes by ω.

    plant : tr((zI − Φ)⁻¹ dz/dω);  M, M_slope : (points, m, m);  r, r_slope : (points, m, n)
    """

    omega: np.ndarray
    plant: np.ndarray
    M: np.ndarray
    M_slope: np.ndarray
    r: np.ndarray
    r_slope: np.ndarray

    def repeat(self, times: int) -> Samples:
        """The same frequencies again and again."""
        return Samples(*(np.concatenate([part] * times) for part in self))


class Response(ABC):
    """A loop in one mode as a function of frequency and true delay: what margins read.

    Attributes
    ----------
    memory : float
        How far back the loop looks but for the delay that is varied, seconds.
    highest : float
        No root lies above this frequency, rad/s, whatever the true delay.
    """

    @property
    @abstractmethod
    def memory(self) -> float: ...

    @property
    @abstractmethod
    def highest(self) -> float: ...

    @abstractmethod
    def samples(self, omega: np.ndarray, even: bool = False) -> Samples:
        """All but the delay line, at any frequencies; `even`: at (k + ½)/count · highest."""

    @abstractmethod
    def delay_line(
        self, omega: np.ndarray, delay: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """p and its slopes by ω and by the delay, (points, n, m), a delay for each ω or for all."""

    @property
    @abstractmethod
    def cuts(self) -> Float[np.ndarray, " cut"]:
        """Delays that stand for all, but for what e^{−iωD} turns, seconds."""

    @property
    @abstractmethod
    def period(self) -> float | None:
        """The sampling period, in seconds; None for the ideal loop."""


class LoopResponse(Response):
    """The response of a loop all of whose delays are varied together.

    Attributes
    ----------
    F : (m, n)
        The law's gain on the state.
    offsets : (m,)
        By how much the delay of each input is longer than the one that is varied, seconds, ≥ 0.
    """

    F: Float[np.ndarray, "m n"]
    offsets: Float[np.ndarray, " m"]

    @property
    @abstractmethod
    def taps(self) -> float:
        """How far back the law looks, seconds."""

    @property
    def memory(self) -> float:
        return self.taps + float(self.offsets.max())

    @abstractmethod
    def free(self, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """zI − Φ and its slope by ω, (points, n, n)."""

    @abstractmethod
    def law(self, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """M and its slope by ω, (points, m, m)."""

    @abstractmethod
    def even_law(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """The same at the frequencies (k + ½)/count · highest, all at once."""

    @abstractmethod
    def arriving(
        self, inputs: slice | np.ndarray, omega: np.ndarray, delay: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The columns of p of some inputs, all of one true delay, and their slopes."""

    def delay_line(
        self, omega: np.ndarray, delay: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        different = np.unique(self.offsets)
        if different.size == 1:
            return self.arriving(slice(None), omega, delay + different[0])
        groups = [np.flatnonzero(self.offsets == offset) for offset in different]
        each = [
            self.arriving(inputs, omega, delay + offset)
            for inputs, offset in zip(groups, different, strict=True)
        ]
        place = np.argsort(np.concatenate(groups))
        p, slope, speed = (
            np.concatenate(part, axis=2)[:, :, place] for part in zip(*each, strict=True)
        )
        return p, slope, speed

    def samples(self, omega: np.ndarray, even: bool = False) -> Samples:
        free, slope = self.free(omega)
        M, M_slope = self.even_law(omega.size) if even else self.law(omega)
        resolvent = inverses(free)
        r = self.F @ resolvent
        plant = traces(resolvent, slope)
        return Samples(omega, plant, M, M_slope, r, -(r @ slope @ resolvent))

    def matrix(
        self, omega: np.ndarray, delay: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Δ and its slopes by ω and by the delay, a delay for each frequency."""
        m, n = self.F.shape
        p, p_slope, p_speed = self.delay_line(omega, delay)
        Delta, slope, speed = np.zeros((3, omega.size, n + m, n + m), complex)
        Delta[:, :n, :n], slope[:, :n, :n] = self.free(omega)
        Delta[:, n:, n:], slope[:, n:, n:] = self.law(omega)
        Delta[:, n:, :n] = -self.F
        Delta[:, :n, n:], slope[:, :n, n:], speed[:, :n, n:] = -p, -p_slope, -p_speed
        return Delta, slope, speed


def offsets_of(plant: SwitchedSystem, mode: int) -> Float[np.ndarray, " m"]:
    """By how much the delays of a mode are longer than the plant's shortest, seconds."""
    return plant.delays[mode] - plant.shortest_delay
