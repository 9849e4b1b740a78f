"""The table of the expected law under any model at samples, where delays differ.

Switches are seen at samples, as in `sampled_chain`, and what the law foresees ends where the mode
of that instant reads u_k, as in `markov_passage`. Going backwards from t_{k+p+1} to t_{k+p},
functionals of (mode, age) are

    R   of the expected state,
    w   of each input that is held and was computed after t_k in that future,
    g   of each input in flight, a weight,

all averaged over what the sample t_{k+p+1} finds, then carried through the stretches of period p
in their mode: R Γ is added to the w or g of the input that acts, and R becomes R Φ. Where an input
to come is first read, R + w K and w = 0; where the mode reads u_k itself, R = K and what comes
later counts no more. A weight g goes on back to t_k: (N²/2)(modes)(ages + N) m² operations in all,
as with one delay.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from deadtime.plant import SampledPlant
from deadtime.switching.models.model import SampledChain


def chain_passage(
    K: Float[np.ndarray, "mode m n"], chain: SampledChain, ages: int, sampled: SampledPlant
) -> tuple[Float[np.ndarray, "mode age m n"], Float[np.ndarray, "mode age tap m m"]]:
    """State and input gains by mode and age; `chain` reaches N ages past them, or has one."""
    modes, m, n = K.shape
    longest = sampled.longest_lag
    F, G = np.empty((modes, ages, m, n)), np.zeros((modes, ages, longest, m, m))
    for target in range(m):
        march = _PassageMarch(K, chain, sampled, target)
        for p in range(longest, -1, -1):
            march.back(p)
        F[:, :, target] = march.R[:, :ages]
        G[:, :, :, target] = march.g[:, :ages]
    return F, G


class _PassageMarch:
    """The functionals of one input's feedback at a sample ahead, by mode and age."""

    def __init__(self, K, chain: SampledChain, sampled: SampledPlant, target: int):
        (modes, total), m, n = chain.hazard.shape, *K.shape[1:]
        self.K, self.target, self.chain = K, target, chain
        self.pieces = [sampled.pieces(i) for i in range(modes)]
        self.R, self.w = np.zeros((modes, total, n)), np.zeros((modes, total, m))
        self.g = np.zeros((modes, total, sampled.longest_lag, m))

    def back(self, p: int) -> None:
        """From t_{k+p+1} to t_{k+p}."""
        self.R, self.w, self.g = self._averaged(p)
        for i, pieces in enumerate(self.pieces):
            before = [part.stretch.lag for part in (pieces[-1], *pieces[:-1])]
            for place in range(len(pieces) - 1, -1, -1):
                sample = p - pieces[place].stretch.lag
                earlier = p - (place == 0) - before[place]
                self._through(i, pieces[place], sample, sample > earlier)

    def _averaged(self, p: int) -> list[np.ndarray]:
        """R, w and g of what the sample at the end of period p finds, seen from period p."""
        first = self._entered(p)
        result = []
        for value, fresh in zip((self.R, self.w, self.g), first, strict=True):
            older = np.concatenate((value[:, 1:], value[:, -1:]), axis=1)
            hazard = self.chain.hazard.reshape(*value.shape[:2], *[1] * (value.ndim - 2))
            result.append(older + hazard * (fresh[:, None] - older))
        return result

    def _entered(self, p: int) -> list[np.ndarray]:
        """R, w and g of a switch out of each mode at the end of period p."""
        T = self.chain.jump
        R, w, g = (np.tensordot(T, value[:, 0], 1) for value in (self.R, self.w, self.g))
        read = [p - pieces[-1].stretch.lag >= 0 for pieces in self.pieces]
        reads = [p + 1 - pieces[0].stretch.lag >= 0 for pieces in self.pieces]
        for i in range(len(T)):
            for after in np.flatnonzero(T[i]):
                for j in np.flatnonzero(reads[after] & ~read[i]):
                    # Only the mode that is entered reads it, so for the first time.
                    R[i] += T[i, after] * self.w[after, 0, j] * self.K[after, j]
                    w[i, j] -= T[i, after] * self.w[after, 0, j]
        return [R, w, g]

    def _through(self, i: int, piece, sample: np.ndarray, arrives: np.ndarray) -> None:
        """Back through a stretch of mode i, in which it reads `sample`, some from its start on."""
        R, w, g, K = self.R[i], self.w[i], self.g[i], self.K[i]
        weight = R @ piece.Gamma
        for j, s in enumerate(sample.tolist()):
            if s >= 0:
                w[:, j] += weight[:, j]
            else:
                g[:, -1 - s, j] += weight[:, j]
        R[:] = R @ piece.Phi
        for j in np.flatnonzero(arrives & (sample >= 0)):
            R += w[:, j : j + 1] * K[j]
            w[:, j] = 0.0
        if sample[self.target] >= 0:
            R[:], w[:], g[:] = K[self.target], 0.0, 0.0
