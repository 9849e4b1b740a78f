"""What the modes of a plant read from t_k on: the stretches in which none reads another sample.

An expectation over futures follows all modes at once, so time is cut at every arrival of an input
in any mode. In a stretch the mode i reads sample[i, j] of input j, counted from u_k: below 0 it is
in flight, from 0 on it is still to be computed.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from deadtime.plant import SampledPlant


class Reading(NamedTuple):
    """A stretch ahead.

    period : p, of [t_{k+p}, t_{k+p+1})
    length : seconds
    sample : (modes, m), what each mode reads
    arrives : (modes, m), whether it began to read that at the stretch's start
    """

    period: int
    length: float
    sample: Int[np.ndarray, "mode m"]
    arrives: Bool[np.ndarray, "mode m"]

    @property
    def to_come(self) -> Bool[np.ndarray, "mode m"]:
        """Whether what a mode reads is still to be computed at t_k."""
        return self.sample >= 0


def readings(sampled: SampledPlant) -> list[Reading]:
    """The stretches from t_k on, until every mode reads what is computed at t_k or later."""
    return list(_readings(sampled))


def _readings(sampled: SampledPlant) -> Iterator[Reading]:
    every, modes = sampled.every_stretch, range(sampled.plant.modes)
    ends = np.unique(every.stop)
    starts = np.append(0.0, ends[:-1])
    place = np.stack(
        [every.first[i] + np.searchsorted(_stops(every, i), starts, "right") for i in modes]
    )
    lag = every.lag[place].swapaxes(0, 1)  # (stretches of a period, modes, m)
    before = -1 - lag[-1]
    for p in range(sampled.longest_lag + 1):
        for start, end, own in zip(starts.tolist(), ends.tolist(), lag, strict=True):
            sample = p - own
            yield Reading(p, end - start, sample, sample > before)
            before = sample
            if (sample >= 0).all():
                return


def _stops(every, mode):
    """The ends of a mode's own stretches."""
    return every.stop[every.first[mode] : every.first[mode + 1]]
