"""V at the nodes, as a linear function of the unknowns of a semidefinite program.

Every node (i, k) has X_{i,k} = Hᵀ Y_{i,k} H + ε_{i,k} I with Y ⪰ 0 and ε > 0 unknown, in units of
ξ in which I is natural. H is all of ξ where the order is small; else the few functionals that the
loop carries over two stretches, for what else is in the delay line is gone by then. Where mode i
may last, V at its last node is the sum over what comes,

    V = Σ_k (M_iᵀ)^k X M_i^k/ρ^{2k},    so that    V − M_iᵀ V M_i/ρ² = X ≻ 0;

any V with that inequality is such a sum, of X = V − M_iᵀ V M_i/ρ². At the nodes before it, with L
the product of the full steps to the next one, V_k = X + Lᵀ V_{k+1} L/ρ^{2·periods}. So the
stretches without a switch hold for all unknowns, and what V makes of a long delay line is what
the loop makes of it. Only the stretches with a switch are left to the program.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deadtime.certificates.dwell.cones import squares
from deadtime.certificates.dwell.leaps import Node
from deadtime.numerics.lmi import packing, unpack

DOUBLINGS = 60
FLOOR = 1e-7  # ε at least


def future_sums(M: np.ndarray, X: np.ndarray) -> np.ndarray | None:
    """Σ_k (Mᵀ)^k X M^k for each X (…, d, d), by doubling; None where it diverges."""
    total, power = X, M
    for _ in range(DOUBLINGS):
        if not np.isfinite(power).all() or np.abs(power).max() > 1e30:
            return None
        more = power.T @ total @ power
        total = total + more
        if np.abs(more).max() <= 1e-17 * np.abs(total).max():
            return total
        power = power @ power
    return None


@dataclass(frozen=True, eq=False)
class LyapunovShape:
    """V at the nodes; matrices are in the program's units, divided by powers of ρ.

    Attributes
    ----------
    H : (s, d)
    basis : (entries + 1, d, d)
        What each entry of Y, and then ε, adds to X.
    sums : mapping
        From a node at which the mode may last to what they add to V, (entries + 1, d, d).
    links : mapping
        From a node to the product L of the full steps to the next node of the mode.
    nodes : tuple
        All (mode, knot).
    """

    H: np.ndarray
    basis: np.ndarray
    sums: dict[Node, np.ndarray]
    links: dict[Node, np.ndarray]
    nodes: tuple[Node, ...]

    @classmethod
    def of(
        cls,
        H: np.ndarray,
        loops: dict[Node, np.ndarray],
        links: dict[Node, np.ndarray],
        nodes: tuple[Node, ...],
    ) -> LyapunovShape | None:
        """The shape for the loops M_i of nodes where a mode may last; None if one grows."""
        basis = np.concatenate((squares(H), np.eye(H.shape[1])[None]))
        sums: dict[Node, np.ndarray] = {}
        for node, M in loops.items():
            sums_of_node = future_sums(M, basis)
            if sums_of_node is None:
                return None
            sums[node] = sums_of_node
        return cls(H, basis, sums, links, nodes)

    @property
    def unknowns(self) -> int:
        """The length of a node's part of the unknowns."""
        return len(self.basis)

    def start(self, node: Node) -> int:
        """Where a node's part begins."""
        return self.nodes.index(node) * self.unknowns

    def form(self, node: Node, D: np.ndarray) -> list[tuple[int, np.ndarray]]:
        """Dᵀ V D, linear in the unknowns: parts (start, coefficients (entries + 1, r, r))."""
        if node in self.sums:
            return [(self.start(node), D.T @ self.sums[node] @ D)]
        own = np.concatenate((squares(self.H @ D), (D.T @ D)[None]))
        if node not in self.links:
            return [(self.start(node), own)]
        mode, knot = node
        return [(self.start(node), own), *self.form((mode, knot + 1), self.links[node] @ D)]

    def values(self, x: np.ndarray) -> dict[Node, np.ndarray]:
        """V at the nodes, by the last knots first; Y and ε are moved into their range."""
        V_at: dict[Node, np.ndarray] = {}
        for node in sorted(self.nodes, key=lambda node: -node[1]):
            at = self.start(node)
            part = self._inside(x[at : at + self.unknowns])
            V = np.tensordot(part, self.sums.get(node, self.basis), 1)
            if node in self.links:
                L = self.links[node]
                V = V + L.T @ V_at[node[0], node[1] + 1] @ L
            V_at[node] = 0.5 * (V + V.T)
        return V_at

    def _inside(self, part: np.ndarray) -> np.ndarray:
        s = len(self.H)
        rows, columns, _ = packing(s)
        values, vectors = np.linalg.eigh(unpack(part[:-1], s))
        Y = (vectors * np.maximum(values, 0.0)) @ vectors.T
        return np.append(Y[rows, columns], max(part[-1], FLOOR))
