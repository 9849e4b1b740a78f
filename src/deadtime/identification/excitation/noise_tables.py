"""What white noise adds in a period, and how that moves with a plant and with its intensity.

    Q = ∫₀^h e^{As} W e^{Aᵀs} ds,    W = L Lᵀ,    ∂Q/∂A_ab = ∫₀^h (∂Φ W Φᵀ + Φ W ∂Φᵀ) ds

The latter is in the covariance that noise of intensity diag(0, W) adds to [[A, E_ab], [0, A]].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.identification.parameters import Layout
from deadtime.numerics.covariance import noise_covariances


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
            Q[i], by_Q = noise_and_slopes(A[i], L, step)
            of_Q[i, i * square : (i + 1) * square], of_Q[i, of_L] = np.split(by_Q, [square])
        return cls(Q, wide, of_Q)


def noise_and_slopes(
    A: Float[np.ndarray, "n n"], L: Float[np.ndarray, "n n"], step: float
) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "slope n n"]]:
    """Q, and its derivatives by A and by the lower triangle of L, the diagonal by its logarithm.

    Examples
    --------
    >>> Q, by_Q = noise_and_slopes(np.zeros((1, 1)), np.array([[2.0]]), 0.5)
    >>> Q.ravel(), by_Q.ravel()    # W h, its derivatives W h² and 2 W h
    (array([2.]), array([1., 4.]))
    """
    n = len(A)
    joint, noise = np.zeros((n * n, 2 * n, 2 * n)), np.zeros((2 * n, 2 * n))
    a, b = np.divmod(np.arange(n * n), n)
    joint[:, :n, :n] = joint[:, n:, n:] = A
    joint[np.arange(n * n), a, n + b] = 1.0
    noise[n:, n:] = L @ L.T
    found = noise_covariances(joint, noise, np.full(n * n, step))
    of_L = []
    for row, column in zip(*(place.tolist() for place in np.tril_indices(n)), strict=True):
        change = np.zeros((n, n))
        change[row] = L[:, column] * (L[row, row] if row == column else 1.0)
        of_L.append(noise_covariances(A[None], change + change.T, np.array([step]))[0])
    return found[0, n:, n:], np.concatenate((found[:, :n, n:] + found[:, n:, :n], of_L))
