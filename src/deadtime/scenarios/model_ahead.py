"""A law that knows the signal: its model laid along signals, as far ahead as it looks."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from jaxtyping import Int

from deadtime.base.checks import read_only
from deadtime.feedback import Foresight
from deadtime.feedback.law import TableLaw
from deadtime.plant import SampledPlant
from deadtime.scenarios.cut_periods import WIDE, compose, parts_of
from deadtime.scenarios.foreseen import Model, fill_tails
from deadtime.scenarios.loop import Loop
from deadtime.scenarios.records import Laid
from deadtime.switching import SignalBatch, SwitchingSignal


class ModelAhead:
    """The model of a law over the periods 0, …, K + W, W = ⌊D/h⌋ (`scenarios.foreseen`).

    Attributes
    ----------
    loop : Loop
        What it does in a period; of no plant's state.
    """

    def __init__(self, law: TableLaw, sampled: SampledPlant, samples: int) -> None:
        window, n = sampled.window, sampled.plant.states
        self._law, self._step, self._samples = law, window.step, samples
        self._foresight = self._ask(SwitchingSignal.constant(0))
        whole = window.phase >= window.step
        self._length = window.count if whole else window.count - 1
        self._rest = 0.0 if whole else window.phase
        self.loop = Loop(sampled, np.zeros(n), (samples - 1 + self._length) * window.step)

    def lay(self, signals: SignalBatch) -> Model:
        """The model along signals; an error where one is not known as far as the law looks."""
        self._ask(signals[int(signals.end.argmin())])
        return self._own if self._law.foreseen is not None else self._lay(signals)

    @cached_property
    def _own(self) -> Model:
        """The model along the signal that the law believes in, the same in all scenarios."""
        assert self._law.foreseen is not None
        return self._lay(SignalBatch.of([self._law.foreseen]))

    def lay_nothing(self) -> Model:
        """The model along no signals, which compiles what `lay` needs but for the laying itself."""
        return self._model(self.loop.lay_nothing(), read_only(np.zeros(0, np.int64)))

    def _lay(self, signals: SignalBatch) -> Model:
        return self._model(self.loop.lay(signals), signals.modes)

    def _model(self, laid: Laid, sampled: Int[np.ndarray, " sojourn"]) -> Model:
        loop, records, tables = self.loop, laid.records, self.loop.tables
        assert tables is not None
        modes = len(self._own_tails)
        tails = np.empty((laid.maps.shape[0], self._own_tails.shape[1]))
        tails[:modes] = self._own_tails
        fill_tails(
            tails,
            self._foresight.gains,
            self._foresight.latest,
            records,
            sampled,
            self._rest,
            loop.step,
            loop.acting,
            tables.pieces,
            (0.0,) * (tables.pieces.shape[-1] // WIDE),
        )
        first, step, which = records.first, records.step, records.map
        return Model(self._length, loop.acting.lags, laid.maps, first, step, which, tails)

    def _ask(self, signal: SwitchingSignal) -> Foresight:
        found = self._law.foresight(self._step, signal, self._samples)
        assert found is not None
        return found

    @cached_property
    def _own_tails(self) -> np.ndarray:
        """The tails of modes that no switch cuts."""
        loop, plant = self.loop, self.loop.plant
        n, m, tails = plant.states, plant.inputs, []
        moves = np.tile(np.eye(n, loop.acting.wide), (plant.modes, 1, 1))
        if self._rest > 0.0:
            modes = range(plant.modes)
            periods = [parts_of(plant, loop.acting, i, 0.0, self._rest) for i in modes]
            moves = compose(plant, loop.acting, periods, loop.acting.wide).move
        for K, move in zip(self._foresight.gains, moves, strict=True):
            tail = K @ move[:, : n + m]
            tail[:, n:] += self._foresight.latest
            tails.append(tail.ravel())
        return np.array(tails)
