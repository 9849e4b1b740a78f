"""What not knowing the modes costs: the information of the log, in place of that of known modes.

The score in all unknowns, θ, S and P, is that of Fisher's identity, and the observed information is
minus its derivative, by central differences: what Louis' formula gives (J. Royal Statistical
Society B 44(2), 1982). S and P are estimated, too, so that of θ there remains Schur's complement

    J = J_θθ − J_θη J_ηη⁻¹ J_ηθ,    η: S as L M Lᵀ about M = I, P by the logarithms of its odds.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.identification.intervals import left_of
from deadtime.identification.likelihoods.hidden_log import HiddenLog
from deadtime.identification.parameters import Vector

_FAINT = 1e-8  # of information: beside one that is so much larger, differences lose it
_SMALL = 1e-3  # of a standard error, a step of differences
_NEVER = 1e-6  # a jump of less probability is none that could be estimated
_ROUND_OFF = 1e-12  # of the unknowns: a step so small is lost in them
_CERTAIN = 1e-6  # Σ γ (1 − γ) of modes that are known
_LEAST = 1e-4  # of the information of known modes that is left in every direction


class Information(NamedTuple):
    """Of θ: with S and P held, and with these estimated; and that if the modes were known.

    told : the least share, over all directions, of what is left of the last
    of_noise : (modes,), the least share that is left of what would be told of S's diagonal
    """

    held: Float[np.ndarray, "size size"]
    left: Float[np.ndarray, "size size"]
    known: Float[np.ndarray, "size size"]
    told: float
    of_noise: Float[np.ndarray, " mode"]

    @property
    def widening(self) -> float:
        """How many times longer than with known modes the longest interval is."""
        errors = [np.diagonal(np.linalg.inv(F)) for F in (self.left, self.known)]
        return float(np.sqrt((errors[0] / errors[1]).max()))


class _Noise:
    """M and the odds as a vector about where a likelihood has S and P."""

    def __init__(self, log: HiddenLog) -> None:
        self.log, n = log, log.layout.n
        self.i, self.j = np.tril_indices(n)
        self.L = np.linalg.cholesky(log.S)
        self.jumps = log.jumps.likelier(_NEVER)

    @property
    def size(self) -> int:
        """How many unknowns there are."""
        return len(self.L) * self.i.size + len(self.jumps)

    def at(self, eta: np.ndarray) -> HiddenLog:
        """The likelihood with other S and P."""
        cut = len(self.L) * self.i.size
        M = np.tile(np.eye(self.L.shape[1]), (len(self.L), 1, 1))
        shift = eta[:cut].reshape(len(self.L), -1)
        M[:, self.i, self.j] += shift
        M[:, self.j, self.i] += np.where(self.i == self.j, 0.0, shift)
        odds = np.ones(self.log.jumps.matrix.shape)
        for (i, j), change in zip(self.jumps, eta[cut:], strict=True):
            odds[i, j] = np.exp(change)
        S = self.L @ M @ self.L.transpose(0, 2, 1)
        return replace(self.log, S=S, jumps=self.log.jumps.scaled(odds))

    @property
    def known(self) -> Float[np.ndarray, "M M"]:
        """The information on M if the modes were known, per period."""
        return np.diag(np.where(self.i == self.j, 0.5, 1.0))

    def shares(
        self, J: Float[np.ndarray, "M M"], counts: Float[np.ndarray, " mode"]
    ) -> Float[np.ndarray, " mode"]:
        """Of the information on log S_aa that is left of known modes', the least of all a."""
        known = np.kron(np.diag(counts), self.known)
        covariance, own = np.linalg.inv(lifted(J, known)[0]), self.i.size
        found = np.empty(len(self.L))
        for mode, L in enumerate(self.L):
            twice = np.where(self.i == self.j, 1.0, 2.0)
            slope = twice * L[:, self.i] * L[:, self.j] / (L**2).sum(axis=1)[:, None]
            at = slice(mode * own, (mode + 1) * own)
            spread = np.einsum("as,st,at->a", slope, covariance[at, at], slope)
            found[mode] = (2.0 / counts[mode] / spread).min()
        return found

    def score(self, theta: np.ndarray, eta: np.ndarray, cells: np.ndarray) -> np.ndarray:
        """The score in θ and in these."""
        log = self.at(eta)
        n, parts = log.layout.n, [log.evaluate(theta, cells).score]
        terms, found = log.weighted(theta, cells)
        for term, L, S in zip(terms, self.L, log.S, strict=True):
            e = np.linalg.solve(L, (term.root[:, :n] - term.root[:, n:] @ term.P.T).T)
            back = np.linalg.inv(np.linalg.solve(L, np.linalg.solve(L, S).T))
            total = found.weight[:, len(parts) - 1].sum()
            slope = 0.5 * (back @ (e @ e.T) @ back - total * back)
            twice = np.where(self.i == self.j, 1.0, 2.0)
            parts.append(twice * slope[self.i, self.j])
        leave = log.jumps.slope(found.counts)
        return np.concatenate((*parts, [leave[i, j] for i, j in self.jumps]))


def information_of(log: HiddenLog, theta: Vector, cells: Int[np.ndarray, " delay"]) -> Information:
    """The information on θ at the maximum, delays within their cells."""
    noise, known = _Noise(log), log.evaluate(theta, cells).information
    weight = log.posterior(theta, cells).weight
    unit = 1.0 / np.sqrt(np.maximum(np.diagonal(known), 1e-300))
    coarse = (_SMALL * unit).min() < _ROUND_OFF * np.abs(theta).max()
    coarse |= np.linalg.eigvalsh(known * unit * unit[:, None])[0] < _FAINT
    if coarse or (weight * (1.0 - weight)).sum() < _CERTAIN:
        # of no noise differences tell nothing
        return Information(known, known, known, 1.0, np.ones(log.layout.modes))
    of_S = np.repeat(1.0 / np.sqrt(weight.sum(axis=0)), noise.i.size)
    steps = _SMALL * np.concatenate((unit, of_S, np.full(len(noise.jumps), 0.3)))
    size = theta.size
    J = np.empty((steps.size, steps.size))
    for a, step in enumerate(steps):
        moved = np.zeros(steps.size)
        moved[a] = step
        up = noise.score(theta + moved[:size], moved[size:], cells)
        down = noise.score(theta - moved[:size], -moved[size:], cells)
        J[a] = (down - up) / (2.0 * step)
    J = 0.5 * (J + J.T)
    held, _ = lifted(J[:size, :size], known)
    left, told = lifted(left_of(J, np.arange(size)), known)
    of_noise = left_of(J, np.arange(size, steps.size - len(noise.jumps)))
    return Information(held, left, known, told, noise.shares(of_noise, weight.sum(axis=0)))


def lifted(J: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, float]:
    """J with some share, up to all, of what known modes would give in every direction; the least.

    More it cannot be, but for what differences and one log's own curvature add.
    """
    unit = np.sqrt(np.maximum(np.diagonal(known), 1e-300))
    try:
        L = np.linalg.cholesky(known / unit / unit[:, None])
    except np.linalg.LinAlgError:
        return known, 1.0  # nothing can be seen in some direction: that is refused by its name
    inner = np.linalg.solve(L, np.linalg.solve(L, J / unit / unit[:, None]).T)
    values, vectors = np.linalg.eigh(0.5 * (inner + inner.T))
    whole = L @ (vectors * np.clip(values, _LEAST, 1.0)) @ vectors.T @ L.T
    return whole * unit * unit[:, None], float(values[0])
