"""What a law knows at a sample, of which the uncertainty of its prediction is made."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class Known(NamedTuple):
    """The rows that may apply, with the state in each, and the inputs in flight.

    A law that is told the mode has one row; of one on a belief each has its `share`.

    row : (cases,), of the law's table
    share : (cases,), probabilities
    x : (cases, n), the state, or its estimate
    P : (cases, n, n), the covariance of the state about it
    past : (N, m), the inputs as applied, the oldest first
    """

    row: Int[np.ndarray, " case"]
    share: Float[np.ndarray, " case"]
    x: Float[np.ndarray, "case n"]
    P: Float[np.ndarray, "case n n"]
    past: Float[np.ndarray, "N m"]
