"""A copy of what runs goes on by itself, and does as the original would have done."""

import copy
import pickle

import numpy as np
import pytest

import belief_laws
import deadtime as dt
import observed_laws
import plants


def controller(law, step=0.05):
    return dt.Controller(law, step)


# What runs, and how many numbers it measures.
MAKERS = {
    "dense": (lambda: controller(plants.LAWS["averaged"](plants.paper()), 0.1), 2),
    "factorised": (lambda: controller(plants.LAWS["averaged"](plants.paper()), 0.01), 2),
    "mode and age": (lambda: controller(plants.LAWS["mean, dwell-aware"](plants.generic())), 3),
    "observer": (lambda: controller(observed_laws.observed()), 2),
    "servo": (lambda: controller(observed_laws.servo()), 2),
    "belief": (lambda: controller(belief_laws.LAWS["mode"]()), 3),
    "belief from outputs": (lambda: controller(belief_laws.from_outputs()), 2),
    "mode filter": (lambda: belief_laws.LAWS["mode"]().filter.start(), 3),
    "output filter": (lambda: belief_laws.from_outputs().filter.start(), 2),
}
COPIES = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": lambda one: pickle.loads(pickle.dumps(one)),
}


def moved(runs, measured, seed):
    """What ten updates with random numbers and modes return."""
    rng = np.random.default_rng(seed)
    modes = rng.integers(2, size=10) if isinstance(runs, dt.Controller) else [None] * 10
    told = [{} if mode is None else {"mode": int(mode)} for mode in modes]
    return np.array([runs.update(rng.normal(size=measured), **mode) for mode in told])


@pytest.mark.parametrize("name", MAKERS)
@pytest.mark.parametrize("how", COPIES)
def test_a_copy_that_moves_leaves_the_original_as_it_is(name, how):
    (make, measured), how = MAKERS[name], COPIES[how]
    kept, alone = make(), make()
    for one in (kept, alone):
        moved(one, measured, 0)
    moved(how(kept), measured, 1)
    np.testing.assert_array_equal(moved(kept, measured, 2), moved(alone, measured, 2))
    np.testing.assert_array_equal(moved(how(kept), measured, 3), moved(kept, measured, 3))


def test_a_copy_shares_what_cannot_change():
    kept = MAKERS["factorised"][0]()
    other = copy.copy(kept)
    assert other.law is kept.law
    assert other.table is kept.table
