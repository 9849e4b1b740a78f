"""How much a log will tell of a plant, before it is logged: Fisher's information of the inputs.

F is a constant and a quadratic form of the means z̄ of what acts in every period, which are linear
in the inputs: `exact_states`, `noisy_states`. The errors of unbiased estimates are no less than F⁻¹
(Cramér and Rao), which maximum likelihood reaches as logs grow.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.base.frozen import Frozen
from deadtime.identification.excitation.excited_loop import Chain
from deadtime.identification.excitation.state_information import ExactStates, NoisyStates
from deadtime.identification.parameters import Layout, Vector

SIGMAS = 3.0  # standard deviations of the noise that limits leave room for
_UNSEEN = 1e-12  # of an eigenvalue of the information, scaled to a diagonal of ones


class Worth(NamedTuple):
    """What inputs are worth, its derivatives by them, and how far they carry the loop out.

    value : of the criterion; by_r : (T, m); beyond : the largest excess over a limit, of it
    """

    value: float
    by_r: Float[np.ndarray, "sample m"]
    beyond: float


@dataclass(frozen=True, eq=False)
class Prospect(Frozen):
    """The information that inputs r promise.

    measured : how states are, which says what a mean z̄ is worth
    room : (T, n + m), what |mean of x| and |mean of u| may reach; inf for no limit
    criterion : "delay", −log det of the delays' covariance, or "all", log det F
    deviation : of states and inputs, what noise alone does
    """

    chain: Chain
    layout: Layout
    measured: ExactStates | NoisyStates
    criterion: str
    room: Float[np.ndarray, "sample y"]
    deviation: Float[np.ndarray, "sample y"] = field(repr=False)

    @classmethod
    def of(
        cls, chain: Chain, layout: Layout, measured: ExactStates | NoisyStates, criterion: str
    ) -> Prospect:
        """That of a chain, without limits."""
        room = np.full((chain.kind.size, layout.n + layout.m), np.inf)
        return cls(chain, layout, measured, criterion, room, chain.deviations())

    def within(self, room: Float[np.ndarray, "sample y"]) -> Prospect:
        """The same with limits."""
        return replace(self, room=room)

    @property
    def samples(self) -> int:
        """How many rows there are."""
        return self.chain.kind.size

    def reach(self, r: Float[np.ndarray, "sample m"]) -> Float[np.ndarray, "sample y"]:
        """What every |state| and |input| stays below, at three standard deviations."""
        xi = self.chain.means(r)
        return np.abs(self._outputs(xi, r)) + SIGMAS * self.deviation

    def _outputs(self, xi: np.ndarray, r: np.ndarray) -> Float[np.ndarray, "sample y"]:
        """The means of states and inputs."""
        own = np.einsum("kmx,kx->km", self.chain.U[self.chain.kind], xi)
        return np.hstack((xi[:, : self.layout.n], own + r))

    def acting(self, r: Float[np.ndarray, "sample m"]) -> tuple[np.ndarray, np.ndarray]:
        """ξ̄ and z̄ of every sample."""
        chain = self.chain
        xi = chain.means(r)
        z = np.einsum("kzx,kx->kz", chain.Z[chain.kind], xi)
        return xi, z + np.einsum("kzm,km->kz", chain.Y[chain.kind], r)

    def information(self, r: Float[np.ndarray, "sample m"]) -> Float[np.ndarray, "size size"]:
        """F of inputs."""
        return self.measured.information(self.acting(r)[1])[0]

    def errors(self, r: Float[np.ndarray, "sample m"]) -> Vector:
        """The standard error of every unknown; infinite where the inputs do not tell it."""
        return errors_of(self.information(r))

    def worth(self, r: Float[np.ndarray, "sample m"], price: float = 0.0) -> Worth:
        """The criterion less `price` times the squares of what is beyond limits, relative."""
        chain, n = self.chain, self.layout.n
        xi, z = self.acting(r)
        F, back = self.measured.information(z)
        value, by_F = self._criterion(F)
        of_z = back(by_F)
        of_xi = np.einsum("kzx,kz->kx", chain.Z[chain.kind], of_z)
        by_r = np.einsum("kzm,kz->km", chain.Y[chain.kind], of_z)
        U = chain.U[chain.kind]
        y = self._outputs(xi, r)
        excess = np.maximum(np.abs(y) / self.room - 1.0, 0.0)
        if price > 0.0 and excess.any():
            value -= price * float((excess**2).sum())
            of_y = -2.0 * price * excess * np.sign(y) / self.room
            of_xi[:, :n] += of_y[:, :n]
            of_xi += np.einsum("kmx,km->kx", U, of_y[:, n:])
            by_r += of_y[:, n:]
        return Worth(value, by_r + chain.back(of_xi)[0], float(excess.max()))

    def _criterion(self, F: np.ndarray) -> tuple[float, np.ndarray]:
        """What F is worth, and its derivative by F; −∞ where an unknown is not told."""
        unit = 1.0 / np.sqrt(np.maximum(np.diagonal(F), 1e-300))
        scaled = F * unit[:, None] * unit
        first = self.layout.size - self.layout.delays
        if not _is_told(scaled):
            return -np.inf, np.zeros(F.shape)
        value, by_F = np.linalg.slogdet(scaled)[1], np.linalg.inv(scaled)
        if self.criterion == "delay":
            rest = scaled[:first, :first]
            value -= np.linalg.slogdet(rest)[1] + 2.0 * np.log(unit[first:]).sum()
            by_F[:first, :first] -= np.linalg.inv(rest)
        else:
            value -= 2.0 * np.log(unit).sum()
        return float(value), by_F * unit[:, None] * unit


def errors_of(F: Float[np.ndarray, "size size"]) -> Vector:
    """Roots of the diagonal of F⁻¹; infinite where F is singular."""
    unit = 1.0 / np.sqrt(np.maximum(np.diagonal(F), 1e-300))
    scaled = F * unit[:, None] * unit
    if not _is_told(scaled):
        return np.full(len(F), np.inf)
    values, vectors = np.linalg.eigh(scaled)
    return unit * np.sqrt((vectors**2 / values).sum(axis=1))


def _is_told(scaled: np.ndarray) -> bool:
    """Whether an information, scaled to a diagonal of ones, has a part in every direction."""
    return bool(np.isfinite(scaled).all()) and bool(np.linalg.eigvalsh(scaled)[0] > _UNSEEN)
