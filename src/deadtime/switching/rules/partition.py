"""Check that polyhedra partition the state space: none empty, no conflicts, no gap.

Each condition is whether a polyhedron {x: H x ≤ h} has an interior, which follows from the linear
programme of its largest inscribed ball (Boyd and Vandenberghe, Convex Optimization, Section 4.3.1).
Every coordinate is first scaled so that the boundaries have comparable distances; lengths are then
relative to the largest distance of a boundary from the origin. A set thinner than 1e-8 of that
counts as a shared boundary.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.errors import ArgumentError

_FLAT = 1e-8

Polyhedron = tuple[np.ndarray, np.ndarray]  # H (rows, n) and h (rows,)


def require_partition(regions: list[Polyhedron], modes: Int[np.ndarray, " region"]) -> None:
    """Refuse regions that are empty, that overlap in different modes, or that leave a gap."""
    unit = _units(np.vstack([H for H, _ in regions]), np.concatenate([h for _, h in regions]))
    norms = [np.linalg.norm(H * unit, axis=1) for H, _ in regions]
    size = max(float(np.abs(h / norm).max()) for (_, h), norm in zip(regions, norms, strict=True))
    unit = unit * (size or 1.0)
    scaled: list[Polyhedron] = []
    for i, (H, h) in enumerate(regions):
        norm = np.linalg.norm(H * unit, axis=1)
        region = H * unit / norm[:, None], h / norm
        if _inner_point(*region) is None:
            raise ArgumentError(
                f"regions[{i}] is empty: no state meets H x ≤ h with room to spare, "
                f"{_FLAT:g} of the largest distance of a boundary from 0; check the signs of its "
                "rows."
            )
        scaled.append(_without_redundant_rows(*region))
    for i, region in enumerate(scaled):
        for j in range(i):
            shared = None if modes[i] == modes[j] else _inner_point(*_both(scaled[j], region))
            if shared is not None:
                raise ArgumentError(
                    f"regions[{j}] and regions[{i}] overlap in different modes, {modes[j]} and "
                    f"{modes[i]}: both hold x = {_text_of(shared * unit)}."
                )
    n = regions[0][0].shape[1]
    missing = _uncovered_point((np.empty((0, n)), np.empty(0)), scaled)
    if missing is not None:
        raise ArgumentError(
            f"regions leave a gap: none of them holds x = {_text_of(missing * unit)}; every state "
            "needs a mode."
        )


def _units(H: np.ndarray, h: np.ndarray) -> Float[np.ndarray, " n"]:
    """Units, powers of two, of the coordinates in which the boundaries have comparable distances.

    The logarithms of the entries of [H diag(unit), h] vary least within the rows, in least squares.
    Then the farthest boundary of the rows that mostly depend on one coordinate becomes 1.
    """
    n = H.shape[1]
    entries = np.column_stack((H, h))
    nonzero = entries != 0.0
    logs = np.log2(np.abs(entries), out=np.zeros_like(entries), where=nonzero)
    # Normal equations for the logarithms of the units, of deviations from the mean of each row.
    share = nonzero / nonzero.sum(axis=1, keepdims=True)
    normal = (np.diag(nonzero.sum(axis=0)) - nonzero.T @ share)[:n, :n]
    right = np.sum(nonzero * (logs - (share * logs).sum(axis=1, keepdims=True)), axis=0)[:n]
    unit = 2.0 ** np.rint(np.linalg.lstsq(normal, -right, rcond=None)[0])
    size = np.abs(H) * unit
    along = (size >= 0.5 * size.max(axis=1, keepdims=True)) & (h != 0.0)[:, None]
    cut = np.divide(np.abs(h)[:, None], np.abs(H), out=np.zeros_like(H), where=along)
    farthest = cut.max(axis=0)
    return np.where(farthest > 0.0, 2.0 ** np.rint(np.log2(farthest + (farthest == 0.0))), unit)


def _without_redundant_rows(H: np.ndarray, h: np.ndarray) -> Polyhedron:
    """A polyhedron without the rows that others imply, to a tenth of the tolerance.

    With at most as many rows as a box, searching takes longer than keeping them.
    """
    from scipy.optimize import linprog

    keep = np.full(h.size, True)
    for i in range(h.size if h.size > 2 * H.shape[1] else 0):
        keep[i] = False
        result = linprog(-H[i], H[keep], h[keep], bounds=(None, None))
        keep[i] = result.status != 0 or -result.fun > h[i] + 0.1 * _FLAT
    return H[keep], h[keep]


def _both(first: Polyhedron, second: Polyhedron) -> Polyhedron:
    return np.vstack((first[0], second[0])), np.concatenate((first[1], second[1]))


def _inner_point(
    H: Float[np.ndarray, "row n"], h: Float[np.ndarray, " row"]
) -> Float[np.ndarray, " n"] | None:
    """The centre of the largest ball in {H x ≤ h}, of radius 1 at most; None without an interior.

    The rows of H have length 1.
    """
    if not h.size:
        return np.zeros(H.shape[1])
    opposite = (H @ H.T < -1.0 + 1e-12) & (h[:, None] + h <= _FLAT)
    if opposite.any():
        return None
    from scipy.optimize import linprog

    n = H.shape[1]
    result = linprog(
        np.append(np.zeros(n), -1.0),
        np.hstack((H, np.ones((h.size, 1)))),
        h,
        bounds=[(None, None)] * n + [(None, 1.0)],
        options={"primal_feasibility_tolerance": 1e-10},
    )
    return result.x[:n] if result.status == 0 and result.x[n] > _FLAT else None


def _uncovered_point(part: Polyhedron, regions: list[Polyhedron]) -> Float[np.ndarray, " n"] | None:
    """A point in the interior of `part` outside all regions; None if there is none."""
    point = _inner_point(*part)
    if point is None or not regions:
        return point
    (H, h), others = regions[0], regions[1:]
    if _inner_point(*_both(part, regions[0])) is None:
        return _uncovered_point(part, others)
    for row, offset in zip(H, h, strict=True):
        beyond = _uncovered_point(_both(part, (-row[None], np.array([-offset]))), others)
        if beyond is not None:
            return beyond
        part = _both(part, (row[None], np.array([offset])))
    return None


def _text_of(x: np.ndarray) -> str:
    return "[" + ", ".join(f"{value:.4g}" for value in x + 0.0) + "]"
