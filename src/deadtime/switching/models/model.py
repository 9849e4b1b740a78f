"""What random models of switching share: how their signals are drawn."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, final

import numpy as np

from deadtime.base.checks import read_only
from deadtime.base.frozen import Frozen
from deadtime.switching.batch import SignalBatch
from deadtime.switching.signal import SwitchingSignal

if TYPE_CHECKING:
    from deadtime.switching.models.jump_process import JumpProcess


class JumpModel(Frozen, ABC):
    """A random model of switching, each signal of which is a function of a seed and a number."""

    @property
    @abstractmethod
    def process(self) -> JumpProcess:
        """The jumps that are drawn."""

    @final
    def sample(self, horizon: float, seed: int = 0) -> SwitchingSignal:
        """A signal on [0, horizon), which starts with a whole sojourn: number 0 of `draw`.

        The same seed gives the same signal; a longer horizon continues it.

        Raises
        ------
        ArgumentError
            If the horizon is not positive, the seed is negative, or there would be too many
            switches.
        """
        return self.draw(horizon, seed)[0]

    @final
    def draw(self, horizon: float, seed: int = 0, first: int = 0, count: int = 1) -> SignalBatch:
        """The signals of scenarios first, …, first + count − 1 on [0, horizon), in one batch.

        A scenario's signal is a function of the model, `seed` and its number only, whatever else
        is drawn with it; a longer horizon continues it.

        Parameters
        ----------
        horizon : float
            The signals end here, seconds.
        seed : int
            At least 0.
        first, count : int
            Number of the first scenario, at least 0, and how many, at least 1.

        Raises
        ------
        ArgumentError
            If the horizon is not positive, an integer is out of its range, or the batch would
            hold too many switches.

        Examples
        --------
        >>> from deadtime.switching import Markov
        >>> model = Markov([[0.0, 2.0], [1.0, 0.0]])
        >>> batch = model.draw(10.0, seed=1, count=1000)
        >>> (batch[700].times == model.draw(10.0, seed=1, first=700)[0].times).all()
        np.True_
        """
        drawn = self.process.draw(horizon, seed, first, count)
        ends, ages = np.full(count, float(horizon)), np.zeros(count)
        # Nobody else has these arrays, so that the batch need not copy them.
        return SignalBatch(*map(read_only, (*drawn, ends, ages)))
