"""Whether polyhedra share the state space out: none empty, none in conflict, no gap.

Each question is whether a polyhedron {x: H x ≤ h} has an interior, which the linear programme of
its largest inscribed ball answers (Boyd and Vandenberghe, Convex Optimization, Section 4.3.1).
Lengths are measured against the largest distance of a boundary from the origin; what is thinner
than 1e-8 of that counts as a shared boundary.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from deadtime.errors import ArgumentError

_FLAT = 1e-8

Polyhedron = tuple[np.ndarray, np.ndarray]  # H (rows, n) and h (rows,)


def require_partition(regions: list[Polyhedron], modes: Int[np.ndarray, " region"]) -> None:
    """Refuse regions that are empty, that overlap in different modes, or that leave a gap."""
    norms = [np.linalg.norm(H, axis=1) for H, _ in regions]
    unit = max(float(np.abs(h / norm).max()) for (_, h), norm in zip(regions, norms, strict=True))
    unit = unit or 1.0
    scaled = [
        (H / norm[:, None], h / norm / unit)
        for (H, h), norm in zip(regions, norms, strict=True)
    ]  # fmt: skip
    for i, region in enumerate(scaled):
        if _inner_point(*region) is None:
            raise ArgumentError(
                f"regions[{i}] is empty: no state meets H x ≤ h with room to spare; check the "
                "signs of its rows."
            )
        for j in range(i):
            shared = None if modes[i] == modes[j] else _inner_point(*_both(scaled[j], region))
            if shared is not None:
                raise ArgumentError(
                    f"regions[{j}] and regions[{i}] overlap in different modes, {modes[j]} and "
                    f"{modes[i]}: both hold x = {_written(shared * unit)}."
                )
    n = regions[0][0].shape[1]
    missing = _uncovered((np.empty((0, n)), np.empty(0)), scaled)
    if missing is not None:
        raise ArgumentError(
            f"regions leave a gap: none of them holds x = {_written(missing * unit)}; every state "
            "needs a mode."
        )


def _both(one: Polyhedron, other: Polyhedron) -> Polyhedron:
    return np.vstack((one[0], other[0])), np.concatenate((one[1], other[1]))


def _inner_point(
    H: Float[np.ndarray, "row n"], h: Float[np.ndarray, " row"]
) -> Float[np.ndarray, " n"] | None:
    """The centre of the largest ball in {H x ≤ h} (radius 1 at most), if it has an interior.

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


def _uncovered(part: Polyhedron, regions: list[Polyhedron]) -> Float[np.ndarray, " n"] | None:
    """A point in the interior of `part` that no region holds, if there is one."""
    point = _inner_point(*part)
    if point is None or not regions:
        return point
    (H, h), others = regions[0], regions[1:]
    if _inner_point(*_both(part, regions[0])) is None:
        return _uncovered(part, others)
    for row, offset in zip(H, h, strict=True):
        beyond = _uncovered(_both(part, (-row[None], np.array([-offset]))), others)
        if beyond is not None:
            return beyond
        part = _both(part, (row[None], np.array([offset])))
    return None


def _written(x: np.ndarray) -> str:
    return "[" + ", ".join(f"{value:.4g}" for value in x + 0.0) + "]"
