"""Batches of switching signals, compared."""

import numpy as np


def equal(one, other):
    """Whether two batches are the same, bit for bit."""
    return all(
        np.array_equal(getattr(one, name), getattr(other, name))
        for name in ("first", "times", "modes", "end", "initial_age")
    )
