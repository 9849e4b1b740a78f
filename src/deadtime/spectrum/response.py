"""A loop at the limit of stability: its characteristic matrix at a frequency and a true delay.

A root z = e^{iωh} of the digital loop makes

    Δ(ω, D) = [[zI − Φ, −p], [−F, M]]    singular,    M = I − Σ_j G_j z^{−j},

where p, the plant's delay line, is the only part that knows the true delay D = (N − 1) h + φ; the
law keeps its table:

    p = z^{−N} (Γ_early + z Γ_late),    ∂p/∂D = z^{−N} (1 − z) e^{A(h − φ)} B.

For a root s = iω of the ideal loop Φ, z and the sum are A, iω and W(iω), and p = e^{−iωD} B. Where
the plant has no eigenvalue at z, det Δ = det(zI − Φ) det(M − r p) with r = F (zI − Φ)⁻¹.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.numerics.small_matrices import inverses, traces


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


class Response(ABC):
    """A loop in one mode as a function of frequency and true delay.

    Attributes
    ----------
    F : (m, n)
        The law's gain on the state.
    memory : float
        How far back the law looks, seconds.
    highest : float
        No root lies above this frequency, rad/s, whatever the true delay.
    """

    F: Float[np.ndarray, "m n"]

    @property
    @abstractmethod
    def memory(self) -> float: ...

    @property
    @abstractmethod
    def highest(self) -> float: ...

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

    def samples(self, omega: np.ndarray, even: bool = False) -> Samples:
        """All but the delay line, at the `even_law`'s frequencies or at any others."""
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
