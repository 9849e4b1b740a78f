"""A loop at the limit of stability: its characteristic matrix at a frequency and a true delay.

A root z = e^{iωh} of the digital loop makes

    Δ(ω, D) = [[zI − Φ, −p], [−F, M]]    singular,    M = I − Σ_j G_j z^{−j},

where only p, the plant's delay line, depends on the true delay D = (N − 1) h + φ; the law keeps its
table:

    p = z^{−N} (Γ_early + z Γ_late),    ∂p/∂D = z^{−N} (1 − z) e^{A(h − φ)} B.

For a root s = iω of the ideal loop Φ, z and the sum are A, iω and W(iω), and p = e^{−iωD} B. Where
the plant has no eigenvalue at z, det Δ = det(zI − Φ) det(M − r p) with r = F (zI − Φ)⁻¹.

If delays differ between inputs, the shortest is varied; the others keep their difference to it, and
each input has its own column of p.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.feedback import Law
from deadtime.numerics.small_matrices import inverses, traces
from deadtime.plant import SwitchedSystem
from deadtime.spectrum.ideal import IdealLoop


class Samples(NamedTuple):
    """The parts of Δ that do not depend on the true delay, at frequencies ω (points,), slopes by ω.

    plant : tr((zI − Φ)⁻¹ dz/dω);  M, M_slope : (points, m, m);  r, r_slope : (points, m, n)
    """

    omega: np.ndarray
    plant: np.ndarray
    M: np.ndarray
    M_slope: np.ndarray
    r: np.ndarray
    r_slope: np.ndarray

    def repeat(self, times: int) -> Samples:
        return Samples(*(np.concatenate([part] * times) for part in self))


class Response(ABC):
    """A loop in one mode as a function of frequency and true delay, for margins.

    Attributes
    ----------
    memory : float
        The longest time for which an input acts in the loop, less the varied delay, seconds.
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
        """The parts other than the delay line; `even` says that ω is (k + ½)/count · highest."""

    @abstractmethod
    def delay_line(
        self, omega: np.ndarray, delay: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """p and its slopes by ω and by the delay, (points, n, m), a delay for each ω or for all."""

    @property
    @abstractmethod
    def cuts(self) -> Float[np.ndarray, " cut"]:
        """Delays, seconds, at which |λ| is sampled: it does not depend on the whole periods."""

    @property
    @abstractmethod
    def period(self) -> float | None:
        """The sampling period, in seconds; None for the ideal loop."""


class LoopResponse(Response):
    """The response of a loop whose delays are all varied together.

    Attributes
    ----------
    F : (m, n)
        The law's gain on the state.
    offsets : (m,)
        The delay of each input less the one that is varied, seconds, ≥ 0.
    """

    F: Float[np.ndarray, "m n"]
    offsets: Float[np.ndarray, " m"]

    @property
    @abstractmethod
    def taps(self) -> float:
        """The longest time for which the law depends on past inputs, seconds."""

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
        """`law` at the frequencies (k + ½)/count · highest, all at once."""

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
        true = p.shape[1]  # states of an observer have a delay line of their own
        Delta, slope, speed = np.zeros((3, omega.size, n + m, n + m), complex)
        Delta[:, :n, :n], slope[:, :n, :n] = self.free(omega)
        Delta[:, n:, n:], slope[:, n:, n:] = self.law(omega)
        Delta[:, n:, :n] = -self.F
        for part, entries in zip((Delta, slope, speed), (p, p_slope, p_speed), strict=True):
            part[:, :true, n:] = -entries
        return Delta, slope, speed


def offsets_of(plant: SwitchedSystem, mode: int) -> Float[np.ndarray, " m"]:
    """The delays of a mode less the plant's shortest, seconds."""
    return plant.delays[mode] - plant.shortest_delay


@dataclass(frozen=True, eq=False)
class IdealResponse(LoopResponse):
    """A plant in one mode under a law updated continuously (immutable)."""

    loop: IdealLoop
    F: Float[np.ndarray, "m n"]
    radius: float
    offsets: Float[np.ndarray, " m"]

    @classmethod
    def of(cls, plant: SwitchedSystem, law: Law, mode: int) -> IdealResponse:
        """The loop with one mode held."""
        loop = IdealLoop.of(plant, law, mode)
        return cls(loop, loop.F, loop.radius(0.0, any_delay=True), offsets_of(plant, mode))

    @property
    def taps(self) -> float:
        return self.loop.lead

    @property
    def highest(self) -> float:
        return self.radius

    def free(self, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        unit = np.eye(self.loop.A.shape[0])
        z = 1j * omega[:, None, None] * unit
        return z - self.loop.A, np.broadcast_to(1j * unit, z.shape)

    def law(self, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        W, slope = self.loop.memory(1j * omega)
        return np.eye(W.shape[1]) - W, -1j * slope

    def even_law(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        return self.law((np.arange(count) + 0.5) / count * self.highest)

    def arriving(
        self, inputs: slice | np.ndarray, omega: np.ndarray, delay: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        rate, after = (-1j * part[:, None, None] for part in (omega, delay))
        p = np.exp(rate * delay[:, None, None]) * self.loop.B[:, inputs]
        return p, after * p, rate * p

    @property
    def cuts(self) -> Float[np.ndarray, " cut"]:
        return np.zeros(1)

    @property
    def period(self) -> float | None:
        return None


@dataclass(frozen=True, eq=False)
class OneInput(Response):
    """A loop as a function of one input's delay, all other inputs closed (immutable).

    With the columns p_k of the delay line of all other inputs at their own delays, a root lies on
    the limit of stability where M − r p is singular,

        M − r p = M_j − r p_j e_jᵀ,    M_j = M − Σ_{k≠j} r p_k e_kᵀ,

    and det(M_j − r p_j e_jᵀ) = det M_j (1 − r_j p_j) with r_j = e_jᵀ M_j⁻¹ r: the loop gain at
    input j is a number, r_j p_j.

    Attributes
    ----------
    whole : LoopResponse
    nominal : float
        The varied delay of the `whole` at which all inputs have their nominal delays, seconds.
    number : int
        j.
    offset : float
        The delay of input j less the one that is varied, seconds.
    """

    whole: LoopResponse
    nominal: float
    number: int
    offset: float

    @property
    def memory(self) -> float:
        return self.whole.memory + self.nominal + self.offset

    @property
    def highest(self) -> float:
        return self.whole.highest

    @property
    def cuts(self) -> Float[np.ndarray, " cut"]:
        return self.whole.cuts

    @property
    def period(self) -> float | None:
        return self.whole.period

    def samples(self, omega: np.ndarray, even: bool = False) -> Samples:
        loop, j = self.whole.samples(omega, even), self.number
        p, p_slope, _ = self.whole.delay_line(omega, np.array([self.nominal]))
        p[:, :, j] = p_slope[:, :, j] = 0.0
        M_slope = loop.M_slope - loop.r_slope @ p - loop.r @ p_slope
        inverse = inverses(loop.M - loop.r @ p)
        r = inverse @ loop.r
        r_slope = (inverse @ (loop.r_slope - M_slope @ r))[:, j : j + 1]
        # det M_j and det M_j · r_j for M and r would do as well. Scaled to M = 1 at every
        # frequency they have the same poles and zeros, and floats hold them.
        rate = traces(inverse, M_slope)[:, None, None]
        r = r[:, j : j + 1]
        return Samples(omega, loop.plant, np.ones_like(rate), rate, r, r_slope + rate * r)

    def delay_line(
        self, omega: np.ndarray, delay: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.whole.arriving(slice(self.number, self.number + 1), omega, delay + self.offset)
