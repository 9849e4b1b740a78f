"""The ideal loop at the limit of stability; see `deadtime.spectrum.response`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deadtime.feedback import Law
from deadtime.plant import SwitchedSystem
from deadtime.spectrum.ideal import IdealLoop
from deadtime.spectrum.response import LoopResponse, offsets_of


@dataclass(frozen=True, eq=False)
class IdealResponse(LoopResponse):
    """A plant in one mode under a law updated continuously (immutable)."""

    loop: IdealLoop
    F: Float[np.ndarray, "m n"]
    radius: float
    offsets: Float[np.ndarray, " m"]

    @classmethod
    def of(cls, plant: SwitchedSystem, law: Law, mode: int) -> IdealResponse:
        """The loop with one mode held."""
        loop = IdealLoop.of(plant, law, mode)
        return cls(loop, loop.F, loop.radius(0.0, any_delay=True), offsets_of(plant, mode))

    @property
    def taps(self) -> float:
        return self.loop.lead

    @property
    def highest(self) -> float:
        return self.radius

    def free(self, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        unit = np.eye(self.loop.A.shape[0])
        z = 1j * omega[:, None, None] * unit
        return z - self.loop.A, np.broadcast_to(1j * unit, z.shape)

    def law(self, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        W, slope = self.loop.memory(1j * omega)
        return np.eye(W.shape[1]) - W, -1j * slope

    def even_law(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        return self.law((np.arange(count) + 0.5) / count * self.highest)

    def arriving(
        self, inputs: slice | np.ndarray, omega: np.ndarray, delay: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        rate, after = (-1j * part[:, None, None] for part in (omega, delay))
        p = np.exp(rate * delay[:, None, None]) * self.loop.B[:, inputs]
        return p, after * p, rate * p

    @property
    def cuts(self) -> Float[np.ndarray, " cut"]:
        return np.zeros(1)

    @property
    def period(self) -> float | None:
        return None
