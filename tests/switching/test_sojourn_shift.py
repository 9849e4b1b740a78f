"""The shifted exponential of the command line is SciPy's, without SciPy."""

import numpy as np
import pytest
from scipy.stats import expon, gamma

from deadtime import SemiMarkov
from deadtime.switching.models.sojourns import ShiftedExponential, describe, in_words


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


@pytest.mark.parametrize("sojourn", [expon(1.0, 1.0), expon(loc=1.0), gamma(1.0, 1.0)])
def test_a_shift_is_in_words_however_it_is_given(sojourn):
    assert in_words(sojourn).startswith("1 s plus ")
    assert in_words(sojourn).endswith(", mean 2 s")
