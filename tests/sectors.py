"""Three modes, two states, one input, and sectors that meet in 0: the same rule in two forms."""

import numpy as np

import deadtime as dt
from deadtime.switching import Polyhedra

PLANE = dt.SwitchedSystem(
    [[[0.2, 1.5], [-1.5, 0.2]], [[0.1, -0.8], [1.2, 0.1]], [[0.4, 0.3], [-0.6, -0.2]]],
    [[[0.0], [1.0]], [[1.0], [0.3]], [[0.5], [-1.0]]],
    0.37,
)
EDGES = np.array([[1.0, 0.2], [-0.3, 1.0]])
SECTORS = Polyhedra(
    [
        (EDGES[:1], [0.0]),
        (np.stack((-EDGES[0], EDGES[1])), [0.0, 0.0]),
        (np.stack((-EDGES[0], -EDGES[1])), [0.0, 0.0]),
    ]
)


def sector(x):
    """The same rule as a function."""
    return 0 if EDGES[0] @ x <= 0.0 else 1 if EDGES[1] @ x <= 0.0 else 2
