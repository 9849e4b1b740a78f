"""One delay window [t − D, t] of a switched plant, worked out piece by piece with SciPy's expm.

Shares no code with the certificates. Pieces are those between switches and jumps of the input:
on piece p the future mode σ(θ + D) is `modes[p]` and the input U(θ) is `inputs[p]`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

import deadtime as dt
import plants

NODES, WEIGHTS = np.polynomial.legendre.leggauss(12)
NODES, WEIGHTS = (NODES + 1.0) / 2.0, WEIGHTS / 2.0


@dataclass
class Window:
    """X(t), and modes and inputs on pieces of the window, oldest first."""

    plant: dt.SwitchedSystem
    gains: np.ndarray
    x: np.ndarray
    lengths: np.ndarray
    modes: np.ndarray
    inputs: np.ndarray
    last: int  # σ(t + D)

    def future(self, model: int | None = None) -> np.ndarray:
        """P(t) = x(t + D); with `model` the predictor of that one mode."""
        x = self.x
        for length, mode, u in zip(self.lengths, self.modes, self.inputs, strict=True):
            i = mode if model is None else model
            Phi, Gamma = plants.held(self.plant.A[i], self.plant.B[i], length)
            x = Phi @ x + Gamma @ u
        return x

    def law(self) -> np.ndarray:
        """U(t) of the averaged predictor feedback."""
        modes = range(self.plant.modes)
        return np.mean([self.gains[i] @ self.future(i) for i in modes], axis=0)

    def mismatch(self) -> np.ndarray:
        """W(t) = U(t) − K_σ(t+D) P(t)."""
        return self.law() - self.gains[self.last] @ self.future()

    def input_norms(self) -> tuple[float, float]:
        """∫|U| and ∫|U|²."""
        size = np.linalg.norm(self.inputs, axis=1)
        return float(self.lengths @ size), float(self.lengths @ size**2)

    def transformed(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Nodes r = t − θ, weights and |W| for integrals of W over the window, and W(t − D)."""
        x, past, first = self.x, 0.0, None
        ages, weights, sizes = [], [], []
        for length, i, u in zip(self.lengths, self.modes, self.inputs, strict=True):
            A, B, K = self.plant.A[i], self.plant.B[i], self.gains[i]
            first = u - K @ x if first is None else first
            for node, weight in zip(NODES, WEIGHTS, strict=True):
                Phi, Gamma = plants.held(A, B, node * length)
                ages.append(self.plant.delay - past - node * length)
                weights.append(weight * length)
                sizes.append(np.linalg.norm(u - K @ (Phi @ x + Gamma @ u)))
            Phi, Gamma = plants.held(A, B, length)
            x, past = Phi @ x + Gamma @ u, past + length
        assert first is not None
        return np.array(ages), np.array(weights), np.array(sizes), first


def random_window(plant, gains, seed, pieces=5, quiet=False):
    """A window with random modes and inputs; `quiet` makes U the inverse image of a random W."""
    rng = np.random.default_rng(seed)
    lengths = rng.dirichlet(np.ones(pieces)) * plant.delay
    modes = rng.integers(plant.modes, size=pieces)
    x = rng.normal(size=plant.states) * 10.0 ** rng.uniform(-2, 2)
    inputs = rng.normal(size=(pieces, plant.inputs)) * 10.0 ** rng.uniform(-2, 2, (pieces, 1))
    window = Window(plant, gains, x, lengths, modes, inputs, int(rng.integers(plant.modes)))
    if quiet:  # inputs near K_σ P, so that W is small: the regime of a closed loop
        y = x
        for p, (length, i) in enumerate(zip(lengths, modes, strict=True)):
            inputs[p] = gains[i] @ y * (1.0 + 0.1 * rng.normal())
            Phi, Gamma = plants.held(plant.A[i], plant.B[i], length)
            y = Phi @ y + Gamma @ inputs[p]
    return window


def product(matrices: np.ndarray, lengths: np.ndarray, modes: np.ndarray) -> np.ndarray:
    """∏ e^{M_m τ}, the latest mode leftmost."""
    result = np.eye(matrices.shape[1])
    for length, mode in zip(lengths, modes, strict=True):
        result = expm(matrices[mode] * length) @ result
    return result
