"""Disturbances of the plant: dx/dt = A_σ x + B_σ u(t − D) + w(t).

Over each stretch of a period (from one arrival of an input to the next) what w adds to x is drawn
with its exact distribution, switches within it included. Between the ends of stretches the constant
force that adds as much is held, so that a run can be evaluated anywhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from deadtime.base.checks import as_floats, number, read_only, real_array, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.imperfections.base import Disturbance, Piece, Sizes, per_signal
from deadtime.numerics.covariance import noise_covariance, square_root, transition
from deadtime.plant.steps import snap


@dataclass(frozen=True)
class WhiteDisturbance(Disturbance):
    """White process noise: E[w(t) w(s)ᵀ] = W δ(t − s).

    The states at the samples and at the arrivals of inputs have exactly the distribution of the
    stochastic differential equation. The roughness of a path within a stretch is left out: it would
    add tr(W) h/6 a second to ∫|x|² on average.

    Parameters
    ----------
    intensity : array_like
        W: a number for W = number·I, shape (n,) for a diagonal, or (n, n), positive semidefinite;
        in units of x² per second.
    """

    intensity: ArrayLike

    def draws(
        self, sizes: Sizes, lengths: tuple[float, ...], steps: int, rng: np.random.Generator
    ) -> np.ndarray:
        self._check(sizes.states)
        return rng.standard_normal((steps, len(lengths), sizes.states))

    def spread(self, sizes: Sizes, pieces: Sequence[Piece]) -> np.ndarray:
        W = self._check(sizes.states)
        return square_root(_accumulate(pieces, lambda A: (A, W), sizes.states))

    def _check(self, n: int) -> np.ndarray:
        name = "WhiteDisturbance.intensity"
        given = as_floats(name, self.intensity, "one, (n,) or (n, n)")
        if given.ndim < 2:
            given = np.diag(per_signal(name, given, n))
        W = require_shape(name, real_array(name, given, "(n, n)", 2), (n, n), "(n, n)")
        size = np.abs(W).max()
        if np.abs(W - W.T).max() > 1e-9 * size or np.linalg.eigvalsh(W)[0] < -1e-9 * size:
            raise ArgumentError(
                f"{name} must be symmetric and positive semidefinite, got {W.tolist()}."
            )
        return W


@dataclass(frozen=True)
class ColouredDisturbance(Disturbance):
    """Coloured noise w = E c with c' = −c/T + white noise (Ornstein–Uhlenbeck), stationary.

    Parameters
    ----------
    std : array_like
        Stationary standard deviation of c, a number or shape (q,).
    time_constant : array_like
        Correlation time T, seconds, a number or shape (q,).
    force : array_like, shape (n,) or (n, q)
        E: how each of the q sources acts on dx/dt.
    """

    std: ArrayLike
    time_constant: ArrayLike
    force: ArrayLike

    def draws(
        self, sizes: Sizes, lengths: tuple[float, ...], steps: int, rng: np.random.Generator
    ) -> np.ndarray:
        _, std, T = self._check(sizes.states)
        q, n, pieces = std.size, sizes.states, len(lengths) * steps
        normal = rng.standard_normal((pieces + 1, q))
        c = np.empty((pieces + 1, q))
        c[0] = std * normal[0]
        tau = np.tile(lengths, steps)[:, None]
        kept, fresh = np.exp(-tau / T), std * np.sqrt(-np.expm1(-2.0 * tau / T))
        for i in range(pieces):
            c[i + 1] = kept[i] * c[i] + fresh[i] * normal[i + 1]
        rest = rng.standard_normal((pieces, n))
        return np.hstack((c[:-1], c[1:], rest)).reshape(steps, len(lengths), 2 * q + n)

    def spread(self, sizes: Sizes, pieces: Sequence[Piece]) -> np.ndarray:
        """From c at both ends and n normal numbers: the mean given c, and what is left."""
        E, std, T = self._check(sizes.states)
        n, q = E.shape
        total = sum(tau for _, tau in pieces)
        if total == 0.0:
            return np.zeros((n, 2 * q + n))
        W = np.zeros((n + q, n + q))
        W[n:, n:] = np.diag(2.0 * std**2 / T)

        def joint(A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return np.block([[A, E], [np.zeros((q, n)), np.diag(-1.0 / T)]]), W

        M = np.eye(n + q)
        for A, tau in pieces:
            M = transition(joint(A)[0], tau) @ M
        Q = _accumulate(pieces, joint, n + q)
        kept, variance = np.exp(-total / T), std**2 * -np.expm1(-2.0 * total / T)
        slope = Q[:n, n:] / np.where(variance > 0.0, variance, 1.0)
        left = square_root(Q[:n, :n] - slope @ Q[n:, :n])
        return np.hstack((M[:n, n:] - slope * kept, slope, left))

    def _check(self, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        given = as_floats("ColouredDisturbance.force", self.force, "(n, q)")
        given = given[:, None] if given.ndim == 1 else given
        E = real_array("ColouredDisturbance.force", given, "(n, q)", 2)
        require_shape("ColouredDisturbance.force", E, (n, E.shape[1]), "(n, q)")
        std = per_signal("ColouredDisturbance.std", self.std, E.shape[1])
        T = per_signal("ColouredDisturbance.time_constant", self.time_constant, E.shape[1])
        if (std < 0.0).any() or (T <= 0.0).any():
            raise ArgumentError(
                "ColouredDisturbance must have std ≥ 0 and time_constant > 0, got "
                f"{std.tolist()} and {T.tolist()}."
            )
        return E, std, T


@dataclass(frozen=True)
class StepDisturbance(Disturbance):
    """A constant force on dx/dt from the first sample at or after `start` up to that of `end`.

    Parameters
    ----------
    force : array_like, shape (n,)
        Units of x per second.
    start, end : float
        Seconds, 0 ≤ start < end.
    """

    force: ArrayLike
    start: float = 0.0
    end: float = math.inf

    def draws(
        self, sizes: Sizes, lengths: tuple[float, ...], steps: int, rng: np.random.Generator
    ) -> np.ndarray:
        start = number("StepDisturbance.start", self.start)
        try:
            end = float(self.end)
        except (TypeError, ValueError):
            end = math.nan
        if not 0.0 <= start < end:
            raise ArgumentError(
                f"StepDisturbance must have 0 ≤ start < end, got {start:g} and {self.end}."
            )
        first, stop = (math.ceil(snap(min(t / sizes.step, steps))) for t in (start, end))
        active = np.zeros((steps, len(lengths), 1))
        active[first:stop] = 1.0
        return active

    def spread(self, sizes: Sizes, pieces: Sequence[Piece]) -> np.ndarray:
        from deadtime.numerics.exponential import discretise

        name = "StepDisturbance.force"
        force = real_array(name, self.force, "(n,)", 1)
        require_shape(name, force, (sizes.states,), "(n,)")
        total = np.zeros((sizes.states, 1))
        for A, tau in pieces:
            Phi, Gamma = discretise(read_only(A), read_only(force[:, None]), tau)
            total = Phi @ total + Gamma
        return total


def _accumulate(pieces: Sequence[Piece], system, order: int) -> np.ndarray:
    """The covariance over pieces, each under its own (A, W) = system(A of the plant)."""
    Q = np.zeros((order, order))
    for A, tau in pieces:
        F, W = system(A)
        Phi = transition(F, tau)
        Q = Phi @ Q @ Phi.T + noise_covariance(F, W, tau)
    return Q
