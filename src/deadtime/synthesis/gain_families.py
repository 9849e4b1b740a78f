"""Parameters that a search varies, and the gains and filter's time constant that they define.

With a filter the plant has u as a state and v = du/dt as its input,

    d/dt (P, u) = [[A, B], [0, 0]] (P, u) + (0, v),    v = L_x P + L_u u,

which is the low-pass law T du/dt = K P − u with T = −L_u⁻¹ and K = T L_x. All modes have one
filter: L_u is their mean. Every parameter is a logarithm in units of the plant, so that 0 is
typical and a box of a few units holds all sensible values.

With one input the parameters are the poles of every mode, n or n + 1 of them, which describe all
gains; with several, LQR weights.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deadtime.base.frozen import Frozen
from deadtime.plant import SwitchedSystem

_FILTERS = (0.02, 0.06, 0.2)  # of the delay: time constants of the first designs


@dataclass(frozen=True, eq=False)
class Choice(Frozen):
    """Gains (modes, m, n), and the filter's T (m, m) or None."""

    gains: Float[np.ndarray, "mode m n"]
    time_constant: Float[np.ndarray, "m m"] | None


@dataclass(frozen=True, eq=False)
class ChoiceFamily(ABC):
    """A map from parameters (modes, size) to a `Choice`."""

    plant: SwitchedSystem
    filtered: bool

    @property
    @abstractmethod
    def size(self) -> int:
        """Parameters per mode."""

    @property
    @abstractmethod
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """The box of the samples: low and high, (size,)."""

    @abstractmethod
    def starts(self, gains: Float[np.ndarray, "mode m n"]) -> list[np.ndarray]:
        """Parameters (modes, size) of given gains, or close to them."""

    @abstractmethod
    def feedback(
        self, mode: int, parameters: np.ndarray, A: np.ndarray, B: np.ndarray
    ) -> np.ndarray:
        """The gain of (A, B), the mode itself or with its input as a state."""

    def choice(self, parameters: np.ndarray) -> Choice | None:
        """The gains of parameters (modes, size); None if there are none."""
        plant, m, n = self.plant, self.plant.inputs, self.plant.states
        L = []
        for mode in range(plant.modes):
            A, B = plant.A[mode], plant.B[mode]
            if self.filtered:
                A = np.block([[A, B], [np.zeros((m, n + m))]])
                B = np.concatenate((np.zeros((n, m)), np.eye(m)))
            L.append(self.feedback(mode, parameters[mode], A, B))
        found = np.stack(L)
        if not np.isfinite(found).all():
            return None
        if not self.filtered:
            return Choice(found, None)
        rate = -found[:, :, n:].mean(axis=0)
        if np.linalg.eigvals(rate).real.min() <= 0.0:
            return None
        T = np.linalg.inv(rate)
        return Choice(T @ found[:, :, :n], T)


