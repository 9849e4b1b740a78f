"""The periods of a log from which modes are told, and the chain over them.

In each mode a period is normal about what the mode foretells, e = x_{k+1} − P_i r_k ~ N(0, S_i).
With a `pooled` model the mode may change at any time: a period that begins and ends in other modes
has the density of that, one model for all modes. No unknown is in it, so that such periods tell
where a switch was and nothing of the plant, as where modes are logged. Without it the mode of a row
holds for its period. A period of which something is missing says nothing, and the chain goes on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import read_only
from deadtime.base.frozen import Frozen
from deadtime.identification.likelihoods.chain import likeliest, smooth
from deadtime.identification.likelihoods.jumps import Counts, Jumps
from deadtime.identification.log.recording import Part
from deadtime.identification.regression import log_density, rows_of
from deadtime.identification.transition import plain_transitions
from deadtime.identification.uneven import node_rows, usable


class PooledRegression(NamedTuple):
    """Of even rows a regression, in the cells that its inputs have, (m,).

    constant : whether its last column is a constant term's
    """

    P: Float[np.ndarray, "n r"]
    S: Float[np.ndarray, "n n"]
    cells: Int[np.ndarray, " m"]
    constant: bool

    def density(self, part: Part, k: Int[np.ndarray, " period"]) -> Float[np.ndarray, " period"]:
        """The log density of periods k of a part."""
        return log_density(cell_rows(part, k, self.cells, self.constant), self.P, self.S)


class PooledPlant(NamedTuple):
    """Of uneven rows a plant of one mode: A, B (with a constant term as its last column), delays.

    S : what a period of `step` adds
    """

    A: Float[np.ndarray, "n n"]
    B: Float[np.ndarray, "n acting"]
    delays: Float[np.ndarray, " m"]
    S: Float[np.ndarray, "n n"]
    nodes: Float[np.ndarray, " node"]
    step: float

    def density(self, part: Part, k: Int[np.ndarray, " period"]) -> Float[np.ndarray, " period"]:
        """The log density of periods k of a part."""
        n, m, count = len(self.A), self.delays.size, self.nodes.size
        constant = self.B.shape[1] > m
        z = node_rows(part, k, self.delays, self.nodes, self.step, constant)
        Phi, W = plain_transitions(self.A[None], self.nodes)
        flat = (np.moveaxis(one[0], 0, 1).reshape(n, -1) for one in (Phi, W @ self.B))
        P = np.hstack((*flat, np.zeros((n, count * m))))
        return log_density(z, P, self.S)


Pooled = PooledRegression | PooledPlant


def cell_rows(
    part: Part, k: Int[np.ndarray, " period"], cells: Int[np.ndarray, " m"], constant: bool
) -> Float[np.ndarray, "period z"]:
    """z = (x_{k+1}, x_k, u_{k−N}, u_{k−N+1}), N the cell of each input; and 1 for a constant."""
    column = np.arange(cells.size)
    read = [part.input[np.maximum(k[:, None] - lag, 0), column] for lag in (cells, cells - 1)]
    ones = np.ones((k.size, int(constant)))
    return np.hstack((part.output[k + 1], part.output[k], *read, ones))


class Posterior(NamedTuple):
    """What a log says of its modes under some unknowns.

    value : log likelihood
    weight : (periods, modes), how likely each usable period was in a mode from end to end
    counts : the jumps that are expected
    node : of every part (samples, modes), how likely each mode was
    """

    value: float
    weight: Float[np.ndarray, "period mode"]
    counts: Counts
    node: list[Float[np.ndarray, "sample mode"]]


@dataclass(frozen=True, eq=False)
class Periods(Frozen):
    """The periods k of every part that are usable whatever the delays in a range are.

    pooled : of periods within which the mode changes; None if it does at samples only
    constant : whether dx/dt has a constant term in each mode
    """

    parts: tuple[Part, ...]
    usable: tuple[Int[np.ndarray, " period"], ...]
    pooled: Pooled | None
    constant: bool

    @property
    def count(self) -> int:
        """How many there are."""
        return sum(k.size for k in self.usable)

    @property
    def within(self) -> bool:
        """Whether the mode may change within periods."""
        return self.pooled is not None

    @cached_property
    def _mixed(self) -> Float[np.ndarray, " period"]:
        """The log density of periods within which the mode changes."""
        if self.pooled is None:
            return read_only(np.zeros(self.count))
        each = zip(self.parts, self.usable, strict=True)
        return read_only(np.concatenate([self.pooled.density(part, k) for part, k in each]))

    def posterior(self, density: Float[np.ndarray, "period mode"], jumps: Jumps) -> Posterior:
        """What the log says, given log densities of usable periods and the chain.

        The first mode of a part may be any.
        """
        return posterior_of(self.parts, self._laid(density), jumps, self.usable, self.within)

    def path(
        self, density: Float[np.ndarray, "period mode"], jumps: Jumps
    ) -> list[Int[np.ndarray, " sample"]]:
        """The likeliest modes of the samples of every part."""
        return path_of(self.parts, self._laid(density), jumps)

    def _laid(self, density: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Of every part the densities of all periods, if the mode stays and if it changes."""
        modes, laid, start = density.shape[1], [], 0
        for part, k in zip(self.parts, self.usable, strict=True):
            stay = np.zeros((part.time.size - 1, modes))
            stay[k] = density[start : start + k.size]
            move = stay[..., None]
            if self.within:
                move = np.zeros((*stay.shape, 1))
                move[k] = self._mixed[start : start + k.size, None, None]
            laid.append((stay, move))
            start += k.size
        return laid


