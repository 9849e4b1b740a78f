"""How uncertain a prediction is under a Markov forecast: second moments, mode by mode.

Beside x goes c, the state of a mean plant that is sure, dc/ds = Ā c + B̄ u with Ā = Σ p_i A_i as
the stretch begins. With y = x − c, z = (y, c, 1) and M_i = E[z zᵀ 1{σ = i}], of which the last
corner is p_i, a held input u and white noise of intensity W_i make

    dM_i/ds = Z_i M_i + M_i Z_iᵀ + diag(W_i, 0, 0) p_i + Σ_j Λ_ji M_j,

           [ A_i   A_i − Ā   (B_i − B̄) u ]
    Z_i =  [ 0     Ā         B̄ u         ],
           [ 0     0         0           ]

a linear equation in all M together. It is integrated by its Taylor series, over steps short enough
for that, in which the operator is applied and never formed. After each stretch c is moved by the
mean of y. So the moments of y are those of the uncertainty and not of the motion, and nothing large
is subtracted: a small covariance about a large state keeps its digits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deadtime.feedback.known_state import Known
from deadtime.plant import SampledPlant, SwitchedSystem

_ROUND_OFF = 1e-18
_TERMS = 60


def markov_spread(
    sampled: SampledPlant,
    generator: Float[np.ndarray, "mode mode"],
    known: Known,
    W: Float[np.ndarray, "*mode n n"],
) -> Float[np.ndarray, "case input future n n"]:
    """By the mode now, a row each, and the mode at t + D; 0 where that has no probability."""
    plant = sampled.plant
    plant.one_delay("a prediction's covariance under a law whose forecast switches")
    moments, channels = _Moments.of(plant, known), np.arange(plant.inputs)
    ahead = sampled.ahead
    seconds = (ahead.stop - ahead.start).tolist()
    for length, lag in zip(seconds, ahead.lag, strict=True):
        u = known.past[len(known.past) - lag, channels]
        moments.advance(plant, generator, u, W, length)
    share = np.where(moments.p > 0.0, moments.p, 1.0)[..., None]
    mean, second = moments.first / share, moments.second / share[..., None]
    covariance = second - mean[..., :, None] * mean[..., None, :]
    return np.repeat(covariance[:, None], plant.inputs, axis=1)


@dataclass
class _Moments:
    """p_i, E[y 1{σ = i}], E[y yᵀ 1{σ = i}], and c, by case and mode."""

    p: np.ndarray
    first: np.ndarray
    second: np.ndarray
    c: np.ndarray

    @classmethod
    def of(cls, plant: SwitchedSystem, known: Known) -> _Moments:
        """As they are in each case now."""
        cases, n = known.x.shape
        p, second = np.zeros((cases, plant.modes)), np.zeros((cases, plant.modes, n, n))
        p[np.arange(cases), known.row], second[np.arange(cases), known.row] = 1.0, known.P
        return cls(p, np.zeros((cases, plant.modes, n)), second, known.x.copy())

    def advance(self, plant: SwitchedSystem, generator, u, W, length: float) -> None:
        """Over a stretch under one input."""
        n = plant.states
        beside = np.concatenate((self.c, np.ones((len(self.c), 1))), axis=1)
        M = np.empty((*self.p.shape, 2 * n + 1, 2 * n + 1))
        M[..., :n, :n] = self.second
        M[..., :n, n:] = self.first[..., None] * beside[:, None, None]
        M[..., n:, :n] = M[..., :n, n:].swapaxes(2, 3)
        M[..., n:, n:] = self.p[..., None, None] * (beside[:, :, None] * beside[:, None])[:, None]
        M = _integrated(self._motion(plant, u), M, generator, W, length)
        self.p, moved = M[..., -1, -1], M[..., :n, -1]
        shift = moved.sum(axis=1)
        self.first = moved - self.p[..., None] * shift[:, None]
        crossed = self.first[..., None] * shift[:, None, None]
        self.second = M[..., :n, :n] - crossed - moved[..., None, :] * shift[:, None, :, None]
        self.c = M[..., n:-1, -1].sum(axis=1) + shift

    def _motion(self, plant: SwitchedSystem, u: np.ndarray) -> Float[np.ndarray, "case mode q q"]:
        """Z of every case and mode."""
        n, force = plant.states, plant.B @ u
        A, f = np.tensordot(self.p, plant.A, 1), self.p @ force
        Z = np.zeros((*self.p.shape, 2 * n + 1, 2 * n + 1))
        Z[..., :n, :n], Z[..., n:-1, n:-1] = plant.A, A[:, None]
        Z[..., :n, n:-1], Z[..., :n, -1] = plant.A - A[:, None], force - f[:, None]
        Z[..., n:-1, -1] = f[:, None]
        return Z


def _integrated(Z, M, generator, W, length):
    """M after a stretch."""
    n = W.shape[-1]
    size = np.abs(Z[..., :n, :n]).sum(axis=3).max() + np.abs(np.diag(generator)).max()
    count = max(1, int(np.ceil(2.0 * size * length)))
    for _ in range(count):
        term, k = M, 0
        while np.abs(term).max() > _ROUND_OFF * np.abs(M).max() and k < _TERMS:
            k += 1
            moved = Z @ term
            mixed = np.tensordot(term, generator, (1, 0)).transpose(0, 3, 1, 2)
            moved = moved + moved.swapaxes(2, 3) + mixed
            moved[..., :n, :n] += W * term[..., -1:, -1:]
            term = moved * (length / count / k)
            M = M + term
    return M
