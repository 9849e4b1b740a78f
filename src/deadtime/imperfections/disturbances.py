"""Disturbances of the plant: dx/dt = A_σ x + B_σ u(t − D) + w(t).

Over each stretch of a period (from one arrival of an input to the next) what w adds to x is drawn
with its exact distribution, switches within it included. Between the ends of stretches the constant
force that adds as much is held, so that a run can be evaluated anywhere.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from deadtime.base.checks import as_floats, number, read_only, real_array, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.imperfections.base import Disturbance, Sizes, Stacked, per_signal
from deadtime.numerics.covariance import noise_covariances, square_root, transitions
from deadtime.plant.steps import snap


@dataclass(frozen=True)
class WhiteDisturbance(Stacked, Disturbance):
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

    def spreads(self, sizes: Sizes, A: np.ndarray, tau: np.ndarray) -> np.ndarray:
        return square_root(_accumulate(A, self._check(sizes.states), tau)[1])

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
class ColouredDisturbance(Stacked, Disturbance):
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
        fresh *= normal[1:]
        for j in range(q):
            c[1:, j] = _filter(kept[:, j].tolist(), fresh[:, j].tolist(), float(c[0, j]))
        rest = rng.standard_normal((pieces, n))
        return np.hstack((c[:-1], c[1:], rest)).reshape(steps, len(lengths), 2 * q + n)

    def spreads(self, sizes: Sizes, A: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """From c at both ends and n normal numbers: the mean given c, and what is left."""
        E, std, T = self._check(sizes.states)
        n, q = E.shape
        total = tau.sum(axis=1)[:, None]
        W = np.zeros((n + q, n + q))
        W[n:, n:] = np.diag(2.0 * std**2 / T)
        joint = np.zeros((*A.shape[:2], n + q, n + q))
        joint[..., :n, :n], joint[..., :n, n:], joint[..., n:, n:] = A, E, np.diag(-1.0 / T)
        M, Q = _accumulate(joint, W, tau)
        kept, variance = np.exp(-total / T), std**2 * -np.expm1(-2.0 * total / T)
        slope = Q[:, :n, n:] / np.where(variance > 0.0, variance, 1.0)[:, None]
        left = square_root(Q[:, :n, :n] - slope @ Q[:, n:, :n])
        return np.concatenate((M[:, :n, n:] - slope * kept[:, None], slope, left), axis=2)

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
class StepDisturbance(Stacked, Disturbance):
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

    def spreads(self, sizes: Sizes, A: np.ndarray, tau: np.ndarray) -> np.ndarray:
        from deadtime.numerics.exponential import discretise_each

        name = "StepDisturbance.force"
        force = real_array(name, self.force, "(n,)", 1)
        require_shape(name, force, (sizes.states,), "(n,)")
        total = np.zeros((len(A), sizes.states, 1))
        B = np.broadcast_to(force[:, None], total.shape)
        for i in range(tau.shape[1]):
            Phi, Gamma = discretise_each(*map(read_only, (A[:, i], B, tau[:, i])))
            total = Phi @ total + Gamma
        return total


def _filter(kept: list[float], fresh: list[float], c: float) -> list[float]:
    """c_{i+1} = kept_i c_i + fresh_i."""
    path = []
    for factor, more in zip(kept, fresh, strict=True):
        c = factor * c + more
        path.append(c)
    return path


def _accumulate(A: np.ndarray, W: np.ndarray, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Transition and covariance over pieces, W being the intensity in all of them."""
    M = np.broadcast_to(np.eye(len(W)), (len(A), *W.shape))
    Q = np.zeros(M.shape)
    for i in range(tau.shape[1]):
        Phi = transitions(A[:, i], tau[:, i])
        M = Phi @ M
        Q = Phi @ Q @ Phi.transpose(0, 2, 1) + noise_covariances(A[:, i], W, tau[:, i])
    return M, Q
