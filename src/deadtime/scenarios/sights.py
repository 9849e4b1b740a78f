"""What laws are shown that measure within periods: a delay of measurements, and jitter.

A measurement t seconds into a period is x(t_k + t) = M z, z being the state at the sample and what
acts in the period: the first n rows of what a period that ends there does. In a period that no
switch cuts M is a series in t, M = Σ_d M_d δ^d with δ ∈ [−1, 1] the place in a cell, and so is
M z = Σ_d (M_d z) δ^d: the loop keeps the M_d of each scenario's mode. What is measured in a cut
period has its own M.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from deadtime.imperfections import Imperfection, Sizes, TimingImperfection
from deadtime.numerics.lanes.code import LANES
from deadtime.plant import SampledPlant
from deadtime.scenarios.acting import acting_of
from deadtime.scenarios.batch_loop import Loop
from deadtime.scenarios.cut_periods import compose, nodes, parts_of, series_through, stack
from deadtime.scenarios.drawn import InManyRuns, in_many_runs
from deadtime.scenarios.lane_types import SightLanes
from deadtime.scenarios.records import Records
from deadtime.scenarios.rooms import Rooms
from deadtime.scenarios.side_by_side import groups
from deadtime.simulation.loop_arrays import MeasurementLags
from deadtime.switching import SignalBatch


@dataclass(frozen=True, eq=False)
class Sights:
    """Where the measurements of a block of scenarios lie, laid a few scenarios at a time.

    row, place, news : as `layout.Sight` has them, or None where all is measured at samples
    cuts : the M of measurements in cut periods, a few scenarios' each
    """

    loop: Loop
    kinds: Sequence[InManyRuns]
    row: np.ndarray | None
    place: np.ndarray | None
    news: np.ndarray | None
    rooms: Rooms
    cuts: list[np.ndarray] = field(default_factory=list)

    @classmethod
    def of(
        cls,
        loop: Loop,
        imperfections: Sequence[Imperfection],
        seed: int,
        first: int,
        count: int,
        rooms: Rooms,
    ) -> Sights | None:
        """Those of scenarios first, …; None where no imperfection changes when x is measured."""
        kinds = in_many_runs(imperfections, TimingImperfection, seed, first, count, rooms)
        if not kinds:
            return None
        samples, nobody = loop.whole + 1, np.empty((1, 0))
        sizes, step = Sizes.of(loop.plant, loop.step), loop.step
        if all(each.is_fixed(sizes, samples) for each in kinds):
            fixed = [each.lags(0, nobody, sizes, samples) for each in kinds]
            _, offset = _sum(kinds, fixed).instants(step, samples)
            if not offset.any():
                return cls(loop, kinds, None, None, None, rooms)
        periods = groups(count) * samples
        size, news = (periods * LANES,), rooms.of("news", (periods,), np.bool_)
        news.fill(False)
        return cls(
            loop, kinds, rooms.of("row", size, np.int32), rooms.of("place", size), news, rooms
        )

    def lay(
        self,
        signals: SignalBatch,
        records: Records,
        begin: int,
        few: int,
        heard: np.ndarray,
        lag: np.ndarray,
        reach: int,
    ) -> int:
        """Lay the measurements of scenarios begin, …, begin + few − 1 of the block.

        `heard` (scenario or 1, sample) is whose measurement is heard; `lag`, which is filled for
        these scenarios, and `reach`, which is returned, are as `layout.Relayed` has them.
        """
        from deadtime.scenarios.laid_sights import find_instants, lay_periods, lay_places

        loop, samples = self.loop, self.loop.whole + 1
        sizes, edges = Sizes.of(loop.plant, loop.step), loop.acting.edges
        lags = _sum(
            self.kinds,
            [
                each.lags(begin, each.room(sizes, samples, few), sizes, samples)
                for each in self.kinds
            ],
        )
        runs = max(map(len, lags))
        shape, rooms = (runs, samples), self.rooms
        period, offset = rooms.of("period", shape, np.int64), rooms.of("offset", shape)
        find_instants(*lags, loop.step, period, offset)
        reach = lay_periods(lag, reach, heard, period, begin, few)
        if self.row is not None:
            modes, most = loop.plant.modes, (few + -few % LANES) * samples
            cut, when = rooms.of("cut", (most,), np.int32), rooms.of("when", (most,))
            series = modes * (edges.size - 1) * loop.cells
            noted = lay_places(
                self.row, self.place, self.news, lag, heard, offset, begin, few, records, modes,
                edges, loop.cells, series + sum(map(len, self.cuts)), cut, when,
            )  # fmt: skip
            self.cuts.append(loop.moves(records, signals.modes, cut[:noted], when[:noted]))
        return reach

    def sight(self) -> SightLanes | None:
        """All that was laid."""
        if self.row is None or self.place is None or self.news is None:
            return None
        series = sight_series(self.loop.sampled, self.loop.cells, self.loop.forced)
        cuts = np.concatenate(self.cuts) if self.cuts else np.empty((0, *series.shape[2:]))
        # Where no switch comes before a measurement there are no cuts.
        flat = series.reshape(len(series), -1), cuts.reshape(len(cuts), math.prod(cuts.shape[1:]))
        return SightLanes(*flat, self.row, self.place, self.news)


@lru_cache(8)
def sight_series(
    sampled: SampledPlant, cells: int, forced: bool = False
) -> Float[np.ndarray, "row degree n z"]:
    """The M_d of a plant's modes, in each part of a period (`Acting.edges`) cell by cell."""
    plant, acting = sampled.plant, acting_of(sampled, forced)

    def along(mode: int, times: Float[np.ndarray, "cell node"]) -> np.ndarray:
        periods = [parts_of(plant, acting, mode, 0.0, t) for t in times.ravel()]
        return compose(plant, acting, periods, acting.wide).move.reshape(*times.shape, -1)

    size = plant.states * acting.wide
    values = stack(
        [
            series_through(along(i, nodes(*span, cells)))
            for i in range(plant.modes)
            for span in itertools.pairwise(acting.edges)
        ]
    )
    return values[..., :size].reshape(-1, values.shape[2], plant.states, acting.wide).copy()


def _sum(kinds: Sequence[InManyRuns], lags: Sequence[np.ndarray]) -> MeasurementLags:
    """The lags of several, those that wait apart from the others."""
    sums = [np.zeros((1, 1)), np.zeros((1, 1))]
    for each, more in zip(kinds, lags, strict=True):
        assert isinstance(each.one, TimingImperfection)
        place = 0 if each.one.waits else 1
        sums[place] = sums[place] + more
    return MeasurementLags(*sums)
