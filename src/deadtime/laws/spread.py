"""The covariance of predictions: futures of one system, Markov chains, chains at samples.

**One system from some instant on.** In such a future only the present state and the disturbance
are random: over τ seconds in a system the covariance P becomes e^{Aτ} P e^{Aᵀτ} + ∫₀^τ e^{As} W
e^{Aᵀs} ds for all inputs, with one W for all systems or one for each. Inputs that are still to be
computed count as predicted: the law's response to a later disturbance is left out.

**A Markov chain**: second moments, mode by mode. Beside x goes c, the certain state of a mean
plant, dc/ds = Ā c + B̄ u with Ā = Σ p_i A_i as the stretch begins. With y = x − c, z = (y, c, 1)
and M_i = E[z zᵀ 1{σ = i}], of which the last corner is p_i, a held input u and white noise of
intensity W_i make

    dM_i/ds = Z_i M_i + M_i Z_iᵀ + diag(W_i, 0, 0) p_i + Σ_j Λ_ji M_j,

           [ A_i   A_i − Ā   (B_i − B̄) u ]
    Z_i =  [ 0     Ā         B̄ u         ],
           [ 0     0         0           ]

a linear equation in all M together. It is integrated by its Taylor series, over steps short enough
for that, in which the operator is applied and never formed. After each stretch c is moved by the
mean of y. So the moments of y are those of the uncertainty and not of the motion, and nothing large
is subtracted: a small covariance about a large state keeps its digits.

**Any model at samples.** By mode and age there is a probability p, a mean μ and a covariance C of
the state. Within a period its mode moves them, μ → Φ μ + Γ u and C → Φ C Φᵀ + Q. At a sample a mode
goes on with probability 1 − hazard, an age older, or as old where age says nothing; those that meet
at one age have

    p = Σ w,    μ = Σ w μ_w / p,    C = Σ w (C_w + (μ_w − μ)(μ_w − μ)ᵀ) / p.

Nothing is subtracted but means, so the covariance keeps its digits.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deadtime.feedback.table import Known
from deadtime.numerics.covariance import noise_covariances, transitions
from deadtime.numerics.exponential import ROUND_OFF, discretise_modes
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.plant.discretisation import snap
from deadtime.switching.models.model import SampledChain


def held_spread(
    plant: SwitchedSystem, known: Known, W: Float[np.ndarray, "*mode n n"]
) -> Float[np.ndarray, "case input future n n"]:
    """The covariance in futures that each hold one mode of a plant, up to its own delays.

    Examples
    --------
    >>> plant = SwitchedSystem([[[0.0]], [[0.0]]], [[[1.0]], [[1.0]]], [[0.5], [2.0]])
    >>> known = Known(np.zeros(1, int), np.ones(1), np.zeros((1, 1)), np.eye(1)[None], np.eye(1))
    >>> held_spread(plant, known, np.eye(1)).ravel()
    array([1.5, 3. ])
    """
    return np.stack([_moved(P, plant, plant.delays, W) for P in known.P])


def dwelling_spread(
    plant: SwitchedSystem,
    after: SwitchedSystem,
    dwell_time: float,
    step: float,
    known: Known,
    W: Float[np.ndarray, "*mode n n"],
    after_W: Float[np.ndarray, "*future n n"],
) -> Float[np.ndarray, "case input future n n"]:
    """The covariance in futures that stay in the mode for its dwell, then in one of `after`."""
    delay = plant.one_delay("a prediction's covariance under a law with a dwell time")
    periods = snap(dwell_time / step)
    ages, found = int(np.ceil(periods)) + 1, []
    for row, P in zip(known.row.tolist(), known.P, strict=True):
        mode, age = divmod(row, ages)
        rest = min(max(0.0, periods - age) * step, delay)
        own_W = W if W.ndim == 2 else W[mode]
        P = _moved(P, plant.only([mode]), np.full((1, 1), rest), own_W)[0, 0]
        found.append(_moved(P, after, after.delays - rest, after_W))
    return np.stack(found)


def _moved(
    P: Float[np.ndarray, "n n"],
    plant: SwitchedSystem,
    seconds: Float[np.ndarray, "mode m"],
    W: Float[np.ndarray, "*mode n n"],
) -> Float[np.ndarray, "m mode n n"]:
    """The covariance after these times in every mode."""
    modes, m = seconds.shape
    A, tau = np.tile(plant.A, (m, 1, 1)), seconds.T.reshape(-1)
    Phi, W = transitions(A, tau), W if W.ndim == 2 else np.tile(W, (m, 1, 1))
    moved = Phi @ P @ Phi.swapaxes(1, 2) + noise_covariances(A, W, tau)
    return moved.reshape(m, modes, *P.shape)


_TERMS = 60  # with ‖operator‖·step ≤ 1/2 far fewer are needed


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
    share = np.where(moments.p > 0.0, moments.p, 1.0)[..., None]  # 0/1 = 0 where p = 0
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
        """The moments at t_k, in each case."""
        cases, n = known.x.shape
        p, second = np.zeros((cases, plant.modes)), np.zeros((cases, plant.modes, n, n))
        p[np.arange(cases), known.row], second[np.arange(cases), known.row] = 1.0, known.P
        return cls(p, np.zeros((cases, plant.modes, n)), second, known.x.copy())

    def advance(self, plant: SwitchedSystem, generator, u, W, length: float) -> None:
        """Advance over a stretch under one input."""
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
    """M after a stretch, by Taylor series over steps with ‖operator‖·step ≤ 1/2."""
    n = W.shape[-1]
    size = np.abs(Z[..., :n, :n]).sum(axis=3).max() + np.abs(np.diag(generator)).max()
    count = max(1, int(np.ceil(2.0 * size * length)))
    for _ in range(count):
        term, k = M, 0
        while np.abs(term).max() > ROUND_OFF * np.abs(M).max() and k < _TERMS:
            k += 1
            moved = Z @ term
            mixed = np.tensordot(term, generator, (1, 0)).transpose(0, 3, 1, 2)
            moved = moved + moved.swapaxes(2, 3) + mixed
            moved[..., :n, :n] += W * term[..., -1:, -1:]
            term = moved * (length / count / k)
            M = M + term
    return M


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
        """Advance over a piece in which every mode is held."""
        self.mean = np.einsum("iab,icb->ica", Phi, self.mean) + (Gamma @ u)[:, None]
        self.C = Phi[:, None] @ self.C @ Phi.swapaxes(1, 2)[:, None] + Q[:, None]

    def switch(self) -> None:
        """Advance over a sample, at which modes age or end."""
        ended = self.p * self.chain.hazard
        weights = self.chain.jump.T[..., None] * ended
        if self.p.shape[1] == 1:  # without ages, mass that stays and mass that enters merge
            weights += np.eye(len(ended))[..., None] * (self.p - ended)
        fresh = [_merged(own, self.mean, self.C) for own in weights]
        for kept in (self.p, self.mean, self.C):
            # np.roll moves the last age to the front. It is empty: the ages exceed the horizon.
            kept[:, -1] = 0.0
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
