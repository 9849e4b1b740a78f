"""What a part's periods do in one mode: the tables that filters side by side read."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from deadtime.identification.cells import cells_of
from deadtime.identification.noisy.filter_periods import even_periods, uneven_periods
from deadtime.identification.noisy.likelihood import NoisyLog

_BLOCK = 4096  # samples whose derivatives, which nothing here needs, are there at a time


class PartPeriods(NamedTuple):
    """The periods that lead to samples.

    kind : (T,), the row of Phi and Q, how a state moves, and the noise; added : (T, n), by inputs
    """

    kind: Int[np.ndarray, " T"]
    Phi: Float[np.ndarray, "kind n n"]
    added: Float[np.ndarray, "T n"]
    Q: Float[np.ndarray, "kind n n"]


def stretch_of(
    noisy: NoisyLog,
    number: int,
    start: Bool[np.ndarray, " T"],
    theta: Float[np.ndarray, " size"],
    L: Float[np.ndarray, "n n"],
    cells: Int[np.ndarray, "one m"] | None = None,
) -> PartPeriods:
    """Those of a part of a log of one mode, W = L Lᵀ; of even rows with delays in given cells."""
    part, layout, record = noisy.recording.parts[number], noisy.layout, noisy.recording
    part = part._replace(mode=np.zeros(part.time.size, np.int64))
    if record.even:
        if cells is None:
            cells = layout.spread(cells_of(theta[layout.at_delays], record.step))
        periods_of = even_periods(layout, theta, L, cells, record.step)
    else:
        periods_of = uneven_periods(layout, theta, L, noisy.nodes)
    rows, each = np.arange(start.size), []
    for first in range(0, start.size, _BLOCK):
        own = rows[first : first + _BLOCK]
        periods = periods_of(part, own, start[own])
        each.append((periods.Phi, periods.added, periods.Q))
    Phi, added, Q = zip(*each, strict=True)
    if record.even:  # one table for all
        return PartPeriods(0 * rows, Phi[0], np.vstack(added), Q[0])
    return PartPeriods(rows, np.vstack(Phi), np.vstack(added), np.vstack(Q))
