"""Gauss–Legendre collocation on one segment: nodes, integration matrix, interpolation.

A function on a segment is held by its values at the interior Gauss nodes and at both ends;
`interpolate` evaluates the polynomial through them (barycentric form). Integrals from the start
of the segment to a node take the values at the Gauss nodes.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class Nodes(NamedTuple):
    """Nodes of a segment mapped to [0, 1].

    points : the p Gauss nodes;  integral : Q with ∫₀^{c_k} f = Σ_j Q_kj f(c_j);
    weights : ∫₀¹ f = Σ_j w_j f(c_j);  support : 0, the points, 1;  barycentric : their weights
    """

    points: Float[np.ndarray, " p"]
    integral: Float[np.ndarray, "p p"]
    weights: Float[np.ndarray, " p"]
    support: Float[np.ndarray, " p+2"]
    barycentric: Float[np.ndarray, " p+2"]


@lru_cache
def gauss(count: int) -> Nodes:
    """The nodes of order 2·count.

    Examples
    --------
    >>> nodes = gauss(4)
    >>> bool(abs(nodes.weights @ nodes.points**7 - 1 / 8) < 1e-15)
    True
    """
    z, w = np.polynomial.legendre.leggauss(count)
    values = np.polynomial.legendre.legvander(z, count)
    # ∫_{−1}^{z} L_j = (L_{j+1}(z) − L_{j−1}(z)) / (2j + 1), and z + 1 for j = 0.
    ahead = np.empty((count, count))
    ahead[:, 0] = z + 1.0
    for j in range(1, count):
        ahead[:, j] = (values[:, j + 1] - values[:, j - 1]) / (2 * j + 1)
    expand = (values[:, :count] * w[:, None]).T * (np.arange(count)[:, None] + 0.5)
    support = np.concatenate(([0.0], (z + 1.0) / 2.0, [1.0]))
    difference = support[:, None] - support[None, :] + np.eye(count + 2)
    barycentric = 1.0 / difference.prod(axis=1)
    barycentric /= np.abs(barycentric).max()
    return Nodes((z + 1.0) / 2.0, ahead @ expand / 2.0, w / 2.0, support, barycentric)


def shares(c: np.ndarray, support: np.ndarray) -> np.ndarray:
    """The polynomials that are 1 at one support node and 0 at the others, at c, (T, nodes).

    Examples
    --------
    >>> shares(np.array([0.5]), np.array([0.0, 1.0]))
    array([[0.5, 0.5]])
    """
    same = np.eye(support.size, dtype=bool)
    apart = np.where(same, 1.0, support[:, None] - support)
    factors = np.where(same, 1.0, (c[:, None, None] - support) / apart)
    return factors.prod(axis=2)
