"""A law that knows the signal: its model laid along signals, as far ahead as it looks."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import read_only
from deadtime.feedback import Foresight, Law
from deadtime.plant import SampledPlant
from deadtime.scenarios.batch_loop import Loop
from deadtime.scenarios.cut_periods import compose, parts_of
from deadtime.scenarios.laid import compose_cuts
from deadtime.scenarios.preview_lanes import KnownSignalModel
from deadtime.scenarios.records import Laid, Records
from deadtime.switching import SignalBatch, SwitchingSignal


class ModelAhead:
    """The model of a law over the periods 0, …, K + W, W = ⌊D/h⌋ (`scenarios.preview_lanes`).

    Attributes
    ----------
    loop : Loop
        What it does in a period; of no plant's state.
    """

    def __init__(self, law: Law, sampled: SampledPlant, samples: int) -> None:
        window, n = sampled.window, sampled.plant.states
        self._law, self._step, self._samples = law, window.step, samples
        self._foresight = self._ask(SwitchingSignal.constant(0))
        whole = window.phase >= window.step
        self._length = window.count if whole else window.count - 1
        self._rest = 0.0 if whole else window.phase
        self.loop = Loop(sampled, np.zeros(n), (samples - 1 + self._length) * window.step)

    def lay(self, signals: SignalBatch) -> KnownSignalModel:
        """The model along signals; an error where one is not known as far as the law looks."""
        self._ask(signals[int(signals.end.argmin())])
        return self._own if self._law.foreseen is not None else self._lay(signals)

    @cached_property
    def _own(self) -> KnownSignalModel:
        """The model along the signal that the law believes in, the same in all scenarios."""
        assert self._law.foreseen is not None
        return self._lay(SignalBatch.of([self._law.foreseen]))

    def lay_nothing(self) -> KnownSignalModel:
        """The model along no signals, which compiles what `lay` needs but for the laying itself."""
        return self._model(self.loop.lay_nothing(), read_only(np.zeros(0, np.int64)))

    def _lay(self, signals: SignalBatch) -> KnownSignalModel:
        return self._model(self.loop.lay(signals), signals.modes)

    def _model(self, laid: Laid, sampled: Int[np.ndarray, " sojourn"]) -> KnownSignalModel:
        loop, records = self.loop, laid.records
        tails = np.concatenate((self._own_tails, self._tails_of_cuts(records, sampled)))
        first, step, which = records.first, records.step, records.map
        return KnownSignalModel(
            self._length, loop.acting.lags, laid.maps, first, step, which, tails
        )

    def _tails_of_cuts(
        self, records: Records, sampled: Int[np.ndarray, " sojourn"]
    ) -> Float[np.ndarray, "cut tail"]:
        """Those of cut periods: over the first seconds, up to t_k + D, then by the gain there."""
        loop, tables = self.loop, self.loop.tables
        assert tables is not None
        n, m, wide = loop.plant.states, loop.plant.inputs, loop.acting.wide
        last, cuts = records.sojourn.astype(np.int64), records.sojourn.size
        begun = last + 1 < records.until
        while begun.any():
            begun[begun] = records.at[last[begun] + 1] <= self._rest
            last += begun
            begun &= last + 1 < records.until
        moves = np.eye(n, wide)[None]
        if self._rest > 0.0:
            maps, which, end = (
                np.empty((cuts, tables.width)),
                np.arange(cuts),
                np.full(cuts, self._rest),
            )
            given = end, records, sampled, loop.acting, tables.pieces, loop.step
            compose_cuts(maps, which, last + 1, *given)
            moves = maps[:, : n * wide].reshape(cuts, n, wide)
        gains, tails = self._foresight.gains[sampled[last]], np.zeros((cuts, m, n + m))
        tails[:, :, n:] += self._foresight.latest
        for j in range(n):
            tails += gains[:, :, j, None] * moves[:, None, j, : n + m]
        return tails.reshape(cuts, m * (n + m))

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
