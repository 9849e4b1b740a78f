"""Ball arithmetic: matrices whose entries are intervals that contain the true value (Arb).

Numbers of a plant become balls of half a unit in the last place around the stored float. They
contain the float and the decimal that prints as it, so a proof holds for both readings.

A large matrix is positive definite beyond doubt if Cholesky's factorisation in floating point of X
− c I runs to its end, with c ≥ γ_{d+1}/(1 − γ_{d+1}) tr X, γ_k = k ε/(1 − k ε). Its backward error
is then smaller than c, whatever the order of its sums [Rump, BIT 46 (2006) 433; Higham, Accuracy
and Stability, Thm 10.3], so X ≻ 0. Powers of two make the diagonal about 1 before, without
rounding.

A small ball matrix X is positive definite if W X Wᵀ is diagonally dominant (Gershgorin) for some
lower triangular W of full rank.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

UNIT = 2.0**-53


def exact(array: np.ndarray) -> Any:
    """A float matrix as balls of radius 0."""
    from flint import arb_mat

    array = np.atleast_2d(array)
    rows, columns = array.shape
    return arb_mat(rows, columns, array.ravel().tolist())


def decimal(array: np.ndarray) -> Any:
    """A float matrix, every entry within half a unit in its last place."""
    from flint import arb, arb_mat

    array = np.atleast_2d(array)
    # 0 is exact: an absent coupling must stay absent. Half an ulp of a denormal would round to 0.
    radii = np.where(array == 0.0, 0.0, np.maximum(0.5 * np.spacing(np.abs(array)), 5e-324))
    pairs = zip(array.ravel().tolist(), radii.ravel().tolist(), strict=True)
    rows, columns = array.shape
    return arb_mat(rows, columns, [arb(mid, rad) for mid, rad in pairs])


def decimal_number(value: float) -> Any:
    """A float, within half a unit in its last place."""
    return decimal(np.array([[value]]))[0, 0]


def interval(low: float, high: float) -> Any:
    """The ball that contains [low, high]."""
    from flint import arb

    return arb(low).union(arb(high))


def symmetric(radius: Any) -> Any:
    """[−radius, radius]."""
    from flint import arb

    # float() rounds to nearest, so the next float up is at or above the bound.
    return arb(0.0, float(np.nextafter(float(radius.abs_upper()), np.inf)))


def symmetric_matrix(radii: np.ndarray) -> Any:
    """[−r, r] entry by entry."""
    from flint import arb, arb_mat

    rows, columns = radii.shape
    return arb_mat(rows, columns, [arb(0.0, r) for r in radii.ravel().tolist()])


def middle(matrix: Any) -> np.ndarray:
    """Midpoints, rounded to floats."""
    values = [float(entry.mid()) for entry in matrix.entries()]
    return np.array(values).reshape(matrix.nrows(), matrix.ncols())


def split(matrix: Any) -> tuple[np.ndarray, np.ndarray]:
    """Floats (centre, error) with every entry of the ball matrix within centre ± error."""
    entries = matrix.entries()
    shape = matrix.nrows(), matrix.ncols()
    centre = np.array([float(entry.mid()) for entry in entries])
    radius = np.array([float(entry.rad()) for entry in entries])
    # mid() has 128 bits; rounding it to a float errs by half a unit in the last place, and
    # rounding the radius by less than a thousandth of it.
    error = 1.001 * radius + np.spacing(np.abs(centre))
    return centre.reshape(shape), error.reshape(shape)


def frobenius(matrix: Any, unit: np.ndarray | float = 1.0) -> float:
    """A float above the Frobenius norm, an upper bound of the spectral one; `unit` per column."""
    centre, error = split(matrix)
    size = centre.size
    sizes = (np.abs(centre) + error) * unit
    # A sum of `size` squares errs by a relative size · 2⁻⁵³ at most, its root by half of it.
    return norm_above(sizes) * (1.0 + (size + 8) * 2.0**-52)


def norm_above(sizes: np.ndarray) -> float:
    """The Euclidean norm of non-negative floats, up to rounding; infinite unless all are finite.

    Scaled by the largest, so that no square is lost.
    """
    if not np.isfinite(sizes).all():
        return np.inf
    largest = float(sizes.max(initial=0.0))  # squares of numbers near 1e±200 would be lost
    return largest * float(np.sqrt(np.sum((sizes / largest) ** 2))) if largest else 0.0


def blocks(rows: list[list[Any]]) -> Any:
    """A ball matrix from blocks."""
    from flint import arb_mat

    table: list[list[Any]] = []
    for row in rows:
        lists = [block.tolist() for block in row]
        table += [[x for part in lists for x in part[i]] for i in range(len(lists[0]))]
    return arb_mat(table)


def zeros(rows: int, columns: int) -> Any:
    """A zero ball matrix."""
    from flint import arb_mat

    return arb_mat(rows, columns)


def top(matrix: Any, rows: int) -> Any:
    """The first rows of a ball matrix."""
    from flint import arb_mat

    return arb_mat(matrix.tolist()[:rows])


def powers_of_two(diagonal: np.ndarray) -> np.ndarray:
    """Powers of two t with t² · diagonal in [1/2, 2)."""
    # A diagonal that is not positive fails later; here it only must not raise.
    safe = np.where(diagonal > 0.0, diagonal, 1.0)
    return 2.0 ** -np.round(0.5 * np.log2(safe))


def is_positive_definite(middle: np.ndarray, error: np.ndarray) -> bool:
    """Whether every symmetric X with |X − middle| ≤ error, entry by entry, is ≻ 0.

    Parameters
    ----------
    middle : (d, d)
        The symmetric midpoint, its diagonal about 1.
    error : (d,)
        Row sums of the error's bound.
    """
    d = len(middle)
    if not np.isfinite(middle).all() or not np.isfinite(error).all():
        return False
    if (np.diag(middle) <= 0.0).any():
        return False
    # γ_{d+4} and not γ_{d+1}, and twice γ tr X below: the surplus covers the rounding of the trace,
    # of the shift and of the subtraction, at most UNIT · (largest diagonal entry) of which counts.
    gamma = (d + 4) * UNIT / (1.0 - (d + 4) * UNIT)
    trace = float(np.diag(middle).sum()) * (1.0 + 2.0 * d * UNIT)
    shift = 2.0 * gamma * trace + float(np.max(error)) * (1.0 + 4.0 * d * UNIT)
    if not np.isfinite(shift) or np.abs(middle).max() > 4.0:
        return False  # a definite matrix has no entry above its largest diagonal one, about 1
    try:
        factor = np.linalg.cholesky(middle - shift * np.eye(d))
    except np.linalg.LinAlgError:
        return False
    return bool(np.isfinite(factor).all())


def congruent(X: Any) -> tuple[float, Any] | None:
    """(a lower bound of the least eigenvalue of W X Wᵀ, Wᵀ) for a small ball X ≻ 0; else None.

    W is lower triangular with W X Wᵀ close to I.
    """
    centre = middle(X)
    if not np.isfinite(centre).all() or (np.diag(centre) <= 0.0).any():
        return None
    unit = 1.0 / np.sqrt(np.diag(centre))
    try:
        factor = np.linalg.cholesky(centre * unit * unit[:, None])
    except np.linalg.LinAlgError:
        return None
    # By numpy.linalg.inv: SciPy's triangular solver waits for threads, even at this size. That W is
    # only near the inverse does no harm: any W of full rank proves X ≻ 0.
    W = np.tril(np.linalg.inv(factor)) * unit
    if not np.isfinite(W).all() or (np.diag(W) == 0.0).any():
        return None
    left = exact(W)
    right = left.transpose()
    least = least_dominance(left * X * right)
    return (least, right) if least > 0.0 else None


def least_dominance(X: Any) -> float:
    """A lower bound of the least eigenvalue of a symmetric ball matrix, by Gershgorin."""
    size = X.nrows()
    bounds = [math.inf]
    for i in range(size):
        below = X[i, i].lower()
        for j in range(size):
            if j != i:
                below = below - X[i, j].abs_upper()
        # float() rounds to nearest, so the next float down is a lower bound.
        bounds.append(math.nextafter(float(below.lower()), -math.inf))
    return min(bounds) if not any(map(math.isnan, bounds)) else -math.inf
