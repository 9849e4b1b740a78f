"""What an ellipsoid of plants does to the steps that a search looks at."""

from __future__ import annotations

from typing import Any

import numpy as np

from deadtime.certificates.proof.box import Box
from deadtime.certificates.proof.covering import enclosures_of
from deadtime.certificates.proof.ellipsoid import Sway
from deadtime.certificates.proof.family import Family
from deadtime.certificates.proof.step_enclosure import ParameterCell
from deadtime.numerics.precision import precision


class Sways:
    """W and X of `proof.ellipsoid` at points of the steps, beside `Steps.corners`."""

    def __init__(self, family: Family | Box) -> None:
        self.family = family
        self.enclosures = None if family.axes is None else enclosures_of(family)

    def at(self, order: Any, instants: np.ndarray) -> list[Sway | None]:
        """One for every sample that `family.corners(order, instants)` gives."""
        us = instants.tolist() if self.family.switches(order) else [0.0]
        ends = self.family.ends(order)
        if self.enclosures is None:
            return [None] * (len(us) * len(ends) * len(self.family.A))
        with precision():
            return [self._at(order, u, f) for u in us for f in ends]

    def _at(self, order: Any, u: float, f: float | tuple[float, ...]) -> Sway | None:
        assert self.enclosures is not None
        places = f if isinstance(f, tuple) else (f,) * len(self.family.moving(order))
        cell = ParameterCell(order, (u, u), tuple((place, place) for place in places), np.eye(1))
        columns = self.enclosures.of(cell).sway
        return None if columns is None else Sway.of(columns, self.family.A.shape[2])
