"""Disturbances in a block of scenarios: a force for every stretch of every period.

It is constant over the stretch and has the same effect on the state at its end as the disturbance.
Draws and forces are those of single runs (`simulation.forcing`).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from deadtime.imperfections import Disturbance, Imperfection, Sizes
from deadtime.numerics.lanes.code import LANES
from deadtime.scenarios.batch_loop import Loop
from deadtime.scenarios.by_period import fill_series
from deadtime.scenarios.drawn import Rooms, RunLength, in_many_runs
from deadtime.scenarios.periods import (
    MOST_NUMBERS,
    NODES,
    WIDE,
    Records,
    nodes,
    series_through,
    stack,
)
from deadtime.scenarios.side_by_side import fill_forces, groups
from deadtime.simulation.forcing import force_over, lengths_of, spread_over
from deadtime.switching import SignalBatch

ACCURACY = 1e-12  # of the largest effect of a number: series must agree so well with `_over`
_CHECKS = 29  # instants in each cell at which a series is checked, none of them a node
_FEW = 32  # scenarios that are gone through at a time, so that they stay in the caches


@dataclass(frozen=True, eq=False)
class ForceMaps:
    """The maps from draws for a stretch to its force, for every map of `Records`.

    In a period with one switch they come from series in its instant, as the plant's maps do in
    `periods`: a stretch has the same length wherever the switch lies in it, so they are analytic.
    """

    loop: Loop
    kinds: Sequence[Disturbance]

    def along(
        self, signals: SignalBatch, records: Records
    ) -> list[Float[np.ndarray, "map stretch n r"]]:
        """The maps of each disturbance along signals; last periods count as whole."""
        held, modes = self._held, signals.modes
        maps = np.empty((len(held) + records.sojourn.size, *held.shape[1:]))
        cut, switches = maps[len(held) :], records.until - records.sojourn - 1
        maps[: len(held)] = held
        (whole,), (once,) = np.nonzero(switches == 0), np.nonzero(switches == 1)
        cut[whole] = held[modes[records.sojourn[whole]]]
        if self._switched is None:
            once = once[:0]
        else:
            flat, width = self._switched
            found = np.empty((once.size, flat.shape[-1]))
            i, edges = records.sojourn[once], self.loop.acting.edges
            pair = modes[i] * len(held) + modes[i + 1]
            given = np.arange(once.size), pair, records.at[i + 1]
            fill_series(found, *given, edges, flat, (0.0,) * width)
            cut[once] = found[:, : held[0].size].reshape(-1, *held.shape[1:])
        rest = np.ones(switches.size, np.bool_)
        rest[whole] = rest[once] = False
        if rest.any():
            cut[rest] = self._along_cuts(modes, records, np.flatnonzero(rest))
        ends = np.cumsum(self._widths)[:-1]
        return [np.ascontiguousarray(part) for part in np.split(maps, ends, axis=3)]

    @cached_property
    def _held(self) -> np.ndarray:
        """The maps of periods without a switch."""
        mode = np.arange(self.loop.plant.modes)[:, None]
        return self._over(mode, np.broadcast_to([0.0, self.loop.step], (len(mode), 2)))

    @cached_property
    def _widths(self) -> list[int]:
        """Numbers that each disturbance draws for a stretch."""
        sizes, A = Sizes.of(self.loop.plant, self.loop.step), self.loop.plant.A
        one = np.zeros((1, 1), np.int64), np.full((1, 1), self.loop.step)
        return [spread_over(kind, sizes, A, *one).shape[2] for kind in self.kinds]

    @cached_property
    def _switched(self) -> tuple[np.ndarray, int] | None:
        """Series (mode·mode, part, cell, degree, size), and the vectors in one entry.

        None if there are too many modes, or if a series does not fit: one of the root of a
        covariance that is almost singular for some switch.
        """
        cells, edges, modes = self.loop.cells, self.loop.acting.edges, self.loop.plant.modes
        size = self._held[0].size
        if modes * modes * (edges.size - 1) * cells * NODES * size > MOST_NUMBERS:
            return None
        parts = []
        for low, high in itertools.pairwise(edges):
            values = self._with_switch(nodes(low, high, cells))
            parts.append(stack([series_through(of_pair) for of_pair in values]))
        flat = np.ascontiguousarray(stack(parts).swapaxes(0, 1))
        width = (0.0,) * (flat.shape[-1] // WIDE)
        pair = np.repeat(np.arange(modes * modes), _CHECKS * cells * (edges.size - 1))
        t = np.concatenate(
            [
                np.linspace(low, high, _CHECKS * cells, endpoint=False)
                for low, high in itertools.pairwise(edges)
            ]
        )
        found = np.empty((pair.size, flat.shape[-1]))
        given = np.arange(pair.size), pair, np.tile(t, modes * modes)
        fill_series(found, *given, edges, flat, width)
        exact = self._with_switch(t[:, None]).reshape(-1, self._held.shape[3])
        error = np.abs(found[:, :size].reshape(exact.shape) - exact).max(axis=0)
        fits = (error <= ACCURACY * np.abs(exact).max(axis=0)).all()
        return (flat, len(width)) if fits else None

    def _with_switch(self, t: np.ndarray) -> np.ndarray:
        """The maps of periods with a switch at t (cell, node): (mode·mode, cell, node, numbers)."""
        modes = self.loop.plant.modes
        pairs = np.stack(np.divmod(np.arange(modes * modes), modes), axis=1)
        at = np.zeros((len(pairs), *t.shape, 3))
        at[..., 1], at[..., 2] = t, self.loop.step
        mode = np.broadcast_to(pairs[:, None, None], (*at.shape[:3], 2))
        values = self._over(mode.reshape(-1, 2), at.reshape(-1, 3))
        return values.reshape(*at.shape[:3], -1)

    def _along_cuts(self, modes: np.ndarray, records: Records, which: np.ndarray) -> np.ndarray:
        """The maps of cut periods, each with its own number of switches.

        Shorter rows are filled with instants at the end of the period: parts of no length.
        """
        sojourn, until = records.sojourn[which], records.until[which]
        order = sojourn[:, None] + np.arange(int((until - sojourn).max()) + 1)
        i = np.minimum(order, until[:, None] - 1)
        at = np.where(order < until[:, None], records.at[i], self.loop.step)
        at[:, 0] = 0.0
        return self._over(modes[i[:, :-1]], at)

    def _over(self, mode: np.ndarray, at: np.ndarray) -> np.ndarray:
        """The maps (period, stretch, n, numbers), in mode (period, part) between instants `at`."""
        loop, sizes = self.loop, Sizes.of(self.loop.plant, self.loop.step)
        stretches, A = loop.acting.stretches, loop.plant.A
        start, stop = (part[: stretches.first[1], None] for part in stretches[1:3])
        tau = np.minimum(at[:, None, 1:], stop) - np.maximum(at[:, None, :-1], start)
        shape = tau.shape
        mode = np.broadcast_to(mode[:, None], shape).reshape(-1, shape[2])
        # Parts outside a stretch have negative lengths here: none of their time counts.
        tau = np.maximum(tau, 0.0).reshape(-1, shape[2])
        inverse = force_over(A, mode, tau, loop.step)
        spreads = [spread_over(kind, sizes, A, mode, tau) for kind in self.kinds]
        T = inverse @ np.concatenate(spreads, axis=2)
        return T.reshape(*shape[:2], *T.shape[1:])


def forces_of(
    maps: ForceMaps,
    imperfections: Sequence[Imperfection],
    signals: SignalBatch,
    records: Records,
    seed: int,
    first: int,
    rooms: Rooms,
) -> np.ndarray:
    """The forces in scenarios first, first + 1, … with these signals, period by period.

    (group, sample, stretch, n, lane), flat, in `rooms`; the draws do not depend on the signals.
    """
    loop, count = maps.loop, len(signals)
    samples, sampled = loop.whole + 1, loop.sampled
    sizes, lengths = Sizes.of(loop.plant, loop.step), lengths_of(sampled)
    kinds = in_many_runs(imperfections, Disturbance, seed, first, count, rooms)
    along, run = maps.along(signals, records), RunLength(samples, samples + sampled.longest_lag)
    size = groups(count) * samples * (loop.acting.wide - loop.acting.plain) * LANES
    in_lanes = rooms.of("forces", (size,))
    in_lanes.fill(0.0)
    for begin in range(0, count, _FEW):
        few = min(_FEW, count - begin)
        for each, T in zip(kinds, along, strict=True):
            draws = each.draws(begin, few, sizes, lengths, run)
            states, numbers = ((0.0,) * size for size in T.shape[2:])
            given = *records[:2], records.map, samples, states, numbers
            fill_forces(in_lanes, begin, few, draws, T, *given)
    return in_lanes
