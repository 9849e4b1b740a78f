"""Ball arithmetic: matrices whose entries are intervals that hold the true value (Arb).

Numbers of a plant become balls of half a unit in the last place around the stored float. The
decimal that prints as the float lies in it, and so does the float: what is proved with it holds
for both readings.
"""

from __future__ import annotations

from typing import Any

import numpy as np


def exact(array: np.ndarray) -> Any:
    """A float matrix as it is."""
    from flint import arb_mat

    array = np.atleast_2d(array)
    rows, columns = array.shape
    return arb_mat(rows, columns, array.ravel().tolist())


def decimal(array: np.ndarray) -> Any:
    """A float matrix, every entry within half a unit in its last place."""
    from flint import arb, arb_mat

    array = np.atleast_2d(array)
    radii = np.where(array == 0.0, 0.0, np.maximum(0.5 * np.spacing(np.abs(array)), 5e-324))
    pairs = zip(array.ravel().tolist(), radii.ravel().tolist(), strict=True)
    rows, columns = array.shape
    return arb_mat(rows, columns, [arb(mid, rad) for mid, rad in pairs])


def decimal_number(value: float) -> Any:
    """A float, within half a unit in its last place."""
    return decimal(np.array([[value]]))[0, 0]


def interval(low: float, high: float) -> Any:
    """The ball that holds [low, high]."""
    from flint import arb

    return arb(low).union(arb(high))


def symmetric(radius: Any) -> Any:
    """[−radius, radius]."""
    from flint import arb

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
    return norm_above(sizes) * (1.0 + (size + 8) * 2.0**-52)


def norm_above(sizes: np.ndarray) -> float:
    """The Euclidean norm of non-negative floats, up to rounding; infinite unless all are finite.

    Scaled by the largest, so that no square is lost.
    """
    if not np.isfinite(sizes).all():
        return np.inf
    largest = float(sizes.max(initial=0.0))
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
