"""The shifted exponential of the command line is SciPy's, without SciPy."""

import numpy as np
from scipy.stats import expon

from deadtime import SemiMarkov
from deadtime.switching.models.sojourns import ShiftedExponential, describe


def test_it_is_the_distribution_of_scipy():
    own, other = ShiftedExponential(0.3, 0.5), expon(loc=0.3, scale=0.5)
    times = np.array([0.0, 0.2, 0.3, 0.31, 1.0, 9.0, 40.0])
    for name in ("cdf", "sf", "logsf"):
        np.testing.assert_allclose(getattr(own, name)(times), getattr(other, name)(times), 1e-14)
    assert own.mean() == other.mean()
    assert describe(own) == describe(other)


def test_it_draws_the_same_signals():
    draws = [
        SemiMarkov(dist, modes=3).sample(20.0, seed=4)
        for dist in (ShiftedExponential(0.3, 0.5), expon(loc=0.3, scale=0.5))
    ]
    assert np.array_equal(draws[0].times, draws[1].times)
    assert np.array_equal(draws[0].modes, draws[1].modes)
