"""Streams of random numbers: functions of a seed, a name and a number."""

from hashlib import blake2b
from itertools import product

import numpy as np
import pytest
from scipy import stats

import deadtime as dt
from deadtime.numerics.streams import Words, stream


def test_streams_of_other_seeds_names_and_numbers_differ():
    keys = list(product((0, 1, 2**64), ("Noise", "Dropout", "Noise2"), (0, 1, 2)))
    firsts = {stream(*key).random() for key in keys}
    assert len(firsts) == len(keys)


def test_a_stream_is_fixed_for_good():
    """PCG64 from words of Philox, which are keyed by the seed and BLAKE2b of the rest."""
    text = repr(("Noise", 1, 0)).encode()
    key = [5, int.from_bytes(blake2b(text, digest_size=8).digest(), "little")]
    high, low, more_high, more_low = np.random.Philox(key=np.array(key, np.uint64)).random_raw(4)
    more = 2 * ((int(more_high) << 64) + int(more_low)) + 1
    step = 0x2360ED051FC65DA44385DF649FCCF645  # of PCG64
    state = (((int(high) << 64) + int(low) + more) * step + more) % 2**128
    bits = np.random.PCG64(0)
    bits.state = {**bits.state, "state": {"state": state, "inc": more % 2**128}}
    expected = np.random.Generator(bits)
    assert (stream(5, "Noise", 1).random(9) == expected.random(9)).all()
    assert stream(5, "Noise", 1).bit_generator.state["state"]["inc"] == more % 2**128


def test_seeds_beyond_a_word_have_streams_of_their_own_and_words_are_those_of_64_bits():
    seeds = [7, 2**64 + 7, 3**90, 3**150]
    assert len({stream(seed, "Noise").random() for seed in seeds}) == len(seeds)
    with pytest.raises(dt.ArgumentError, match="dtype must be uint64"):
        np.random.MT19937(Words(5, "Noise"))


def test_streams_that_are_spawned_one_after_the_other_differ():
    rng = stream(5, "Noise")
    firsts = [one.random() for count in (1, 2, 1) for one in rng.spawn(count)]
    assert len(set(firsts)) == 4
    assert firsts == [stream(5, "Noise", 0, i).random() for i in range(4)]


def test_numbers_of_neighbouring_streams_are_uncorrelated():
    table = np.stack([stream(3, "Noise", index).random(2000) for index in range(20)])
    assert stats.kstest(table.ravel(), stats.uniform.cdf).pvalue > 0.01
    correlation = np.corrcoef(table)[np.triu_indices(20, 1)]
    assert np.abs(correlation).max() * np.sqrt(2000) < 4.0
