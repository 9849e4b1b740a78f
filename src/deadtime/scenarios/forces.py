"""What disturbances do in a block of scenarios: a force for every stretch of every period.

It is constant over the stretch and does to the state there what the disturbance does; what draws it
and what it is are as in a single run (`simulation.forcing`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deadtime.imperfections import Disturbance, Imperfection, Sizes
from deadtime.numerics.lanes.code import LANES
from deadtime.scenarios.drawn import InManyRuns, Run, in_many_runs
from deadtime.scenarios.loop import Loop
from deadtime.scenarios.records import Records
from deadtime.scenarios.side_by_side import groups, lay_forces
from deadtime.simulation.forcing import force_over, lengths_of, spread_over
from deadtime.switching import SignalBatch

_FEW = 16  # scenarios that are gone through at a time, so that they stay in the caches


def forces_of(
    loop: Loop,
    imperfections: Sequence[Imperfection],
    signals: SignalBatch,
    records: Records,
    seed: int,
    first: int,
) -> np.ndarray:
    """The forces in scenarios first, first + 1, … with these signals, laid on periods.

    (group, sample, stretch, n, lane), flat; what is drawn is the same whatever the signals are.
    """
    count, samples, sampled = len(signals), loop.whole + 1, loop.sampled
    sizes, lengths = Sizes.of(loop.plant, loop.step), lengths_of(sampled)
    kinds = in_many_runs(imperfections, Disturbance, seed, first, count)
    maps, run = (
        _maps(loop, kinds, signals, records, sizes),
        Run(samples, samples + sampled.longest_lag),
    )
    laid = np.zeros(groups(count) * samples * (loop.acting.wide - loop.acting.plain) * LANES)
    for begin in range(0, count, _FEW):
        few = min(_FEW, count - begin)
        for each, T in zip(kinds, maps, strict=True):
            draws = each.draws(begin, few, sizes, lengths, run)
            lay_forces(laid, begin, few, draws, T, *records[:2], records.map, samples)
    return laid


def _maps(
    loop: Loop,
    kinds: Sequence[InManyRuns],
    signals: SignalBatch,
    records: Records,
    sizes: Sizes,
) -> list[np.ndarray]:
    """From what each draws for a stretch to its force, (map, stretch, n, r); map: of `Records`."""
    A, (mode, tau) = loop.plant.A, _pieces(loop, signals, records)
    shape = tau.shape
    mode, tau = (part.reshape(-1, shape[2]) for part in (mode, tau))
    inverse = force_over(A, mode, tau, loop.step)
    maps = []
    for each in kinds:
        assert isinstance(each.one, Disturbance)
        T = inverse @ spread_over(each.one, sizes, A, mode, tau)
        maps.append(T.reshape(*shape[:2], *T.shape[1:]))
    return maps


def _pieces(loop: Loop, signals: SignalBatch, records: Records) -> tuple[np.ndarray, np.ndarray]:
    """The modes (map, stretch, part), and for how many seconds, 0 for parts that there are not.

    The maps of modes, then of cut periods, the last ones of scenarios taken as whole.
    """
    modes, stretches = loop.plant.modes, loop.acting.stretches
    start, stop = (part[: stretches.first[1]] for part in (stretches.start, stretches.stop))
    sojourn, until = records.sojourn, records.until
    parts = int((until - sojourn).max(initial=1))
    i = np.minimum(sojourn[:, None] + np.arange(parts), until[:, None] - 1)
    begin = records.at[i]
    begin[:, 0] = 0.0
    end = np.append(begin[:, 1:], np.full((len(i), 1), loop.step), axis=1)
    end[np.arange(parts) + 1 >= (until - sojourn)[:, None]] = loop.step
    begin[np.arange(parts) >= (until - sojourn)[:, None]] = loop.step
    mode = np.concatenate((np.tile(np.arange(modes)[:, None], parts), signals.modes[i]))
    held = np.zeros((modes, parts)), np.zeros((modes, parts))
    held[0][:, 1:], held[1][:] = loop.step, loop.step
    begin, end = np.concatenate((held[0], begin)), np.concatenate((held[1], end))
    tau = np.minimum(end[:, None], stop[:, None]) - np.maximum(begin[:, None], start[:, None])
    return np.broadcast_to(mode[:, None], tau.shape), np.maximum(tau, 0.0)
