"""Measurements and modes that reach the laws of a block of scenarios, drawn before they run.

A measurement t seconds into a period is x(t_k + t) = M z, z being the state at the sample with the
inputs of the period, and M the map of a period that ends there. Without a switch M is a series in
t, M = Σ_d M_d δ^d with δ ∈ [−1, 1] the place in a cell, and so is M z = Σ_d (M_d z) δ^d: the loop
holds the M_d of each scenario's mode. A measurement in a cut period has its own M.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import DTypeLike

from deadtime.feedback import Feedback
from deadtime.imperfections import Imperfection, ReceivedData, Relaying, Sizes, TimingImperfection
from deadtime.loop.received_samples import (
    AT_SAMPLES,
    MeasurementLags,
    Received,
    fill_lags,
    fill_rows,
    find_instants,
    lags_of_run,
)
from deadtime.numerics.lanes.code import LANES
from deadtime.plant import SampledPlant
from deadtime.scenarios.batch_loop import Loop
from deadtime.scenarios.drawn import InManyRuns, Rooms, in_many_runs
from deadtime.scenarios.lane_types import InstantLanes, MeasurementLanes
from deadtime.scenarios.periods import (
    Records,
    SignalPeriods,
    acting_of,
    compose,
    nodes,
    parts_of,
    series_through,
    stack,
)
from deadtime.scenarios.side_by_side import fill_numbers, from_scenario, groups
from deadtime.switching import SignalBatch


@dataclass(frozen=True, eq=False)
class BlockInstants:
    """Instants of the measurements of a block of scenarios, filled in a few scenarios at a time.

    row, place, news : as in `InstantLanes`, None if x is measured at samples
    cuts : the M of measurements in cut periods, an array per few scenarios
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
    ) -> BlockInstants | None:
        """Those of scenarios first, …; None without imperfections of timing."""
        kinds = in_many_runs(imperfections, TimingImperfection, seed, first, count, rooms)
        if not kinds:
            return None
        samples, nobody = loop.whole + 1, np.empty((1, 0))
        sizes, step = Sizes.of(loop.plant, loop.step), loop.step
        if all(each.is_fixed(sizes, samples) for each in kinds):
            fixed = _sum(kinds, [each.lags(0, nobody, sizes, samples) for each in kinds])
            # Fixed lags of whole periods: x is measured at samples.
            if not lags_of_run(np.arange(samples), fixed, step)[1].any():
                return cls(loop, kinds, None, None, None, rooms)
        periods = groups(count) * samples
        size, news = (periods * LANES,), rooms.of("news", (periods,), np.bool_)
        news.fill(False)
        return cls(
            loop, kinds, rooms.of("row", size, np.int32), rooms.of("place", size), news, rooms
        )

    def fill(
        self,
        signals: SignalBatch,
        records: Records,
        begin: int,
        few: int,
        received: np.ndarray,
        lag: np.ndarray,
        reach: int,
    ) -> int:
        """Place the measurements of scenarios begin, …, begin + few − 1 of the block on periods.

        `received` (scenario or 1, sample): the sample whose measurement arrives. Fills `lag` for
        these scenarios and returns `reach`, both as in `Received`.
        """
        from deadtime.scenarios.by_period import fill_places

        loop, samples = self.loop, self.loop.whole + 1
        sizes, edges = Sizes.of(loop.plant, loop.step), loop.acting.edges
        lags = _sum(
            self.kinds,
            [
                each.lags(begin, each.room(sizes, samples, few), sizes, samples)
                for each in self.kinds
            ],
        )
        size, rooms = (few + -few % LANES) * samples, self.rooms
        shape = max(map(len, lags)), samples
        period, offset = rooms.of("period", shape, np.int64), rooms.of("offset", shape)
        find_instants(*lags, loop.step, period, offset)
        lag = lag[begin * samples :]
        reach = fill_lags(lag, reach, received, period, few, _LANES)
        if self.row is not None:
            cut, when = rooms.of("cut", (size,), np.int32), rooms.of("when", (size,))
            series = loop.plant.modes * (edges.size - 1) * loop.cells
            noted = fill_places(
                self.row, self.place, self.news, lag, received, offset, begin, few, records,
                loop.plant.modes, edges, loop.cells, series + sum(map(len, self.cuts)), cut, when,
            )  # fmt: skip
            self.cuts.append(loop.moves(records, signals.modes, cut[:noted], when[:noted]))
        return reach

    def instants(self) -> InstantLanes | None:
        """The instants that were filled in, None if x is measured at samples."""
        if self.row is None or self.place is None or self.news is None:
            return None
        series = instant_series(self.loop.sampled, self.loop.cells, self.loop.forced)
        cuts = np.concatenate(self.cuts) if self.cuts else np.empty((0, *series.shape[2:]))
        # Where no switch comes before a measurement there are no cuts.
        flat = series.reshape(len(series), -1), cuts.reshape(len(cuts), math.prod(cuts.shape[1:]))
        return InstantLanes(*flat, self.row, self.place, self.news)


@lru_cache(8)
def instant_series(
    sampled: SampledPlant, cells: int, forced: bool = False
) -> Float[np.ndarray, "row degree n z"]:
    """The M_d of a plant's modes, in each part of a period (`Acting.edges`) cell by cell."""
    plant, acting = sampled.plant, acting_of(sampled, forced)

    def along(mode: int, times: Float[np.ndarray, "cell node"]) -> np.ndarray:
        periods = [parts_of(acting, mode, 0.0, t) for t in times.ravel()]
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
    timings = [each.one for each in kinds if isinstance(each.one, TimingImperfection)]
    return MeasurementLags.of(zip(timings, lags, strict=True))


