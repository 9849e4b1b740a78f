"""What white noise adds in a period, and how that moves with a plant and with its intensity."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.identification.likelihoods.filter_periods import noise_tables
from deadtime.identification.parameters import Layout


class NoiseTables(NamedTuple):
    """Q of every mode; `wide`, the unknowns that it or a sensor depends on; of_Q by those.

    Unknowns behind the plant's are the lower triangle of L, its diagonal by its logarithm, then
    the logarithms of the sensors' standard deviations.
    """

    Q: Float[np.ndarray, "mode n n"]
    wide: Int[np.ndarray, " q"]
    of_Q: Float[np.ndarray, "mode q n n"]

    @classmethod
    def of(
        cls,
        layout: Layout,
        A: Float[np.ndarray, "mode n n"],
        L: Float[np.ndarray, "n n"],
        step: float,
    ) -> NoiseTables:
        """Those of periods of `step` seconds, with one W for all modes."""
        n, square = layout.n, layout.n**2
        triangle = n * (n + 1) // 2
        wide = np.append(layout.of_A.ravel(), layout.size + np.arange(triangle + n))
        Q, of_Q = np.empty(A.shape), np.zeros((layout.modes, wide.size, n, n))
        of_L = layout.modes * square + np.arange(triangle)
        for i in range(layout.modes):
            (Q[i],), (by_Q,) = noise_tables(A[i], L, np.array([step]))
            of_Q[i, i * square : (i + 1) * square], of_Q[i, of_L] = np.split(by_Q, [square])
        return cls(Q, wide, of_Q)
