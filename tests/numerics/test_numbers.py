"""Numbers of eight scenarios: what compiled loops make of them is what they make of one float."""

import math

import numpy as np
import pytest

from deadtime.numerics.kernels import inner_kernel, kernel
from deadtime.numerics.lanes import LANES, lanes_of
from deadtime.numerics.numbers import arrays_of, exponent, mantissa, ratio, where


@inner_kernel
def work(a, b, result):
    """Every operator and function of numbers, branches on indices and choices on values."""
    total, finite, some = 0.0, True, False
    for i in range(a.size):
        total += a[i] * b[i] - 1.0
        total -= 0.25 if i == 0 else a[i] / (1.0 + abs(b[i]))
        finite = finite & math.isfinite(a[i])
        some = some | (a[i] > 1.0)
    size = abs(total) + 1e-3
    result[0] = where(finite, total, -1.0)
    result[1] = where(some & (b[0] >= 0.0), max(total, 0.5), min(total, -0.5))
    result[2] = ratio(1.0, total)
    result[3] = math.log(size)
    result[4] = math.exp(min(total, 0.0))
    result[5] = mantissa(size)
    result[6] = exponent(size)
    result[7] = -total
    result[8] *= 2.0
    result[9] = where(total < 0.0, 1.0, 0.0)


@kernel(eager=True)
def of_eight(a, b, result):
    work(lanes_of(a), lanes_of(b), lanes_of(result))


@kernel(eager=True)
def of_one(a, b, result):
    work(a, b, result)


@inner_kernel
def transcend(a, result):
    result[0], result[1] = math.log(a[0]), math.exp(min(a[0], 0.0))


@kernel(eager=True)
def transcend_of_eight(a, result):
    transcend(lanes_of(a), lanes_of(result))


@pytest.mark.parametrize("number", [math.nan, math.inf])
def test_what_is_no_number_or_infinite_stays_so_in_the_lane_that_has_it(number):
    a, result = np.full((1, LANES), 0.5), np.empty((2, LANES))
    a[0, 3] = number
    transcend_of_eight(a, result)
    expected = [np.log(a[0]), np.exp(np.minimum(a[0], 0.0))]
    np.testing.assert_allclose(result, expected, rtol=1e-15)


def drawn(seed):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, 5, LANES)) * 10.0 ** rng.integers(-3, 4, size=(2, 5, LANES))
    return a, b, np.ones((10, LANES))


@pytest.mark.parametrize("seed", range(20))
def test_eight_numbers_are_what_each_is_by_itself_compiled_and_not(seed):
    a, b, result = drawn(seed)
    a[2, 3] = (math.nan, math.inf, 0.0)[seed % 3]
    of_eight(a, b, result)
    for lane in range(LANES):
        for run in (of_one, work.function):
            own, finite = np.ones(10), np.isfinite(a[:, lane]).all()
            if not finite and run is not of_one:
                continue
            run(a[:, lane].copy(), b[:, lane].copy(), own)
            told = slice(None) if finite else [0, 1, 8]  # a logarithm asks for a number
            np.testing.assert_allclose(result[told, lane], own[told], rtol=4e-14, atol=1e-300)


@kernel(eager=True)
def functions(x, result):
    numbers, results = lanes_of(x), lanes_of(result)
    for i in range(numbers.size):
        results[0, i] = math.log(numbers[i])
        results[1, i] = math.exp(-numbers[i])


def test_logarithms_and_exponentials_are_as_good_as_those_of_math():
    x = 10.0 ** np.random.default_rng(0).uniform(-290, 2.8, size=(4000, LANES))
    x[0], x[1, 0], x[1, 1] = 1.0, math.sqrt(2.0), 750.0
    result = np.empty((2, *x.shape))
    functions(x, result)
    log, power = np.log(x), np.where(x > 700.0, 0.0, np.exp(-x))
    assert np.abs(result[0] - log).max() <= 4e-16 * np.abs(log).max()
    np.testing.assert_allclose(result[0][1:], log[1:], rtol=1e-15)
    np.testing.assert_allclose(result[1], power, rtol=4e-16, atol=1e-300)


def test_arrays_of_one_buffer_do_not_overlap_and_begin_on_cache_lines():
    arrays = arrays_of((2, 3), (), (5,), lanes=(LANES,))
    assert [array.shape for array in arrays] == [(2, 3, 8), (8,), (5, 8)]
    for i, array in enumerate(arrays):
        assert array.ctypes.data % 64 == 0
        array[...] = i
    assert [set(array.ravel()) for array in arrays] == [{0.0}, {1.0}, {2.0}]
