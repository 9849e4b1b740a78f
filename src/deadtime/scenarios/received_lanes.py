"""What imperfect sensors tell the laws of a block of scenarios, drawn before they run."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import DTypeLike

from deadtime.feedback import Feedback
from deadtime.imperfections import Heard, Imperfection, Relaying, Sizes
from deadtime.numerics.lanes.code import LANES
from deadtime.scenarios.batch_loop import Loop
from deadtime.scenarios.drawn import in_many_runs
from deadtime.scenarios.lane_types import Hearing, Relayed, SightLanes
from deadtime.scenarios.records import Laid
from deadtime.scenarios.rooms import Rooms
from deadtime.scenarios.side_by_side import from_scenario, groups, lay_lags, lay_numbers, lay_rows
from deadtime.scenarios.sights import Sights
from deadtime.switching import SignalBatch

_FEW = 32  # scenarios that are gone through at a time, so that they stay in the caches


class _Stack(NamedTuple):
    """What is heard in all scenarios: as `Relayed` has it, and the modes.

    sight : as `Hearing` has it
    modes : (scenario, sample), the modes told, or None where they are the plant's
    """

    lag: np.ndarray
    reach: int
    noise: np.ndarray
    sight: SightLanes | None
    modes: np.ndarray | None


@dataclass(frozen=True, eq=False)
class HeardBlock:
    """What is heard in scenarios first, first + 1, …, the same under every law.

    Attributes
    ----------
    signals, laid : SignalBatch, Laid
        Their signals, and these laid on periods.
    by_mode : bool
        Whether a law goes by the modes that it is told.
    measured : int
        How many numbers laws measure.
    rooms : Rooms
        Where all that is heard lies.
    """

    loop: Loop
    imperfections: Sequence[Imperfection]
    signals: SignalBatch
    laid: Laid
    seed: int
    first: int
    by_mode: bool
    measured: int
    rooms: Rooms = field(default_factory=Rooms)

    def hearing(
        self, feedback: Feedback | None, begin: int, count: int, remembers: bool = False
    ) -> Hearing:
        """What a law with this table hears in `count` scenarios of the block from `begin` on.

        `begin` is a multiple of eight; a law that `remembers` goes by the mode besides.
        """
        heard, row, told_mode = self._heard, np.zeros(0, np.int32), np.zeros(0, np.int32)
        if heard.modes is not None:
            if feedback is not None and feedback.context != "none":
                row = self._rows(heard.modes, begin, count, feedback.apart, feedback.ages)
            if remembers:
                told_mode = self._rows(heard.modes, begin, count, 1, 1)
        all_of, sight = self.laid.scenarios, heard.sight
        lag, noise = (from_scenario(part, begin, all_of) for part in (heard.lag, heard.noise))
        if sight is not None:
            sight = SightLanes(
                *sight[:2], *(from_scenario(part, begin, all_of) for part in sight[2:])
            )
        return Hearing(Relayed(lag, heard.reach, noise, row, told_mode), sight)

    def _rows(self, told: np.ndarray, begin: int, count: int, apart: int, ages: int) -> np.ndarray:
        """The rows of a table in scenarios that are told these modes, laid on samples."""
        part = slice(begin, begin + count)
        size = groups(count) * told.shape[1] * LANES
        row = self._room(("rows", apart, ages), size, np.int32)
        lay_rows(told[part], self._sampled[part], self.laid.age[part], apart, ages, row)
        return row

    @cached_property
    def _heard(self) -> _Stack:
        """What reaches the law of every scenario."""
        plant, samples = self.loop.plant, self.loop.whole + 1
        count = self.laid.scenarios
        sizes = Sizes(plant.modes, self.measured, plant.inputs, self.loop.step)
        kinds = in_many_runs(self.imperfections, Relaying, self.seed, self.first, count, self.rooms)
        rooms = [each.room(sizes, samples, min(_FEW, count)) for each in kinds]
        size = groups(count) * samples * LANES
        nothing, modes, reach = Heard.of_many(samples, sizes), None, 0
        sights = Sights.of(self.loop, self.imperfections, self.seed, self.first, count, self.rooms)
        lag, noise = np.zeros(0, np.int32), np.zeros(0)
        for begin in range(0, count, _FEW):
            few, heard = min(_FEW, count - begin), nothing
            these = slice(begin, begin + few)
            for each, room in zip(kinds, rooms, strict=True):
                heard = each.relay(begin, room[:few], heard, sizes)
            sample = heard.sample
            if sights is not None or sample is not nothing.sample:
                lag = lag if lag.size else self._room("lag", size, np.int32)
            if sights is not None:
                given = self.signals, self.laid.records, begin, few, sample
                reach = sights.lay(*given, lag, reach)
            elif sample is not nothing.sample:
                reach = lay_lags(sample, few, begin // LANES, lag, reach)
            if heard.noise is not nothing.noise:
                if noise.size == 0:
                    noise = self._room("noise", size * self.measured)
                    noise.fill(0.0)
                lay_numbers(heard.noise, begin // LANES, noise)
            true = heard.mode_of is nothing.mode_of and heard.named is nothing.named
            if self.by_mode and not true:
                modes = self._sampled.copy() if modes is None else modes
                modes[these] = heard.modes(self._sampled[these])
        return _Stack(lag, reach, noise, None if sights is None else sights.sight(), modes)

    def _room(self, name: Hashable, size: int, kind: DTypeLike = np.float64) -> np.ndarray:
        return self.rooms.of(name, (size,), kind)

    @cached_property
    def _sampled(self) -> np.ndarray:
        """The modes of the plant at the samples."""
        return self.laid.records.modes(self.loop.whole + 1).astype(np.int32)
