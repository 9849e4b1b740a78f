"""The periods of an evenly sampled log from which modes are told, and the chain over them.

In each mode a period is normal about what the mode foretells, e = x_{k+1} − P_i r_k ~ N(0, S_i),
r_k = (x_k, u_{k−N}, u_{k−N+1}). With `within` the mode may change at any time: a period that begins
and ends in other modes has a density that no unknown is in, that of one regression for all modes.
Without it the mode of a row holds for its period. A period of which something is missing says
nothing, and the chain goes on.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import read_only
from deadtime.base.frozen import Frozen
from deadtime.identification.hidden.chain import likeliest, smooth
from deadtime.identification.recording import Part
from deadtime.identification.regression import rows_of

_FLOOR = 1e-300  # of a probability, whose logarithm is taken


class Posterior(NamedTuple):
    """What a log says of its modes under some unknowns.

    value : log likelihood
    weight : (periods, modes), how likely each usable period was in a mode from end to end
    pairs : (modes, modes), how many jumps are expected
    node : of every part (samples, modes), how likely each mode was
    """

    value: float
    weight: Float[np.ndarray, "period mode"]
    pairs: Float[np.ndarray, "mode mode"]
    node: list[Float[np.ndarray, "sample mode"]]


class Pooled(NamedTuple):
    """One regression for all modes, in the cells that its inputs have, (m,)."""

    P: Float[np.ndarray, "n r"]
    S: Float[np.ndarray, "n n"]
    cells: Int[np.ndarray, " m"]


@dataclass(frozen=True, eq=False)
class Periods(Frozen):
    """The periods k of every part that are usable whatever the delays in a range are.

    first, last : cells of the range
    pooled : the density of periods within which the mode changes; None if it does at samples only
    """

    parts: tuple[Part, ...]
    usable: tuple[Int[np.ndarray, " period"], ...]
    first: int
    last: int
    pooled: Pooled | None

    @classmethod
    def of(cls, parts: tuple[Part, ...], first: int, last: int, pooled: Pooled | None) -> Periods:
        """Those of parts, for delays in a range of cells and in those of the one regression."""
        if pooled is not None:
            first, last = min(first, *pooled.cells.tolist()), max(last, *pooled.cells.tolist())
        usable = tuple(rows_of(part, first - 1, last, within=False) for part in parts)
        return cls(parts, usable, first, last, pooled)

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
        P, S, cells = self.pooled
        return read_only(log_density(self.rows(cells), P, S))

    def rows(self, cells: Int[np.ndarray, " m"]) -> Float[np.ndarray, "period z"]:
        """z = (x_{k+1}, x_k, u_{k−N}, u_{k−N+1}), N the cell of each input."""
        column, rows = np.arange(cells.size), []
        for part, k in zip(self.parts, self.usable, strict=True):
            read = [part.input[k[:, None] - lag, column] for lag in (cells, cells - 1)]
            rows.append(np.hstack((part.output[k + 1], part.output[k], *read)))
        return np.vstack(rows)

    def posterior(
        self,
        density: Float[np.ndarray, "period mode"],
        chain: Float[np.ndarray, "mode mode"],
    ) -> Posterior:
        """What the log says, given log densities of usable periods and the chain's P.

        The first mode of a part may be any.
        """
        modes = density.shape[1]
        value, weight, nodes, pairs = 0.0, [], [], np.zeros((modes, modes))
        for stay, move, k in self._laid(density):
            same, node = np.empty(stay.shape), np.empty((len(stay) + 1, modes))
            own = np.empty((modes, modes))
            value += smooth(stay, move, *_logs(chain), same, node, own)
            pairs += own
            weight.append((same if self.within else node[:-1])[k])
            nodes.append(node)
        return Posterior(value, np.vstack(weight), pairs, nodes)

    def path(
        self,
        density: Float[np.ndarray, "period mode"],
        chain: Float[np.ndarray, "mode mode"],
    ) -> list[Int[np.ndarray, " sample"]]:
        """The likeliest modes of the samples of every part."""
        found = []
        for stay, move, _ in self._laid(density):
            path = np.empty(len(stay) + 1, np.int64)
            likeliest(stay, move, *_logs(chain), path)
            found.append(path)
        return found

    def _laid(self, density: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Of every part the densities of all periods, and which are usable."""
        modes, laid, start = density.shape[1], [], 0
        for part, k in zip(self.parts, self.usable, strict=True):
            stay = np.zeros((part.time.size - 1, modes))
            stay[k] = density[start : start + k.size]
            move = stay
            if self.within:
                move = np.zeros(stay.shape)
                move[k] = self._mixed[start : start + k.size, None]
            laid.append((stay, move, k))
            start += k.size
        return laid


def _logs(chain: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Logarithms of the chain, and of a first mode that may be any."""
    modes = len(chain)
    return np.log(np.maximum(chain, _FLOOR)), np.full(modes, -np.log(modes))


def next_chain(pairs: Float[np.ndarray, "mode mode"]) -> Float[np.ndarray, "mode mode"]:
    """The likeliest P of expected jumps."""
    total = pairs.sum(axis=1, keepdims=True)
    return np.where(total > 0.0, pairs / np.where(total > 0.0, total, 1.0), np.eye(len(pairs)))


def log_density(
    z: Float[np.ndarray, "period z"], P: Float[np.ndarray, "n r"], S: Float[np.ndarray, "n n"]
) -> Float[np.ndarray, " period"]:
    """log N(x_{k+1} − P r_k; 0, S) of rows z = (x_{k+1}, r_k)."""
    n, L = len(P), np.linalg.cholesky(S)
    white = np.linalg.solve(L, (z[:, :n] - z[:, n:] @ P.T).T)
    constant = 2.0 * np.log(np.diagonal(L)).sum() + n * np.log(2.0 * np.pi)
    return -0.5 * ((white**2).sum(axis=0) + constant)
