"""When the state is measured: a measurement delay beside the input delay, and jitter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from deadtime.base.checks import positive
from deadtime.base.errors import ArgumentError
from deadtime.imperfections.base import DrawnTiming, Sizes


@dataclass(frozen=True)
class MeasurementDelay(DrawnTiming):
    """The law is told x(t_k − d) at t_k, nothing before t = d; the mode comes in time.

    A law whose model has the delay D + d makes up for it: its prediction starts d earlier.

    Parameters
    ----------
    delay : float
        d > 0, seconds, any fraction of the step.
    """

    waits: ClassVar[bool] = True
    delay: float

    def count(self, sizes: Sizes, samples: int) -> int:
        return 0

    def lags_from(self, numbers: np.ndarray, sizes: Sizes, samples: int) -> np.ndarray:
        delay = positive("MeasurementDelay.delay", self.delay)
        return np.full((*numbers.shape[:-1], 1), delay)


@dataclass(frozen=True)
class Jitter(DrawnTiming):
    """Samples are taken up to `most` seconds early, uniformly, and used as if they were not.

    The first is taken at time 0.

    Parameters
    ----------
    most : float
        0 < most ≤ step, seconds; beyond a period, samples are late: `LateSamples`.
    """

    waits: ClassVar[bool] = False
    most: float

    def count(self, sizes: Sizes, samples: int) -> int:
        return samples

    def lags_from(self, numbers: np.ndarray, sizes: Sizes, samples: int) -> np.ndarray:
        most = positive("Jitter.most", self.most)
        if most > sizes.step * (1.0 + 1e-9):
            raise ArgumentError(
                f"Jitter.most must be at most one period, {sizes.step:g} s, got {most:g}: samples "
                "that come later are LateSamples."
            )
        return most * numbers
