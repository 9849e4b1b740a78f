"""Plants, gains and dwell times that the theorem is tried on."""

import numpy as np
import pytest
from hypothesis import settings, strategies as st

import deadtime as dt
import plants
from deadtime.certificates import theorem_bound

FORMS = ("printed", "corrected", "sharp")
PROVEN = ("corrected", "sharp")
PAPER, THREE = dt.problems.paper(), dt.problems.three_mode()
CASES = {
    "paper": (PAPER.plant, PAPER.gains),
    "three-mode": (THREE.plant, THREE.gains),
    "follower": (dt.problems.follower().plant, dt.problems.follower().gains),
    "scalar": (plants.scalar([0.3, 0.5], [1.0, 1.2]), np.array([[[-1.0]], [[-1.2]]])),
    "stable": (plants.scalar([-1.0, -1.1, -0.9], 1.0, 2.0), np.full((3, 1, 1), -0.1)),
}
each_case = pytest.mark.parametrize("case", CASES.values(), ids=CASES)
seeds = st.integers(0, 2**32 - 1)
quick = settings(max_examples=40, deadline=None, derandomize=True)


def bound_of(case, form, dwell_time=0.2, lyapunov=None):
    return theorem_bound(*case, dwell_time, lyapunov, form)