_LANES = (0.0,) * LANES  # the length of a tuple is a type: loops over it are unrolled
_FEW = 32  # scenarios that are gone through at a time, so that they stay in the caches


class _Stack(NamedTuple):
    """The received data of all scenarios, as in `Received` and `MeasurementLanes`, and the modes.

    modes : (scenario, sample), the reported modes, or None if they are the plant's
    """

    lag: np.ndarray
    reach: int
    noise: np.ndarray
    instants: InstantLanes | None
    modes: np.ndarray | None


@dataclass(frozen=True, eq=False)
class BlockMeasurements:
    """The received data of scenarios first, first + 1, …, the same under every law.

    Attributes
    ----------
    signals, by_period : SignalBatch, SignalPeriods
        Their signals, also sampled on the grid.
    by_mode : bool
        Whether a law depends on the reported modes.
    measured : int
        Size of a measurement.
    rooms : Rooms
        Memory of the received data.
    """

    loop: Loop
    imperfections: Sequence[Imperfection]
    signals: SignalBatch
    by_period: SignalPeriods
    seed: int
    first: int
    by_mode: bool
    measured: int
    rooms: Rooms = field(default_factory=Rooms)

    def measurements(
        self, feedback: Feedback | None, begin: int, count: int, has_state: bool = False
    ) -> MeasurementLanes:
        """The received data of a law with this table, in `count` scenarios from `begin` on.

        `begin` is a multiple of eight; a law with an observer (`has_state`) needs the mode, too.
        """
        received, row, reported_mode = self._received, np.zeros(0, np.int32), np.zeros(0, np.int32)
        if received.modes is not None:
            if feedback is not None and feedback.context != "none":
                row = self._rows(received.modes, begin, count, feedback.apart, feedback.ages)
            if has_state:
                reported_mode = self._rows(received.modes, begin, count, 1, 1)
        all_of, instants = self.by_period.scenarios, received.instants
        lag, noise = (from_scenario(part, begin, all_of) for part in (received.lag, received.noise))
        if instants is not None:
            instants = InstantLanes(
                *instants[:2], *(from_scenario(part, begin, all_of) for part in instants[2:])
            )
        return MeasurementLanes(Received(lag, received.reach, noise, row, reported_mode), instants)

    def _rows(
        self, reported: np.ndarray, begin: int, count: int, apart: int, ages: int
    ) -> np.ndarray:
        """The rows of a table by reported modes, at every sample."""
        part = slice(begin, begin + count)
        size = groups(count) * reported.shape[1] * LANES
        row = self._room(("rows", apart, ages), size, np.int32)
        fill_rows(
            row, reported[part], self._sampled[part], self.by_period.age[part], apart, ages, _LANES
        )
        return row

    @cached_property
    def _received(self) -> _Stack:
        """The data that reach the law of every scenario."""
        plant, samples = self.loop.plant, self.loop.whole + 1
        count = self.by_period.scenarios
        sizes = Sizes(plant.modes, self.measured, plant.inputs, self.loop.step)
        kinds = in_many_runs(self.imperfections, Relaying, self.seed, self.first, count, self.rooms)
        rooms = [each.room(sizes, samples, min(_FEW, count)) for each in kinds]
        size = groups(count) * samples * LANES
        nothing, modes, reach = ReceivedData.of_many(samples, sizes), None, 0
        block_instants = BlockInstants.of(
            self.loop, self.imperfections, self.seed, self.first, count, self.rooms
        )
        lag, noise = np.zeros(0, np.int32), np.zeros(0)
        for begin in range(0, count, _FEW):
            few, received = min(_FEW, count - begin), nothing
            these = slice(begin, begin + few)
            for each, room in zip(kinds, rooms, strict=True):
                received = each.relay(begin, room[:few], received, sizes)
            # By identity below: a sensor that does not change an array hands it on.
            sample = received.sample
            if block_instants is not None or sample is not nothing.sample:
                lag = lag if lag.size else self._room("lag", size, np.int32)
            if block_instants is not None:
                given = self.signals, self.by_period.records, begin, few, sample
                reach = block_instants.fill(*given, lag, reach)
            elif sample is not nothing.sample:
                own = lag[begin * samples :]
                reach = fill_lags(own, reach, sample, AT_SAMPLES, few, _LANES)
            if received.noise is not nothing.noise:
                if noise.size == 0:
                    noise = self._room("noise", size * self.measured)
                    # The room is used again, and the scenarios before may have no noise.
                    noise.fill(0.0)
                fill_numbers(received.noise, begin // LANES, noise)
            true = received.mode_of is nothing.mode_of and received.named is nothing.named
            if self.by_mode and not true:
                modes = self._sampled.copy() if modes is None else modes
                modes[these] = received.modes(self._sampled[these])
        return _Stack(
            lag, reach, noise, None if block_instants is None else block_instants.instants(), modes
        )

    def _room(self, name: Hashable, size: int, kind: DTypeLike = np.float64) -> np.ndarray:
        return self.rooms.of(name, (size,), kind)

    @cached_property
    def _sampled(self) -> np.ndarray:
        """The modes of the plant at the samples."""
        return self.by_period.records.modes(self.loop.whole + 1).astype(np.int32)
