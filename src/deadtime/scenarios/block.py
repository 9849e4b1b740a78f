"""One block of scenarios under every law."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from deadtime.feedback import Law
from deadtime.imperfections import Disturbance, Imperfection, Relaying, TimingImperfection
from deadtime.numerics.lanes.code import LANES
from deadtime.scenarios.batch_loop import Loop
from deadtime.scenarios.dataset import Results
from deadtime.scenarios.drawn import Rooms
from deadtime.scenarios.forces import ForceMaps, forces_of
from deadtime.scenarios.lane_types import MeasurementLanes
from deadtime.scenarios.periods import SignalPeriods
from deadtime.scenarios.received_lanes import BlockMeasurements
from deadtime.scenarios.scenario_sums import Instants, Path, metrics_of, needs_own_run
from deadtime.scenarios.side_by_side import from_scenario, groups
from deadtime.scenarios.source import Source, scenario_seed
from deadtime.simulation import simulate
from deadtime.simulation.tracking import Followed, step_info, step_info_of
from deadtime.switching import SwitchingSignal
from deadtime.switching.grid import modes_at

if TYPE_CHECKING:
    from deadtime.scenarios.engine import Engine, EngineTable
    from deadtime.scenarios.helper import Helper
    from deadtime.scenarios.prepare import Runnable

_ROOM = 1 << 19  # numbers of the trajectories that the engine makes at a time: 4 MiB

Stopped = Callable[[], bool]


@dataclass(frozen=True, eq=False)
class Block:
    """Runs blocks of scenarios under every law, into the results.

    Attributes
    ----------
    tables : mapping
        From the names of laws to their tables in the engine; `simulate` runs the other laws.
    helper : Helper
        Compiles the loop of some laws: these run last.
    weighed : pair of Loop and Engine, or None
        With the cost's weight, where that is not the identity: a second run measures the cost.
    """

    loop: Loop
    source: Source
    laws: Mapping[str, Law]
    tables: Mapping[str, Runnable]
    engine: Engine
    imperfections: Sequence[Imperfection]
    seed: int
    results: Results
    helper: Helper
    weighed: tuple[Loop, Engine] | None = None
    rooms: Rooms = field(default_factory=Rooms)

    def run(self, first: int, count: int, stopped: Stopped) -> int:
        """Run scenarios first, …, first + count − 1; how many of their signals end early.

        If `stopped` returns true, the block ends and counts as not done.
        """
        signals, loop = self.source(first, count), self.loop
        by_period, later, along = None, self.helper.laws, self.engine.along
        tables = {
            name: along(law, signals) for name, law in self.tables.items() if name not in later
        }
        received = force = instants = None
        if self.tables:
            loops = [loop, *([] if self.weighed is None else self.weighed[:1])]
            by_period = [each.sample_signals(signals) for each in loops]
            records, drawn = by_period[0].records, (self.imperfections, signals)
            if loop.late_times is not None:
                instants = Instants.of(loop, loop.late_times, signals, records)
            if loop.forced:
                force = forces_of(self._force_maps, *drawn, records, self.seed, first, self.rooms)
            if any(isinstance(one, Relaying | TimingImperfection) for one in self.imperfections):
                given = loop, *drawn, by_period[0], self.seed, first
                by_mode = any(map(_by_mode, tables.values()))
                received = {
                    size: BlockMeasurements(*given, by_mode, size, self.rooms.under(size))
                    for size in {table.measured for table in tables.values()}
                }
        rows = list(enumerate(self.laws.items()))
        for row, (name, law) in sorted(rows, key=lambda one: one[1][0] in later):
            if name in later:
                self.helper.wait(stopped)
                if stopped():
                    return 0
                tables[name] = along(self.tables[name], signals)
            left: Sequence[int] = range(count)
            if by_period is not None and name in tables:
                left = self._at_once(
                    row, tables[name], by_period, received, force, instants, first, stopped
                )
            for i in left:
                if stopped():
                    return 0
                self._alone(row, law, signals[i], first + i)
        if self.results.mode is not None:
            times = loop.step * np.arange(loop.whole + 1)
            for i, signal in enumerate(signals):
                self.results.mode[first + i] = modes_at(signal, times, loop.step)
        if stopped():
            return 0
        # Last: an interrupted block leaves its scenarios not done, and its results unread.
        self.results.done[first : first + count] = True
        return int((signals.end < loop.horizon).sum())

    @cached_property
    def _force_maps(self) -> ForceMaps:
        kinds = [one for one in self.imperfections if isinstance(one, Disturbance)]
        return ForceMaps(self.loop, kinds)

    def _at_once(
        self,
        row: int,
        table: EngineTable,
        by_period: Sequence[SignalPeriods],
        received: Mapping[int, BlockMeasurements] | None,
        force: np.ndarray | None,
        instants: Instants | None,
        first: int,
        stopped: Stopped,
    ) -> Sequence[int]:
        """Run a law by the engine; the scenarios that are left to `simulate`.

        Without trajectories all at once, else as many as fit into `_ROOM`, in the caches.
        """
        results, count = self.results, by_period[0].scenarios
        whole = results.x is None and self._followed[row] is None and instants is None
        samples, numbers = self.loop.whole + 1, table.shape.x + table.shape.u
        few = LANES * max(1, _ROOM // (samples * numbers * LANES))
        size, left = count if whole else min(count, few), list[int]()
        length = 0 if whole else groups(size) * samples * numbers * LANES
        room = self.rooms.of("trajectories", (length,))
        for start in range(0, count, size):
            if stopped():
                return []
            these = slice(first + start, first + min(start + size, count))
            measurements = MeasurementLanes()
            if received is not None:
                measurements = received[table.measured].measurements(
                    table.feedback, start, these.stop - these.start, table.memory is not None
                )
            felt = None if force is None else from_scenario(force, start, count)
            given, late = (start, these.stop - these.start, measurements, felt), None
            if whole:
                figures = self.engine.run(table, by_period[0], *given)
            else:
                figures, path = self.engine.path(table, by_period[0], *given, room=room)
                self._keep(row, path, by_period[0], start, these)
                late = None if instants is None else instants.squares(path, felt, start)
            weighed = None
            if self.weighed is not None:
                weighed = self.weighed[1].run(table, by_period[1], *given)
            for metric, values in metrics_of(self.loop, figures, weighed, late).items():
                results.metrics[metric][row, these] = values
            left += (start + np.flatnonzero(needs_own_run(figures, late))).tolist()
        return left

    def _keep(
        self, row: int, path: Path, by_period: SignalPeriods, start: int, these: slice
    ) -> None:
        """Store trajectories, and figures of a followed reference."""
        results, followed = self.results, self._followed[row]
        if results.x is not None and results.u is not None:
            results.x[row, these], results.u[row, these] = path.x, path.u
        if followed is None:
            return
        time = self.loop.step * np.arange(self.loop.whole + 1)
        y, error = None, np.zeros(path.scenarios)
        if not followed.is_same_in_modes:
            modes = by_period.records.modes(time.size)[start : start + path.scenarios]
            y = np.stack([followed.outputs(x, mode) for x, mode in zip(path.x, modes, strict=True)])

        def figures(
            output: int, where: slice, r: Float[np.ndarray, " W"]
        ) -> dict[str, Float[np.ndarray, " run"]]:
            if y is not None:
                return step_info(time[where], y[:, output, where], r)
            row = followed.rows[0, output]
            return step_info_of(path.in_lanes, where.start, path.scenarios, row, time[where], r)

        for output in range(followed.rows.shape[1]):
            where, r = followed.window(time, output)
            found = figures(output, where, r)
            for name, values in found.items():
                results.tracking[name][row, these, output] = values
            # The metric is over the whole run, not over the window of the last step.
            if r.size < time.size:
                along = followed.reference.along(time)[:, output]
                found = figures(output, slice(0, time.size), along)
            error += found["IAE"]
        results.metrics["iae"][row, these] = error

    @cached_property
    def _followed(self) -> list[Followed | None]:
        """The tracked outputs and reference of each law, None where it tracks nothing."""
        return [Followed.of(law) for law in self.laws.values()]

    def _alone(self, row: int, law: Law, signal: SwitchingSignal, scenario: int) -> None:
        """Run one scenario by `simulate`."""
        loop, results, seed = self.loop, self.results, scenario_seed(self.seed, scenario)
        given = loop.plant, law, signal, loop.x0, loop.horizon, loop.step
        run = simulate(*given, imperfections=self.imperfections, seed=seed)
        results.diverged[row, scenario] = run.diverged
        weight = None if self.weighed is None else self.weighed[0].weight
        for metric, value in run.metrics(weight).items():
            results.metrics[metric][row, scenario] = value
        for output in range(0 if run.followed is None else run.followed.rows.shape[1]):
            for name, value in run.step_info(output).items():
                results.tracking[name][row, scenario, output] = value
        if results.x is not None and results.u is not None:
            for target, found in ((results.x, run.states), (results.u, run.inputs)):
                kept = min(found.shape[1], target.shape[3])
                target[row, scenario, :, :kept] = found[:, :kept]
                target[row, scenario, :, kept:] = np.nan


def _by_mode(table: EngineTable) -> bool:
    """Whether a law depends on the mode."""
    by_rows = table.feedback is not None and table.feedback.context != "none"
    return by_rows or table.memory is not None
