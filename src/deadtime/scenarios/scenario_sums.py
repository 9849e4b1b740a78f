"""Sums along each scenario, the metrics that follow from them, and states at shared instants.

An engine makes the sums. States between samples, at instants that all scenarios share, are
x(t_k + τ) = M z_k: z_k is the state at the sample with the inputs of the period; M is the map of
the period cut off at τ. Each mode has one M for every instant, and each cut period one for every
instant that lies in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from deadtime.plant.discretisation import snap_all
from deadtime.scenarios.batch_loop import Loop
from deadtime.scenarios.periods import Records, compose, parts_of
from deadtime.switching import SignalBatch

_LIMIT, _TINY = 1e200, 1e-290  # of |x|², beyond which `simulate` runs a scenario again


class ScenarioSums(NamedTuple):
    """Sums along each scenario.

    ise, energy : ∫|x|² and Σ|u|², the last term weighted by the rest of the horizon
    peak, final : |x|², its maximum over the samples t_0, …, t_K and its value at the horizon
    outside : the last sample with |x| above 2 % of the peak so far, −1 for none
    least, log_sum, log_double : min |x|², Σ log|x|² and Σ_k Σ_{j ≤ k} log|x_j|² over the samples of
        the second half
    """

    ise: Float[np.ndarray, " scenario"]
    energy: Float[np.ndarray, " scenario"]
    peak: Float[np.ndarray, " scenario"]
    outside: Float[np.ndarray, " scenario"]
    least: Float[np.ndarray, " scenario"]
    log_sum: Float[np.ndarray, " scenario"]
    log_double: Float[np.ndarray, " scenario"]
    final: Float[np.ndarray, " scenario"]


@dataclass(frozen=True, eq=False)
class Path:
    """States and inputs at the samples.

    Attributes
    ----------
    in_lanes : (group, sample, n + m, lane)
        x and u of all scenarios, as in `side_by_side`.
    scenarios, states : int
    """

    in_lanes: Float[np.ndarray, "group sample size lane"]
    scenarios: int
    states: int

    @property
    def x(self) -> Float[np.ndarray, "scenario n sample"]:
        return self._each(self.in_lanes[:, :, : self.states])

    @property
    def u(self) -> Float[np.ndarray, "scenario m sample"]:
        return self._each(self.in_lanes[:, :, self.states :])

    def _each(self, part: np.ndarray) -> np.ndarray:
        groups, samples, size, lanes = part.shape
        each = part.transpose(0, 3, 2, 1).reshape(groups * lanes, size, samples)
        return each[: self.scenarios]


@np.errstate(all="ignore")  # of a scenario that diverges, which is run again
def metrics_of(
    loop: Loop,
    figures: ScenarioSums,
    weighed: ScenarioSums | None = None,
    late: Float[np.ndarray, "scenario time"] | None = None,
) -> dict[str, Float[np.ndarray, " scenario"]]:
    """The metrics of `Trajectory.metrics`, in its order.

    `weighed` are the sums of the cost; `late` is |x|² at `Loop.late_times`, where there are any.

    The last sample above 2 % of the peak so far is the last one above 2 % of the peak: once the
    peak is reached they are the same, and before, |x| later reaches the peak itself.
    """
    step = loop.step
    peak = np.maximum(figures.peak, figures.final)
    parts = figures.ise, step * figures.energy
    cost = parts if weighed is None else (weighed.ise, step * weighed.energy)
    at_end = figures.final > 0.02**2 * peak
    time = step * (figures.outside + 1.0)
    time = np.where(figures.outside == loop.whole, loop.horizon, time)
    return {
        "ise": parts[0],
        "energy": parts[1],
        "cost": cost[0] + cost[1],
        "peak": np.sqrt(peak),
        "settling_time": np.where(at_end, np.inf, time),
        "decay_rate": _decay_rate(loop, figures) if late is None else _slope(loop, late),
        "final_norm": np.sqrt(figures.final),
    }


def _decay_rate(loop: Loop, figures: ScenarioSums) -> Float[np.ndarray, " scenario"]:
    """Minus the least-squares slope of log|x| over the samples of the second half, and its end.

    With j = k − k₀ counting c samples from k₀ on, Σ j L_j = c Σ L_j − Σ_k Σ_{j ≤ k} L_j.
    """
    count = loop.whole + 1 - loop.late
    j = np.arange(count)
    moment = count * figures.log_sum - figures.log_double
    total, places, squares = figures.log_sum, float(j.sum()), float((j * j).sum())
    if loop.rest > 0.0:
        place = loop.horizon / loop.step - loop.late
        last = np.log(np.maximum(figures.final, np.finfo(float).tiny))
        moment, total = moment + place * last, total + last
        places, squares, count = places + place, squares + place * place, count + 1
    slope = (moment - places / count * total) / (squares - places * places / count)
    return -0.5 * slope / loop.step


def _slope(loop: Loop, late: Float[np.ndarray, "scenario time"]) -> Float[np.ndarray, " scenario"]:
    """Minus the slope of log|x| fitted to the instants `Loop.late_times`; `late` is |x|² there."""
    assert loop.late_times is not None
    place = loop.late_times / loop.horizon - 0.75
    weights = -0.5 * place / (place @ place * loop.horizon)
    return sum((w * log for w, log in zip(weights, np.log(late.T), strict=True)), start=np.zeros(1))


def needs_own_run(
    figures: ScenarioSums, late: Float[np.ndarray, "scenario time"] | None = None
) -> Bool[np.ndarray, " scenario"]:
    """Scenarios that diverge or vanish, `late` as in `metrics_of`: `simulate` runs them."""
    peak = np.maximum(figures.peak, figures.final)
    least = np.minimum(figures.least, figures.final)
    if late is not None:
        least = np.minimum(least, late.min(axis=1))
    fine = (peak <= _LIMIT) & (least >= _TINY)
    for figure in (figures.ise, figures.energy, figures.log_sum, figures.log_double):
        fine &= np.isfinite(figure)
    return ~fine


@dataclass(frozen=True, eq=False)
class Instants:
    """The maps to instants within the periods of a block of scenarios.

    Attributes
    ----------
    loop : Loop
    period : (time,)
        k.
    moves : (row, n, z)
        M.
    row : (scenario, time)
        The row of `moves` of a scenario and an instant.
    """

    loop: Loop
    period: Int[np.ndarray, " time"]
    moves: Float[np.ndarray, "row n z"]
    row: Int[np.ndarray, "scenario time"]

    @classmethod
    def of(
        cls, loop: Loop, times: Float[np.ndarray, " time"], signals: SignalBatch, records: Records
    ) -> Instants:
        """Those of the signals of a block, given their records."""
        plant, acting, ratio = loop.plant, loop.acting, snap_all(times / loop.step)
        period = np.floor(ratio).astype(np.int64)
        until = np.where(ratio == period, 0.0, times - period * loop.step)
        parts = [parts_of(acting, i, 0.0, t) for i in range(plant.modes) for t in until]
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
        in_lanes, k = path.in_lanes, self.period
        groups, samples, _, lanes = in_lanes.shape
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
