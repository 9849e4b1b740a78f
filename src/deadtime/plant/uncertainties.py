"""The registries of kinds of plant sets and of plant uncertainties."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from deadtime.plant.plant_set import PlantSet, PlantUncertainty, Polytope
from deadtime.plant.uncertain import Ellipsoid, UncertainPlant

UNCERTAINTIES: tuple[type[PlantUncertainty], ...] = (UncertainPlant,)
SETS: tuple[type[PlantSet], ...] = (Polytope, Ellipsoid)
KEYS = tuple(key for kind in SETS for key in kind.keys)  # of all kinds, in files


def read_set(A: np.ndarray, B: np.ndarray, arrays: Mapping[str, np.ndarray]) -> PlantSet:
    """The set with these vertices and `PlantSet.arrays`; a ValueError if no kind has them."""
    for kind in SETS:
        if set(kind.keys) == set(arrays):
            return kind(A, B, **arrays)
    raise ValueError(f"no set of plants has {' and '.join(arrays)} together")
