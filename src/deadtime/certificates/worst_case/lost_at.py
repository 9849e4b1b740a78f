"""A sensor that loses the samples of a pattern: how runs show what a witness says."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deadtime.imperfections import SensorImperfection
from deadtime.imperfections.base import Sizes
from deadtime.imperfections.received import Heard, Relaying


@dataclass(frozen=True)
class LostAt(Relaying, SensorImperfection):
    """Loses the samples of a pattern that is gone through again and again.

    Parameters
    ----------
    lost : tuple of int
        The samples of a cycle that are lost.
    periods : int
        The length of the cycle.
    """

    lost: tuple[int, ...]
    periods: int

    def relay(self, heard: Heard, sizes: Sizes, rng: np.random.Generator) -> Heard:
        each = np.arange(heard.samples)
        return heard.at(np.where(np.isin(each % self.periods, self.lost), -1, each))
