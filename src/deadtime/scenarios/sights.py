"""What laws are shown that measure within periods: a delay of measurements, and jitter.

A measurement t seconds into a period is x(t_k + t) = M z, z being the state at the sample and what
acts in the period: the first n rows of what a period that ends there does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deadtime.imperfections import Imperfection, Sizes, TimingImperfection
from deadtime.imperfections.heard import at_samples
from deadtime.numerics.lanes.code import LANES
from deadtime.scenarios.cut_periods import WIDE
from deadtime.scenarios.drawn import InManyRuns, in_many_runs
from deadtime.scenarios.loop import Loop
from deadtime.scenarios.records import Records
from deadtime.scenarios.side_by_side import groups
from deadtime.simulation.compiled import Lags
from deadtime.switching import SignalBatch


@dataclass(frozen=True, eq=False)
class Sights:
    """The maps M of a block of scenarios, laid a few scenarios at a time.

    laid : (group, sample, n, z, lane), flat, or None where all is measured at samples
    """

    loop: Loop
    kinds: Sequence[InManyRuns]
    laid: np.ndarray | None

    @classmethod
    def of(
        cls, loop: Loop, imperfections: Sequence[Imperfection], seed: int, first: int, count: int
    ) -> Sights | None:
        """Those of scenarios first, …; None where no imperfection changes when x is measured."""
        kinds = in_many_runs(imperfections, TimingImperfection, seed, first, count)
        if not kinds:
            return None
        samples, nobody = loop.whole + 1, np.empty((1, 0))
        sizes, step = Sizes.of(loop.plant, loop.step), loop.step
        if all(each.is_fixed(sizes, samples) for each in kinds):
            fixed = [each.lags(0, nobody, sizes, samples) for each in kinds]
            _, offset = _sum(kinds, fixed).instants(step, samples)
            if not offset.any():
                return cls(loop, kinds, None)
        size = groups(count) * samples * LANES * loop.plant.states * loop.acting.wide
        return cls(loop, kinds, np.zeros(size))

    def lay(
        self, signals: SignalBatch, records: Records, begin: int, few: int, heard: np.ndarray
    ) -> np.ndarray:
        """Lay the maps of scenarios begin, …, begin + few − 1 of the block.

        `heard` (scenario or 1, sample) is whose measurement is heard; returns the periods in which
        these are taken, −1 for none.
        """
        from deadtime.scenarios.laid_sights import lay_sights

        loop, samples = self.loop, self.loop.whole + 1
        step, tables = loop.step, loop.tables
        sizes = Sizes.of(loop.plant, step)
        rooms = [each.room(sizes, samples, few) for each in self.kinds]
        lags = [
            each.lags(begin, room, sizes, samples)
            for each, room in zip(self.kinds, rooms, strict=True)
        ]
        period, offset = _sum(self.kinds, lags).instants(step, samples)
        whole = max(len(heard), len(period)), samples
        period, offset = (np.broadcast_to(part, (len(part), samples)) for part in (period, offset))
        period = np.where(heard < 0, -1, at_samples(period, heard))
        offset = np.where(period < 0, 0.0, at_samples(offset, heard))
        assert period.shape == offset.shape == whole
        assert tables is not None
        if self.laid is not None:
            _, n, m = loop.acting.B.shape
            width = (0.0,) * -(-(n * n + n * m) // WIDE)
            flat = tables.pieces, step / tables.pieces.shape[1], width
            place = period, offset, begin, few
            lay_sights(self.laid, *place, records, signals.modes, loop.acting, n, *flat)
        return period


def _sum(kinds: Sequence[InManyRuns], lags: Sequence[np.ndarray]) -> Lags:
    """The lags of several, those that wait apart from the others."""
    sums = [np.zeros((1, 1)), np.zeros((1, 1))]
    for each, more in zip(kinds, lags, strict=True):
        assert isinstance(each.one, TimingImperfection)
        place = 0 if each.one.waits else 1
        sums[place] = sums[place] + more
    return Lags(*sums)
