"""States between samples, at instants that all scenarios share: x(t_k + τ) = M z_k.

z_k is the state at the sample and what acts in the period; M is the map of the period cut off at τ.
Each mode has one M for every instant, and each cut period one for every instant that lies in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from deadtime.plant.discretisation import snap_all
from deadtime.scenarios.batch_loop import Loop
from deadtime.scenarios.cut_periods import compose, parts_of
from deadtime.scenarios.records import Records
from deadtime.scenarios.scenario_sums import Path
from deadtime.switching import SignalBatch


@dataclass(frozen=True, eq=False)
class Instants:
    """Where instants lie in the periods of a block of scenarios.

    Attributes
    ----------
    loop : Loop
    period : (time,)
        k.
    moves : (row, n, z)
        M.
    row : (scenario, time)
        Which of them takes a scenario to an instant.
    """

    loop: Loop
    period: Int[np.ndarray, " time"]
    moves: Float[np.ndarray, "row n z"]
    row: Int[np.ndarray, "scenario time"]

    @classmethod
    def of(
        cls, loop: Loop, times: Float[np.ndarray, " time"], signals: SignalBatch, records: Records
    ) -> Instants:
        """Those of the signals of a block, laid."""
        plant, acting, ratio = loop.plant, loop.acting, snap_all(times / loop.step)
        period = np.floor(ratio).astype(np.int64)
        until = np.where(ratio == period, 0.0, times - period * loop.step)
        parts = [parts_of(plant, acting, i, 0.0, t) for i in range(plant.modes) for t in until]
        whole = compose(plant, acting, parts, acting.wide).move
        maps, place = records.maps(loop.whole + 1)[:, period], np.arange(times.size)
        row, cut = maps * times.size + place, maps >= plant.modes
        row[cut] = len(whole) + np.arange(cut.sum())
        tau = np.broadcast_to(until, cut.shape)[cut]
        within = loop.moves(records, signals.modes, maps[cut] - plant.modes, tau)
        return cls(loop, period, np.concatenate((whole, within)), row)

    @np.errstate(all="ignore")  # of a scenario that diverges, which is run again
    def squares(
        self, path: Path, force: Float[np.ndarray, " numbers"] | None, start: int
    ) -> Float[np.ndarray, "scenario time"]:
        """|x|² on a path from scenario `start` of the block on, `force` as engines take it."""
        laid, k = path.laid, self.period
        groups, samples, _, lanes = laid.shape
        past = [(k >= lag, np.maximum(k - lag, 0)) for lag in self.loop.acting.lags]
        acting = [path.x[:, :, k], *(np.where(sent, path.u[:, :, at], 0.0) for sent, at in past)]
        if force is not None:
            size = self.loop.acting.wide - self.loop.acting.plain
            force = force[: groups * samples * size * lanes].reshape(groups, samples, size, lanes)
            acting.append(Path(force, path.scenarios, size).x[:, :, k])
        z, squares = np.concatenate(acting, axis=1), np.empty((path.scenarios, k.size))
        for t, row in enumerate(self.row[start : start + path.scenarios].T):
            # Term by term: sums of NumPy's own may depend on how many scenarios there are.
            moves = self.moves[row].transpose(2, 1, 0)
            x = np.zeros(moves.shape[1:])
            for move, entry in zip(moves, z[:, :, t].T, strict=True):
                x += move * entry
            squares[:, t] = sum(entry * entry for entry in x)
        return squares
