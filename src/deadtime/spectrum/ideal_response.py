"""The ideal loop at the limit of stability; see `deadtime.spectrum.response`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deadtime.spectrum.ideal import IdealLoop
from deadtime.spectrum.response import Response


@dataclass(frozen=True, eq=False)
class IdealResponse(Response):
    """A plant in one mode under a law updated continuously (immutable)."""

    loop: IdealLoop
    F: Float[np.ndarray, "m n"]
    radius: float

    @classmethod
    def of(cls, loop: IdealLoop) -> IdealResponse:
        """The response of a loop; its own true delay plays no part."""
        return cls(loop, loop.F, loop.radius(0.0, any_delay=True))

    @property
    def memory(self) -> float:
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

    def delay_line(
        self, omega: np.ndarray, delay: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        rate, after = (-1j * part[:, None, None] for part in (omega, delay))
        p = np.exp(rate * delay[:, None, None]) * self.loop.B
        return p, after * p, rate * p

    @property
    def cuts(self) -> Float[np.ndarray, " cut"]:
        return np.zeros(1)

    @property
    def period(self) -> float | None:
        return None