@dataclass(frozen=True, eq=False)
class EvenPeriods(Periods):
    """Of even rows, for delays in the cells from `first` to `last`."""

    first: int
    last: int

    @classmethod
    def of(
        cls,
        parts: tuple[Part, ...],
        first: int,
        last: int,
        pooled: PooledRegression | None,
        constant: bool,
    ) -> EvenPeriods:
        """Those of parts, for delays in a range of cells and in those of the one regression."""
        if pooled is not None:
            first, last = min(first, *pooled.cells.tolist()), max(last, *pooled.cells.tolist())
        good = tuple(rows_of(part, first - 1, last, within=False) for part in parts)
        return cls(parts, good, pooled, constant, first, last)

    def rows(self, cells: Int[np.ndarray, " m"]) -> Float[np.ndarray, "period z"]:
        """The rows of `cell_rows`."""
        each = zip(self.parts, self.usable, strict=True)
        return np.vstack([cell_rows(part, k, cells, self.constant) for part, k in each])

    def rows_of_modes(self, cells: Int[np.ndarray, "mode m"]) -> list[np.ndarray]:
        """The rows of each mode, shared where cells are the same."""
        kept = {own.tobytes(): own for own in cells}
        rows = {key: self.rows(own) for key, own in kept.items()}
        return [rows[own.tobytes()] for own in cells]


@dataclass(frozen=True, eq=False)
class UnevenPeriods(Periods):
    """Of uneven rows, for delays between `low` and `high`, seconds."""

    low: float
    high: float
    step: float

    @classmethod
    def between(
        cls,
        parts: tuple[Part, ...],
        low: float,
        high: float,
        pooled: Pooled | None,
        step: float,
        constant: bool,
    ) -> UnevenPeriods:
        """Those of parts, for delays between two and those of the one plant."""
        of = pooled.delays.tolist() if isinstance(pooled, PooledPlant) else []
        ends = max([high, *of]), min([low, *of])
        good = tuple(np.flatnonzero(usable(part, False, *ends)) for part in parts)
        return cls(parts, good, pooled, constant, low, high, step)

    def rows(
        self, delays: Float[np.ndarray, " m"], nodes: Float[np.ndarray, " node"]
    ) -> Float[np.ndarray, "period z"]:
        """What acts by the weights of nodes, for delays of one mode; noise scaled to a period."""
        each = zip(self.parts, self.usable, strict=True)
        return np.vstack(
            [node_rows(part, k, delays, nodes, self.step, self.constant) for part, k in each]
        )


def posterior_of(
    parts: Sequence[Part],
    laid: list[tuple[np.ndarray, np.ndarray]],
    jumps: Jumps,
    usable: Sequence[np.ndarray],
    within: bool,
) -> Posterior:
    """What densities of all periods say, if the mode stays and if it changes; part by part."""
    modes = jumps.modes
    value, weight, nodes = 0.0, [], []
    counts = Counts(np.zeros((modes, modes)), np.zeros(modes))
    for part, (stay, move), k in zip(parts, laid, usable, strict=True):
        logs, kind = jumps.over(part.time)
        same, node = np.empty(stay.shape), np.empty((len(stay) + 1, modes))
        pairs = np.empty(logs.shape)
        value += smooth(stay, move, logs, kind, _any(modes), same, node, pairs)
        counts = counts + jumps.counted(part.time, pairs)
        weight.append((same if within else node[:-1])[k])
        nodes.append(node)
    return Posterior(value, np.vstack(weight), counts, nodes)


def path_of(
    parts: Sequence[Part], laid: list[tuple[np.ndarray, np.ndarray]], jumps: Jumps
) -> list[Int[np.ndarray, " sample"]]:
    """The likeliest modes of the samples of every part."""
    found = []
    for part, (stay, move) in zip(parts, laid, strict=True):
        path = np.empty(len(stay) + 1, np.int64)
        likeliest(stay, move, *jumps.over(part.time), _any(jumps.modes), path)
        found.append(path)
    return found


def _any(modes: int) -> Float[np.ndarray, " mode"]:
    """The first mode may be any."""
    return np.full(modes, -np.log(modes))
