"""The semidefinite program of a search for V along stretches, and the shape and units of V.

    maximise t
    Dᵀ (V_here − Mᵀ V_there M) D ⪰ t Dᵀ D    for leaps M with a switch,
    0 ⪯ Y ⪯ I,    SHARE · t < ε ≤ 1           at every node.

D has the directions of ξ in which a leap is constrained: first those that the functionals H see
before and after it; then, if the full inequality fails, the directions in which it fails. A few
rounds give the full inequality with small cones.

V at the nodes is a linear function of the unknowns. Every node (i, k) has X_{i,k} = Hᵀ Y_{i,k} H +
ε_{i,k} I with Y ⪰ 0 and ε > 0 unknown, in units of ξ in which I is natural. H is all of ξ where the
order is small; else the few functionals that the loop carries over two stretches, since the rest of
the delay line is gone by then. Where mode i may last, V at its last node is a sum over the future,

    V = Σ_k (M_iᵀ)^k X M_i^k/ρ^{2k},    so that    V − M_iᵀ V M_i/ρ² = X ≻ 0;

any V with that inequality is such a sum, of X = V − M_iᵀ V M_i/ρ². At the nodes before it, with L
the product of the full steps to the next one, V_k = X + Lᵀ V_{k+1} L/ρ^{2·periods}. So the
inequalities of stretches without a switch hold for all unknowns, and V weighs a long delay line as
the loop does. Only the stretches with a switch are constraints of the program.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deadtime.certificates.dwell.leaps import Node
from deadtime.certificates.dwell.solvers import maximise, squares
from deadtime.certificates.proof.evidence import Setting
from deadtime.numerics.lmi import pack, packing, unpack

DOUBLINGS = 60
FLOOR = 1e-7  # ε at least
WHOLE, WHOLE_WITH_STATE = 12, 20  # order up to which H is all of ξ; for a law with a state
MOST = 12  # functionals, above it
CARRIED = 1e-9  # relative to the strongest: weaker functionals are not carried on
TURNS = 40  # of the power iteration
SEEN = 1e-2  # relative to the strongest functional: weaker ones add no direction
SHARE = 1e-3  # of the margin t, for the stretches without a switch
ADDED = 4  # directions per leap and round, at most


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
        The contribution to X of each entry of Y, and then of ε.
    sums : mapping
        From a node at which the mode may last to their contributions to V, (entries + 1, d, d).
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
        """V at the nodes, last knots first; Y and ε are projected to their range."""
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


def whole(setting: Setting) -> int:
    """The order up to which V along stretches is any matrix.

    Larger for a law with a state, all of which acts at once; a delay line is soon emptied.
    """
    return WHOLE_WITH_STATE if setting.memory else WHOLE


def balancing_units(loops: list[np.ndarray]) -> np.ndarray:
    """Units (d,) in which rows and columns of the loops are about equally large."""
    from scipy.linalg import matrix_balance

    total = np.sum([np.abs(M) for M in loops], axis=0)
    _, (scale, _) = matrix_balance(total, permute=False, separate=True)
    return 1.0 / scale


def metric(lasting: list[np.ndarray], leaps: list[tuple[Node, Node, np.ndarray]]) -> np.ndarray:
    """T with |T ξ|² the sum of |ξ|² over the future, in constant modes or over mean leaps."""
    eye = np.eye(len(leaps[0][2]))
    sums = [future_sums(M, eye) for M in lasting]
    total = [part for part in sums if part is not None]
    if not total:  # Σ_k 𝒯^k(I) γ^k, 𝒯 the mean of MᵀXM over the leaps, γ such that it converges

        def mean(X: np.ndarray) -> np.ndarray:
            return np.mean([M.T @ X @ M for _, _, M in leaps], axis=0)

        X, growth = eye, 1.0
        for _ in range(TURNS):
            X = mean(X)
            growth = max(float(np.trace(X)), 1e-300)
            X = X / growth
        weight, whole_sum, term = 0.9 / max(growth, 0.9), eye, eye
        for _ in range(TURNS):
            term = weight * mean(term)
            whole_sum = whole_sum + term
        total = [whole_sum]
    return np.linalg.cholesky(np.mean(total, axis=0)).T


def functionals(
    switching: list[tuple[Node, Node, np.ndarray]], d: int, most: int = WHOLE
) -> np.ndarray:
    """H (s, d), orthonormal: all of ξ up to an order, or the leading functionals of two leaps."""
    if d <= most:
        return np.eye(d)
    once: dict[Node, np.ndarray] = {}
    twice = np.zeros((d, d))
    for here, _, M in switching:
        once[here] = once.get(here, np.zeros((d, d))) + M.T @ M
    for _, there, M in switching:
        twice += M.T @ once.get(there, np.zeros((d, d))) @ M
    values, vectors = np.linalg.eigh(twice)
    keep = values > CARRIED * values[-1]
    return vectors[:, keep][:, -MOST:].T


@dataclass(eq=False)
class Looked:
    """A leap that constrains the program, in its units, and the directions D (d, r)."""

    here: Node
    there: Node
    M: np.ndarray
    D: np.ndarray

    @classmethod
    def at(cls, here: Node, there: Node, M: np.ndarray, shape: LyapunovShape) -> Looked:
        """Constrained in the directions that H sees before it, after it, and at the next node."""
        rows = [shape.H, shape.H @ M]
        if there in shape.links:
            rows.append(shape.H @ shape.links[there] @ M)
        _, sizes, right = np.linalg.svd(np.concatenate(rows), full_matrices=False)
        return cls(here, there, M, right[sizes > SEEN * sizes[0]].T)

    def widen(self, vectors: np.ndarray) -> None:
        """Add directions."""
        self.D = np.linalg.qr(np.concatenate((self.D, vectors), axis=1))[0]


def decrease(V: dict[Node, np.ndarray], here: Node, there: Node, M: np.ndarray) -> np.ndarray:
    """V_here − Mᵀ V_there M."""
    X = V[here] - M.T @ V[there] @ M
    return 0.5 * (X + X.T)


def solve(shape: LyapunovShape, leaps: list[Looked]) -> tuple[float, np.ndarray] | None:
    """(t, the nodes' unknowns); None if the solver has no answer."""
    from scipy.sparse import csc_matrix, vstack

    unknowns = len(shape.nodes) * shape.unknowns + 1
    blocks, constants, cones = [], [], []
    for looked in leaps:
        r = looked.D.shape[1]
        M = np.zeros((unknowns, r, r))
        for sign, node, D in (
            (1.0, looked.here, looked.D),
            (-1.0, looked.there, looked.M @ looked.D),
        ):
            for at, part in shape.form(node, D):
                M[at : at + shape.unknowns] += sign * part
        M[-1] = -looked.D.T @ looked.D
        block = pack(M)
        blocks.append(csc_matrix(-block))
        constants.append(np.zeros(len(block)))
        cones.append(r)
    s = len(shape.H)
    rows, columns, _ = packing(s)
    eye, whole = (rows == columns).astype(float), pack(squares(np.eye(s)))
    for node in shape.nodes:
        at = shape.start(node)
        block = np.zeros((len(eye), unknowns))
        block[:, at : at + len(eye)] = whole
        least = np.zeros((1, unknowns))
        least[0, at + len(eye)] = 1.0
        room = -least
        room[0, -1] = SHARE
        blocks += [csc_matrix(part) for part in (-block, block, room, least)]
        constants += [np.zeros(len(eye)), eye, np.array([-FLOOR]), np.ones(1)]
        cones += [s, s, 1, 1]
    A = csc_matrix(vstack(blocks))
    answer = maximise(A, np.concatenate(constants), cones)
    return None if answer is None else (float(answer[0][-1]), answer[0][:-1])
