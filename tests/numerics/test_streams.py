"""Streams of random numbers: functions of a seed, a name and a number."""

from itertools import product

import numpy as np
from scipy import stats

from deadtime.numerics.streams import stream


def test_streams_of_other_seeds_names_and_numbers_differ():
    keys = list(product((0, 1, 2**64), ("Noise", "Dropout", "Noise2"), (0, 1, 2)))
    firsts = {stream(*key).random() for key in keys}
    assert len(firsts) == len(keys)


def test_a_stream_is_fixed_for_good():
    """By what it is made of: BLAKE2b of the name, and a key of NumPy's seeds."""
    noise = 0x6D0E06BB184D3DDD  # eight bytes, the least first
    expected = np.random.default_rng(np.random.SeedSequence(5, spawn_key=(noise, 1)))
    assert (stream(5, "Noise", 1).random(9) == expected.random(9)).all()


def test_numbers_of_neighbouring_streams_are_uncorrelated():
    table = np.stack([stream(3, "Noise", index).random(2000) for index in range(20)])
    assert stats.kstest(table.ravel(), stats.uniform.cdf).pvalue > 0.01
    correlation = np.corrcoef(table)[np.triu_indices(20, 1)]
    assert np.abs(correlation).max() * np.sqrt(2000) < 4.0
