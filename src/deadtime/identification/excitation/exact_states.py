"""Information of a log whose states are measured without noise.

S_σ, what noise adds in a period, is not tied to the unknowns θ: then

    F = Σ_k E[(∂P z_k)ᵀ S⁻¹ (∂P z_k)],    x_{k+1} = P_σ(θ) z_k + w_k,

exactly. E z zᵀ = z̄ z̄ᵀ + Cov z: the first part is what the inputs do, the second what noise does,
whatever the inputs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from deadtime.base.frozen import Frozen
from deadtime.identification.excitation.excited_loop import Chain

Pullback = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class ExactStates(Frozen):
    """F by means z̄ of what acts in every period.

    white : of every mode ∂P in units of its noise; place : whose they are, of `size` unknowns
    rows : the periods that count, of every mode; random : Σ Cov z over them
    """

    white: list[Float[np.ndarray, "own n z"]]
    place: list[Int[np.ndarray, " own"]]
    rows: list[Int[np.ndarray, " row"]]
    random: Float[np.ndarray, "mode z z"]
    size: int

    @classmethod
    def of(cls, chain: Chain, used: Bool[np.ndarray, " sample"], size: int) -> ExactStates:
        """Those of a chain, over the periods that an identification uses."""
        roots = np.linalg.cholesky(chain.S)
        white = [np.linalg.solve(L, one) for L, one in zip(roots, chain.by_P, strict=True)]
        rows = [np.flatnonzero(used & (chain.mode == i)) for i in range(len(white))]
        random = np.zeros((len(white), *chain.Z.shape[1:2] * 2))
        for k, now in enumerate(chain.covariances()):
            if used[k]:
                Z = chain.Z[chain.kind[k]][:, : len(now)]
                random[chain.mode[k]] += Z @ now @ Z.T
        return cls(white, chain.place, rows, random, size)

    def information(
        self, z: Float[np.ndarray, "sample z"]
    ) -> tuple[Float[np.ndarray, "size size"], Pullback]:
        """F, and the map from a derivative by F to one by z̄."""
        F = np.zeros((self.size, self.size))
        every = list(zip(self.white, self.place, self.rows, strict=True))
        for i, (white, place, own) in enumerate(every):
            moved = white @ (z[own].T @ z[own] + self.random[i])
            F[np.ix_(place, place)] += np.einsum("anz,bnz->ab", moved, white)

        def back(by_F: np.ndarray) -> np.ndarray:
            of_z = np.zeros(z.shape)
            for white, place, own in every:
                theta = np.einsum("ab,anz,bny->zy", by_F[np.ix_(place, place)], white, white)
                of_z[own] = 2.0 * z[own] @ theta
            return of_z

        return F, back