@dataclass(frozen=True, eq=False)
class Poles(ChoiceFamily):
    """Poles for one input, as factors s² + 2ζω s + ω² and, of an odd count, s + ω; log ω, log ζ."""

    @property
    def size(self) -> int:
        return self.plant.states + self.filtered

    @property
    def unit(self) -> float:
        return max(
            float(np.abs(np.linalg.eigvals(self.plant.A)).max()), 0.3 / self.plant.longest_delay
        )

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        pairs = self.size // 2
        low, high = [-3.0, math.log(0.3)] * pairs, [1.5, math.log(3.0)] * pairs
        if self.size % 2:
            low, high = [*low, -2.0], [*high, 3.5]
        return np.array(low), np.array(high)

    def starts(self, gains: Float[np.ndarray, "mode m n"]) -> list[np.ndarray]:
        plant = self.plant
        closed = np.linalg.eigvals(plant.A + plant.B @ gains)
        unit = plant.longest_delay
        extra = [[-1.0 / (part * unit)] for part in _FILTERS] if self.filtered else [[]]
        return [np.stack([self._encode(np.append(row, more)) for row in closed]) for more in extra]

    def _encode(self, poles: np.ndarray) -> np.ndarray:
        """Parameters of poles, reflected into the open left half plane."""
        re, im = np.real(poles), np.imag(poles)
        re = np.where(re < 0.0, re, -np.abs(re) - 0.1 * self.unit)
        upper = (re + 1j * im)[im > 0.0]
        real = np.sort(re[im == 0.0])[::-1]
        squares = [(abs(p) ** 2, -2.0 * p.real) for p in upper]
        pairs = zip(real[0 : real.size - real.size % 2 : 2], real[1::2], strict=True)
        squares += [(a * b, -a - b) for a, b in pairs]
        result = []
        for product, total in squares:
            omega = math.sqrt(product)
            result += [math.log(omega / self.unit), math.log(0.5 * total / omega)]
        if real.size % 2:
            result.append(math.log(-real[-1] / self.unit))
        return np.array(result)

    def _polynomial(self, parameters: np.ndarray) -> np.ndarray:
        """The coefficients of the characteristic polynomial, the leading 1 first."""
        values = np.exp(np.clip(parameters, -12.0, 12.0))
        result = np.ones(1)
        for omega, zeta in values[: self.size - self.size % 2].reshape(-1, 2):
            omega = omega * self.unit
            result = np.convolve(result, [1.0, 2.0 * zeta * omega, omega**2])
        if self.size % 2:
            result = np.convolve(result, [1.0, values[-1] * self.unit])
        return result

    def feedback(
        self, mode: int, parameters: np.ndarray, A: np.ndarray, B: np.ndarray
    ) -> np.ndarray:
        """Ackermann's formula: K = −e_nᵀ [B AB …]⁻¹ χ(A)."""
        unit, one = self.unit, np.eye(A.shape[0])
        A, columns = A / unit, [B[:, 0]]
        value = np.zeros_like(A)
        for power, c in enumerate(self._polynomial(parameters)):  # Horner's scheme for χ(A)
            value = A @ value + c / unit**power * one
        for _ in range(A.shape[0] - 1):
            columns.append(A @ columns[-1])
        try:
            last = np.linalg.solve(np.stack(columns, axis=1).T, one[-1])
        except np.linalg.LinAlgError:
            return np.full((1, A.shape[0]), np.nan)
        return -(last @ value)[None] * unit


@dataclass(frozen=True, eq=False)
class Weights(ChoiceFamily):
    """LQR weights Q = diag, R = diag (1, …), and with a filter that of (D du/dt)²."""

    @property
    def size(self) -> int:
        return self.plant.states + self.plant.inputs - 1 + self.filtered

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        n, m = self.plant.states, self.plant.inputs
        low, high = [-6.0] * n + [-3.0] * (m - 1), [4.0] * n + [3.0] * (m - 1)
        if self.filtered:
            low, high = [*low, -9.0], [*high, 3.0]
        return np.array(low), np.array(high)

    def starts(self, gains: Float[np.ndarray, "mode m n"]) -> list[np.ndarray]:
        last = 2.0 * np.log(_FILTERS) if self.filtered else np.zeros(1)
        rows = np.zeros((last.size, self.plant.modes, self.size))
        rows[:, :, -1] = last[:, None]  # of (D du/dt)²: (T/D)² for a time constant T
        return list(rows)

    def feedback(
        self, mode: int, parameters: np.ndarray, A: np.ndarray, B: np.ndarray
    ) -> np.ndarray:
        from scipy.linalg import solve_continuous_are

        n, m = self.plant.states, self.plant.inputs
        values = np.exp(np.clip(parameters, -18.0, 18.0))
        R = np.concatenate((np.ones(1), values[n : n + m - 1]))
        states = values[:n]
        if self.filtered:
            states, R = np.concatenate((states, R)), values[-1] * self.plant.longest_delay**2 * R
        try:
            X = solve_continuous_are(A, B, np.diag(states), np.diag(R))
        except ValueError:  # LinAlgError among them
            return np.full(B.T.shape, np.nan)
        return -(B.T @ X) / R[:, None]
