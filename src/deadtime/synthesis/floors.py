"""What a design may be asked to keep: a delay margin, a decay rate, and a limit of the inputs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deadtime.synthesis.initial_states import InitialStates
from deadtime.synthesis.stationary_noise import StationaryNoise

MARGIN, DECAY, LIMIT = "margin", "decay rate", "input limit"
_LEAST = 1e-9  # of a floor: less is not told apart


@dataclass(frozen=True)
class Floors:
    """What a design must have at least.

    margin : relative to the delay; 0 where none is asked for
    decay_rate : of the slowest constant mode, 1/s; 0 where none is asked for
    input_limit : (m,), what |u_j| must stay below; None where nothing is asked
    initial : the states at the start, or the noise, for which it must
    """

    margin: float
    decay_rate: float = 0.0
    input_limit: Float[np.ndarray, " m"] | None = None
    initial: InitialStates | StationaryNoise | None = None

    @property
    def asked(self) -> tuple[str, ...]:
        """The names of what is asked for."""
        parts = ((MARGIN, self.margin), (DECAY, self.decay_rate), (LIMIT, self.limited))
        return tuple(name for name, floor in parts if floor)

    @property
    def limited(self) -> bool:
        """Whether the inputs have a limit."""
        return self.input_limit is not None

    def load(self, peak: Float[np.ndarray, " m"] | None) -> float:
        """The largest peak beside its limit; 0 without limits.

        Examples
        --------
        >>> Floors(0.05, input_limit=np.array([10.0, 2.0])).load(np.array([5.0, 3.0]))
        1.5
        """
        if self.input_limit is None or peak is None:
            return 0.0
        return float((peak / self.input_limit).max())

    def shortfalls(self, margin: float, decay_rate: float, load: float = 0.0) -> tuple[str, ...]:
        """The names of the floors that a margin, a decay rate and a load fall short of.

        Examples
        --------
        >>> Floors(0.05, 2.0).shortfalls(margin=0.06, decay_rate=1.5)
        ('decay rate',)
        """
        pairs = ((MARGIN, margin, self.margin), (DECAY, decay_rate, self.decay_rate))
        missed = tuple(name for name, value, floor in pairs if floor and value < floor)
        return (*missed, LIMIT) if load > 1.0 else missed

    def shortfall(
        self, margin: float, decay_rate: float, slack: float = 1.0, load: float = 0.0
    ) -> float:
        """By how much they fall short in all: the logarithms of floor over value, summed.

        Examples
        --------
        >>> round(Floors(0.05, 2.0).shortfall(margin=0.06, decay_rate=1.0), 4)   # log 2
        0.6931
        """
        pairs = ((margin, slack * self.margin), (decay_rate, slack * self.decay_rate))
        parts = [value / floor for value, floor in pairs if floor]
        parts += [1.0 / (slack * load)] if load else []
        return -sum(math.log(min(max(part, _LEAST), 1.0)) for part in parts)
