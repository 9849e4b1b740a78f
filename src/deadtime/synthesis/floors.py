"""The two floors that a design may be asked to keep: a delay margin and a decay rate."""

from __future__ import annotations

import math
from dataclasses import dataclass

MARGIN, DECAY = "margin", "decay rate"
_LEAST = 1e-9  # of a floor: less is not told apart


@dataclass(frozen=True)
class Floors:
    """What a design must have at least.

    margin : relative to the delay
    decay_rate : of the slowest constant mode, 1/s; 0 where none is asked for
    """

    margin: float
    decay_rate: float = 0.0

    def shortfalls(self, margin: float, decay_rate: float) -> tuple[str, ...]:
        """The names of the floors that a margin and a decay rate fall short of.

        Examples
        --------
        >>> Floors(0.05, 2.0).shortfalls(margin=0.06, decay_rate=1.5)
        ('decay rate',)
        """
        pairs = ((MARGIN, margin, self.margin), (DECAY, decay_rate, self.decay_rate))
        return tuple(name for name, value, floor in pairs if floor and value < floor)

    def shortfall(self, margin: float, decay_rate: float, slack: float = 1.0) -> float:
        """By how much they fall short in all: the logarithms of floor over value, summed.

        Examples
        --------
        >>> round(Floors(0.05, 2.0).shortfall(margin=0.06, decay_rate=1.0), 4)   # log 2
        0.6931
        """
        pairs = ((margin, slack * self.margin), (decay_rate, slack * self.decay_rate))
        parts = [value / floor for value, floor in pairs if floor]
        return -sum(math.log(min(max(part, _LEAST), 1.0)) for part in parts)
