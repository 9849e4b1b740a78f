"""The semidefinite program of a search for V along stretches.

    maximise t
    Dᵀ (V_here − Mᵀ V_there M) D ⪰ t Dᵀ D    for leaps M with a switch,
    0 ⪯ Y ⪯ I,    SHARE · t < ε ≤ 1           at every node (`shape`).

D has the directions of ξ in which a leap is looked at. First those that the functionals H see
before and after it; then, where the inequality fails in full, the directions in which it does.
A few rounds bring the full inequality with programs of small cones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deadtime.certificates.dwell.cones import maximise, squares
from deadtime.certificates.dwell.leaps import Node
from deadtime.certificates.dwell.lyapunov_shape import FLOOR, LyapunovShape
from deadtime.numerics.lmi import pack, packing

SEEN = 1e-2  # of the strongest functional: weaker ones open no direction
SHARE = 1e-3  # of the margin t, for the stretches without a switch
ADDED = 4  # directions per leap and round, at most


@dataclass(eq=False)
class Looked:
    """A leap that the program looks at, in its units, and the directions D (d, r)."""

    here: Node
    there: Node
    M: np.ndarray
    D: np.ndarray

    @classmethod
    def at(cls, here: Node, there: Node, M: np.ndarray, shape: LyapunovShape) -> Looked:
        """In the directions that H sees before it and after it, at the next node too."""
        rows = [shape.H, shape.H @ M]
        if there in shape.links:
            rows.append(shape.H @ shape.links[there] @ M)
        _, sizes, right = np.linalg.svd(np.concatenate(rows), full_matrices=False)
        return cls(here, there, M, right[sizes > SEEN * sizes[0]].T)

    def widen(self, vectors: np.ndarray) -> None:
        """Look in these directions, too."""
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
