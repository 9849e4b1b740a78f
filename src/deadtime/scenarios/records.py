"""Signals laid on the periods of a loop: records, and the maps that they name."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int


class Records(NamedTuple):
    """Which map takes a scenario over a period, from that period on.

    Record r of scenario s, first[s] ≤ r < first[s + 1], says that from period `step[r]` on the
    sampled mode is `mode[r]` and the map is `map[r]`. A map below the number of modes is that
    mode's. Map modes + c is that of cut period c with the sojourns sojourn[c], …, until[c] − 1 of
    the signals, of which sojourn i begins at[i] seconds into the period, the first one before it
    or at its start. A scenario's last period counts as cut, and is marked in `last`.
    """

    first: Int[np.ndarray, " scenario+1"]
    step: Int[np.ndarray, " record"]
    mode: Int[np.ndarray, " record"]
    map: Int[np.ndarray, " record"]
    sojourn: Int[np.ndarray, " cut"]
    until: Int[np.ndarray, " cut"]
    last: Bool[np.ndarray, " cut"]
    at: Float[np.ndarray, " sojourn"]

    def modes(self, samples: int) -> Int[np.ndarray, "scenario sample"]:
        """The sampled mode of every scenario at the samples 0, …, samples − 1."""
        return self._along(self.mode, samples)

    def maps(self, samples: int) -> Int[np.ndarray, "scenario period"]:
        """The map of every scenario over the periods 0, …, samples − 1."""
        return self._along(self.map, samples)

    def _along(self, values: Int[np.ndarray, " record"], samples: int) -> Int[np.ndarray, "s k"]:
        ends = np.append(self.step[1:], samples)
        ends[self.first[1:-1] - 1] = samples
        return np.repeat(values, ends - self.step).reshape(-1, samples).astype(np.int64)


class Laid(NamedTuple):
    """Signals laid on the periods 0, …, K, the last of which goes on to the horizon only.

    Row `records.map[r]` of `maps` takes the plant over a period: `move` and the upper triangle of
    `energy` with its off-diagonal doubled, flat (`cut_periods.Maps`). `age` is that of the first
    mode at time 0, in samples.
    """

    records: Records
    maps: Float[np.ndarray, "map size"]
    age: Int[np.ndarray, " scenario"]

    @property
    def scenarios(self) -> int:
        """How many there are."""
        return self.age.size
