"""Pieces of periods as data: stretches under the same inputs, and what they do to the state."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.plant.discretisation import Cuts


class Stretch(NamedTuple):
    """Seconds from the sample on between which input j is the one of `lag[j]` samples ago."""

    start: float
    stop: float
    lag: Int[np.ndarray, " m"]


class Piece(NamedTuple):
    """What a stretch does to the state: x goes to Phi x + Gamma u, u the inputs that act."""

    Phi: Float[np.ndarray, "n n"]
    Gamma: Float[np.ndarray, "n m"]
    stretch: Stretch


class Period(NamedTuple):
    """What a whole period does: x_{k+1} = Phi x_k + Σ_l Gamma[l] u_{k−lags[l]}, oldest first."""

    Phi: Float[np.ndarray, "n n"]
    Gamma: Float[np.ndarray, "lag n m"]
    lags: tuple[int, ...]


class Stretches(NamedTuple):
    """The stretches of all modes as arrays; those of mode i are first[i], …, first[i + 1] − 1."""

    first: Int[np.ndarray, " mode+1"]
    start: Float[np.ndarray, " stretch"]
    stop: Float[np.ndarray, " stretch"]
    lag: Int[np.ndarray, "stretch m"]


class Ahead(NamedTuple):
    """The stretches of [t_k, t_k + D) in which the inputs in flight at t_k act, one of each.

    start, stop : (stretches,), seconds from t_k on
    lag : (stretches, m), j of the acting u_{k−j}
    length : (kinds,), the lengths that there are, seconds; kind : (stretches,), which each has
    """

    start: Float[np.ndarray, " stretch"]
    stop: Float[np.ndarray, " stretch"]
    lag: Int[np.ndarray, "stretch m"]
    length: Float[np.ndarray, " kind"]
    kind: Int[np.ndarray, " stretch"]


class PieceTable(NamedTuple):
    """The pieces of many periods along a switching signal, each transition computed once.

    Piece q, q = first[k], …, first[k + 1] − 1 in period k, is entry e = entry[q] and takes x to
    Phi[e] x + Gamma[e] u. Where a switch leaves the acting inputs as they are, the piece goes on
    over it: entry e begins in mode[e], and the switches cut[e, 0], …, cut[e, 1] − 1 are within it.

    first : (periods + 1,)
    entry : (pieces,)
    Phi : (entries, n, n), Gamma : (entries, n, m)
    lag : (entries, m), how many samples ago the acting inputs were computed
    start, stop : (entries,), seconds from the period's sample on
    mode : (entries,)
    cut : (entries, 2)
    """

    first: Int[np.ndarray, " period+1"]
    entry: Int[np.ndarray, " piece"]
    Phi: Float[np.ndarray, "entry n n"]
    Gamma: Float[np.ndarray, "entry n m"]
    lag: Int[np.ndarray, "entry m"]
    start: Float[np.ndarray, " entry"]
    stop: Float[np.ndarray, " entry"]
    mode: Int[np.ndarray, " entry"]
    cut: Int[np.ndarray, "entry 2"]

    @property
    def period(self) -> Int[np.ndarray, " piece"]:
        """The period of every piece."""
        return np.repeat(np.arange(self.first.size - 1), np.diff(self.first))

    @property
    def sample(self) -> Int[np.ndarray, "piece m"]:
        """The k of the u_k that act in every piece, input by input."""
        return self.period[:, None] - self.lag[self.entry]

    def parts(self, entry: int, cuts: Cuts) -> list[tuple[int, float, float]]:
        """The mode and the times, start and stop, between the switches within an entry."""
        first, stop = self.cut[entry]
        modes = [self.mode[entry], *cuts.mode[first + 1 : stop + 1]]
        times = [self.start[entry], *cuts.offset[first:stop], self.stop[entry]]
        parts = zip(modes, times[:-1], times[1:], strict=True)
        return [(int(mode), float(a), float(b)) for mode, a, b in parts if b > a]
