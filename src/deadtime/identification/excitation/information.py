"""How much a log will tell of a plant, before it is logged: Fisher's information of the inputs.

States are measured, and S_σ, what noise adds in a period, is not tied to the unknowns θ: then

    F = Σ_k E[(∂P z_k)ᵀ S⁻¹ (∂P z_k)],    x_{k+1} = P_σ(θ) z_k + w_k,

exactly. E z zᵀ = z̄ z̄ᵀ + Cov z: the first part is what the inputs do, the second what noise does,
whatever the inputs. The errors of unbiased estimates are no less than F⁻¹ (Cramér and Rao), which
maximum likelihood reaches as logs grow.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from deadtime.base.frozen import Frozen
from deadtime.identification.excitation.loop import Chain
from deadtime.identification.parameters import Layout

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

    used : the periods that an identification uses
    room : (T, n + m), what |mean of x| and |mean of u| may reach; inf for no limit
    criterion : "delay", −log det of the delays' covariance, or "all", log det F
    random, deviation : what noise alone does, see `Chain.noise`
    """

    chain: Chain
    layout: Layout
    used: Bool[np.ndarray, " sample"]
    room: Float[np.ndarray, "sample y"]
    criterion: str
    random: Float[np.ndarray, "mode z z"] = field(repr=False)
    deviation: Float[np.ndarray, "sample y"] = field(repr=False)

    @classmethod
    def of(
        cls, chain: Chain, layout: Layout, used: Bool[np.ndarray, " sample"], criterion: str
    ) -> Prospect:
        """That of a chain, without limits."""
        room = np.full((used.size, layout.n + layout.m), np.inf)
        return cls(chain, layout, used, room, criterion, *chain.noise(used))

    def within(self, room: Float[np.ndarray, "sample y"]) -> Prospect:
        """The same with limits."""
        return replace(self, room=room)

    @cached_property
    def _white(self) -> list[Float[np.ndarray, "own n z"]]:
        """by_P of every mode, in units of its noise."""
        chain = self.chain
        roots = np.linalg.cholesky(chain.S)
        return [np.linalg.solve(L, one) for L, one in zip(roots, chain.by_P, strict=True)]

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

    def information(self, z: Float[np.ndarray, "sample z"]) -> Float[np.ndarray, "size size"]:
        """F of inputs by their z̄."""
        F = np.zeros((self.layout.size,) * 2)
        for i, (white, place) in enumerate(zip(self._white, self.chain.place, strict=True)):
            own = z[self.used & (self.chain.mode == i)]
            moved = white @ (own.T @ own + self.random[i])
            F[np.ix_(place, place)] += np.einsum("anz,bnz->ab", moved, white)
        return F

    def errors(self, r: Float[np.ndarray, "sample m"]) -> Float[np.ndarray, " size"]:
        """The standard error of every unknown; infinite where the inputs do not tell it."""
        return errors_of(self.information(self.acting(r)[1]))

    def worth(self, r: Float[np.ndarray, "sample m"], price: float = 0.0) -> Worth:
        """The criterion less `price` times the squares of what is beyond limits, relative."""
        chain, n = self.chain, self.layout.n
        xi, z = self.acting(r)
        value, by_F = self._criterion(self.information(z))
        of_z = np.zeros(z.shape)
        for i, (white, place) in enumerate(zip(self._white, chain.place, strict=True)):
            own = self.used & (chain.mode == i)
            theta = np.einsum("ab,anz,bny->zy", by_F[np.ix_(place, place)], white, white)
            of_z[own] = 2.0 * z[own] @ theta
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


def errors_of(F: Float[np.ndarray, "size size"]) -> Float[np.ndarray, " size"]:
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
