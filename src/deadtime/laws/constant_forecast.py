"""The common part of the laws that forecast constant systems, from now or from a dwell time on."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float

from deadtime.feedback import Feedback, Forecast, Functional
from deadtime.feedback.law import TableLaw, cache_table
from deadtime.feedback.table import Known
from deadtime.plant import SwitchedSystem
from deadtime.switching import SwitchingSignal

# Systems as the modes of a plant, the gain of each and its weight.
Future = tuple[SwitchedSystem, Float[np.ndarray, "system m n"], Float[np.ndarray, " system"]]


@dataclass(frozen=True, eq=False, repr=False)
class ConstantForecast(TableLaw):
    """A law of the weighted predictions Σ_s w_s K_s P_s, in each of which one system s is held.

    With a dwell time the prediction first holds the plant's present mode for the rest of it.
    """

    dwell_time: float | None = field(default=None, init=False)

    @property
    @abstractmethod
    def _future(self) -> Future:
        """The systems that are held, their gains and weights."""

    @cache_table
    def digital(
        self, step: float, signal: SwitchingSignal | None = None, steps: int | None = None
    ) -> Feedback:
        if self.dwell_time is None:
            from deadtime.laws.tables.along_signal import constant_table

            return constant_table(*self._future, step)
        from deadtime.laws.tables.guaranteed_dwell import dwelling_table

        return dwelling_table(self.plant, *self._future, self.dwell_time, step)

    def spread(
        self, step: float, known: Known, W: Float[np.ndarray, "*mode n n"]
    ) -> Float[np.ndarray, "case input future n n"]:
        from deadtime.laws.spread import dwelling_spread, held_spread

        after, _, _ = self._future
        W_after = W if W.ndim == 2 or len(W) == after.modes else W.mean(axis=0)
        if self.dwell_time is None:
            return held_spread(after, known, W_after)
        return dwelling_spread(self.plant, after, self.dwell_time, step, known, W, W_after)

    def ideal(self, signal: SwitchingSignal, horizon: float) -> Functional | Forecast:
        if self.dwell_time is None:
            return self._settled
        after = self._future
        return Forecast.dwelling(self.plant, *after, self.dwell_time, signal, self._settled)

    @cached_property
    def _settled(self) -> Functional:
        from deadtime.laws.tables.windows import constant_functional

        return constant_functional(*self._future)
