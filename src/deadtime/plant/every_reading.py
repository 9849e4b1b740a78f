"""What every mode of a plant reads, side by side, where the mode is not known beforehand.

A mode that the state decides may change within a stretch of a period, and with it the delays with
which inputs are read. With what each mode reads as inputs of its own,

    dx/dt = A_σ x + B̃_σ ũ,   ũ = (u as mode 0 reads it, u as mode 1 does, …),   B̃_i = [0 … B_i … 0],

nothing that acts changes over a stretch of `SampledPlant.cut_alike`, whatever the mode becomes.
Where all modes have the same delays they all read one u: ũ = u, B̃ = B.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deadtime.base.checks import read_only
from deadtime.plant.pieces import Stretch
from deadtime.plant.sampled_plant import SampledPlant
from deadtime.plant.switched_system import SwitchedSystem


class EveryReading(NamedTuple):
    """A plant under what every mode reads.

    plant : SwitchedSystem
        With the inputs ũ; nobody reads its delays.
    stretches : tuple of Stretch
        Of a period, in any mode; `lag` (inputs of ũ,).
    readers : int
        How many modes stand side by side in ũ: all, or 1 where they read alike.
    """

    plant: SwitchedSystem
    stretches: tuple[Stretch, ...]
    readers: int

    @classmethod
    def of(cls, sampled: SampledPlant) -> EveryReading:
        """Of a plant whose periods are cut alike in all modes.

        Examples
        --------
        >>> plant = SwitchedSystem([[[0.0]], [[1.0]]], [[[1.0]], [[2.0]]], delay=[[0.2], [0.1]])
        >>> every = EveryReading.of(SampledPlant(plant, 0.1).cut_alike())
        >>> every.plant.B.tolist(), every.stretches[0].lag
        ([[[1.0, 0.0]], [[0.0, 2.0]]], array([2, 1]))
        """
        plant = sampled.plant
        if (plant.delays == plant.delays[0]).all():
            return cls(plant, sampled.stretches(0), 1)
        modes, n, m = plant.B.shape
        B = np.zeros((modes, n, modes, m))
        B[np.arange(modes), :, np.arange(modes)] = plant.B
        by_mode = [sampled.stretches(mode) for mode in range(modes)]
        stretches = tuple(
            parts[0]._replace(lag=read_only(np.concatenate([part.lag for part in parts])))
            for parts in zip(*by_mode, strict=True)
        )
        delays = np.tile(plant.delays.ravel(), (modes, 1))
        return cls(plant.like(plant.A, B.reshape(modes, n, -1), delays), stretches, modes)
