"""How uncertain a prediction is under any model at samples.

By mode and age there is a probability p, a mean μ and a covariance C of the state. Within a period
its mode moves them, μ → Φ μ + Γ u and C → Φ C Φᵀ + Q. At a sample a mode goes on with probability
1 − hazard, an age older, or as old where age says nothing; those that meet at one age have

    p = Σ w,    μ = Σ w μ_w / p,    C = Σ w (C_w + (μ_w − μ)(μ_w − μ)ᵀ) / p.

Nothing is subtracted but means, so the covariance keeps its digits.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from deadtime.feedback.known_state import Known
from deadtime.numerics.covariance import noise_covariances
from deadtime.numerics.exponential import discretise_modes
from deadtime.plant import SampledPlant
from deadtime.switching.models.model import SampledChain


def chain_spread(
    sampled: SampledPlant,
    chain: SampledChain,
    ages: int,
    known: Known,
    W: Float[np.ndarray, "*mode n n"],
) -> Float[np.ndarray, "case input future n n"]:
    """By the mode and age now, a row each, and the mode at t + D; 0 where it has no probability.

    `chain` reaches N ages past the table's `ages`, or has one.
    """
    plant = sampled.plant
    plant.one_delay("a prediction's covariance under a law whose forecast switches")
    moved = {}
    for length in {length for length, _, _ in _pieces(sampled)}:
        tau = np.full(plant.modes, length)
        Phi, Gamma = discretise_modes(plant.A, plant.B, length)
        moved[length] = Phi, Gamma, noise_covariances(plant.A, W, tau)
    found = []
    for row, x, P in zip(known.row.tolist(), known.x, known.P, strict=True):
        mode, age = divmod(row, ages)
        march = _SpreadMarch(chain, mode, age, x, P)
        for length, lag, sample in _pieces(sampled):
            Phi, Gamma, Q = moved[length]
            march.over(Phi, Gamma, Q, known.past[-lag])
            if sample:
                march.switch()
        found.append(march.by_mode())
    return np.repeat(np.stack(found)[:, None], plant.inputs, axis=1)


def _pieces(sampled: SampledPlant) -> Iterator[tuple[float, int, bool]]:
    """Seconds, the lag of the acting inputs, and whether a sample follows; up to t + D."""
    h, count, phase = sampled.step, sampled.window.count, sampled.window.phase
    for p in range(count):
        yield phase, count - p, phase == h
        if phase < h and p < count - 1:
            yield h - phase, count - p - 1, True


class _SpreadMarch:
    """Probability, mean and covariance by mode and age, from one that is known."""

    def __init__(self, chain: SampledChain, mode: int, age: int, x, P):
        modes, ages, n = *chain.hazard.shape, x.size
        self.chain = chain
        self.p = np.zeros((modes, ages))
        self.mean, self.C = np.zeros((modes, ages, n)), np.zeros((modes, ages, n, n))
        self.p[mode, age], self.mean[mode, age], self.C[mode, age] = 1.0, x, P

    def over(self, Phi, Gamma, Q, u) -> None:
        """A piece in which every mode is held."""
        self.mean = np.einsum("iab,icb->ica", Phi, self.mean) + (Gamma @ u)[:, None]
        self.C = Phi[:, None] @ self.C @ Phi.swapaxes(1, 2)[:, None] + Q[:, None]

    def switch(self) -> None:
        """A sample, at which modes grow older or end."""
        ended = self.p * self.chain.hazard
        weights = self.chain.jump.T[..., None] * ended
        if self.p.shape[1] == 1:  # age says nothing: whoever goes on meets those that come
            weights += np.eye(len(ended))[..., None] * (self.p - ended)
        fresh = [_merged(own, self.mean, self.C) for own in weights]
        for kept in (self.p, self.mean, self.C):
            kept[:, -1] = 0.0  # nothing is as old: the ages reach past the horizon
        self.p = np.roll(self.p - ended, 1, axis=1)
        self.mean, self.C = np.roll(self.mean, 1, axis=1), np.roll(self.C, 1, axis=1)
        for j, (p, mean, C) in enumerate(fresh):
            self.p[j, 0], self.mean[j, 0], self.C[j, 0] = p, mean, C

    def by_mode(self) -> Float[np.ndarray, "mode n n"]:
        """The covariance in every mode, whatever its age."""
        parts = zip(self.p, self.mean, self.C, strict=True)
        return np.stack([_merged(*part)[2] for part in parts])


def _merged(w, mean, C):
    """Weight, mean and covariance of a mixture; 0 of nothing."""
    total = w.sum()
    if total == 0.0:
        return 0.0, np.zeros(mean.shape[-1]), np.zeros(C.shape[-2:])
    share, n = (w / total).reshape(-1), mean.shape[-1]
    mean, C = mean.reshape(-1, n), C.reshape(-1, n, n)
    middle = share @ mean
    off = mean - middle
    return total, middle, np.tensordot(share, C, 1) + (share[:, None] * off).T @ off
