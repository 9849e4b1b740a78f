"""Zeros from outputs alone: found, in doubt, and on the other side."""

import re
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

import deadtime as dt
from deadtime.identification.likelihoods.likelihood import maximise
from deadtime.identification.likelihoods.noisy_log import NoiseLevels, NoisyLog
from output_logs import MOTOR, OUTPUTS, H, logged, misses
from synthetic_logs import Plant


@pytest.mark.long
def test_zeros_that_are_in_doubt_come_with_the_delay_the_other_way_round():
    plant = Plant(MOTOR.A, [[[0.1], [1.0]]], 0.312, 1e-3 * np.eye(2))
    table = logged(plant, [[1.0, 0.0]], 400, 6)
    given: dict[str, Any] = {"modes": None, "delay": (0.0, 1.0), "order": 2}
    fit = dt.identify(table, **given)
    told = "act on all of them" in fit.message
    found = re.search(r"The log hardly shows whether u1 acts .* would be ([\d.]+) s", fit.message)
    assert found
    other = dt.identify(table, **given, zeros=not told)
    assert float(found[1]) == pytest.approx(other.delays.item(), abs=1e-3)
    assert "hardly shows whether" not in other.message


def test_a_plant_with_a_zero_is_found_to_have_one_and_keeps_its_transfer_function():
    plant = Plant([[[-0.5, 2.0], [-2.0, -0.5]]], [[[1.0], [0.5]]], 0.23, 1e-3 * np.eye(2))
    C = [[1.0, 0.0]]
    log = logged(plant, C, 600, 2)
    fit = dt.identify(log, modes=None, delay=(0.0, 1.0), order=2, hold="held")
    assert "act on all of them" in fit.message
    wrong, names = misses(fit, plant, C, (2,))
    assert names == 4
    assert len(wrong) <= 1
    s = 2j * np.pi * np.array([0.05, 0.2, 0.35, 1.0])
    for one in s:
        gains = [
            (np.array(c) @ np.linalg.solve(one * np.eye(2) - own.A[0], own.B[0])).item()
            for own, c in ((plant, C), (fit.plant, fit.C))
        ]
        assert abs(gains[1] / gains[0] - 1.0) < 0.1
    low, high = fit.interval("delay")
    assert low < 0.23 < high < low + 0.004


ZEROS = (
    ((-1.68, -2.39), -1.42),  # each a stable zero, at a₁ − b
    ((-1.18, -2.47), -0.72),  # between −1.83 and −0.65: all but as one of order 1
    ((-2.17, -2.09), -0.62),
    ((-1.85, -1.46), 1.05),
)


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("a", "b", "W", "sensor", "jitter"),
    [
        *((*one, 1e-5, 1e-3, 0.0) for one in ZEROS),
        *((*one, 1e-8, 1e-5, 0.0) for one in ZEROS[1::2]),
        *((*one, 1e-5, 1e-3, 0.3) for one in ZEROS[1::2]),
    ],
)
def test_a_zero_in_a_quiet_log_is_found_where_the_likelihood_is_largest(a, b, W, sensor, jitter):
    plant = Plant([[[0.0, 1.0], a]], [[[1.0], [b]]], 0.17, W * np.eye(2))
    table = logged(plant, [[1.0, 0.0]], 500, 3, sensor=sensor, jitter=jitter, hold=2)
    fit = dt.identify(table, modes=None, delay=(0.0, 1.0), order=2)
    log, window = fit._estimate.log, fit._estimate.window
    assert isinstance(log, NoisyLog)
    truth = log.layout.join(plant.A, plant.B, plant.D)
    vector = log.join(truth, NoiseLevels(plant.W, np.array([sensor])))
    assert fit.log_likelihood > maximise(log, vector, window=window)[0].value - 0.1
    low, high = fit.interval("delay")
    assert 0.17 - 1.5 * (high - low) < low < high < 0.17 + 1.5 * (high - low)
    assert high - low < 4e-4


THREE = Plant(  # poles that all but coincide
    [[[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-0.047, -0.395, -1.091]]],
    [[[-0.477], [-0.593], [0.444]]],
    0.129,
    1e-10 * np.eye(3),
)
TWO_BY_TWO = Plant(
    [
        [
            [0.0, 1.0, 0.0, 0.0],
            [-5.177, -4.59, -0.588, -0.189],
            [0.0, 0.0, 0.0, 1.0],
            [0.152, 0.109, -1.113, -1.893],
        ]
    ],
    [[[-0.917, -0.982], [1.672, 1.55], [0.549, -0.564], [-1.009, -1.556]]],
    [[0.2061, 0.0769]],
    1e-10 * np.eye(4),
)


@pytest.mark.long
@pytest.mark.parametrize(("plant", "order", "seed"), [(THREE, (3,), 3), (TWO_BY_TWO, (2, 2), 0)])
def test_more_states_in_a_log_of_next_to_no_noise_are_found_too(plant, order, seed):
    C = np.eye(sum(order))[np.cumsum(order) - order]
    table = logged(plant, C, 500, seed, sensor=1e-5, hold=2)
    fit = dt.identify(table, modes=None, delay=(0.0, 1.0), order=order)
    assert np.ptp(fit.delay_interval, axis=-1).max() < 1e-5
    assert np.abs(fit.delays - plant.D).max() < 1e-5
    true = [np.sort_complex(np.linalg.eigvals(one.A[0])) for one in (plant, fit.plant)]
    assert np.abs(true[1] - true[0]).max() < 0.2


FAST = Plant([[[0.0, 1.0], [-400.0, -12.0]]], [[[-2.0], [200.0]]], 0.163, 1e-6 * np.eye(2))


def sampled(plant, delay, b, count):
    """The position at samples after a pulse of one period, input weights b: by exponentials."""
    t, u = H * np.arange(count), np.zeros((count, 1))
    u[0] = 1.0
    one = Plant(plant.A, [np.reshape(b, (2, 1))], delay)
    return one.log(t, u, np.random.default_rng(0))[0][:, 0]


def test_another_delay_and_zero_that_make_the_same_samples_are_in_the_interval_and_said():
    table = logged(FAST, [[1.0, 0.0]], 500, sensor=1e-5, hold=2)
    fit = dt.identify(table, modes=None, delay=(0.0, 1.0), order=2)
    said = re.search(r"The delay may as well be ([\d.]+) s, with other weights", fit.message)
    assert said
    both = sorted([float(said[1]), fit.delays.item()])
    assert both[1] - both[0] > 0.005
    low, high = fit.interval("delay")
    assert low < both[0] < both[1] < high
    assert min(abs(np.array(both) - 0.163)) < 1e-4
    assert misses(fit, FAST, [[1.0, 0.0]], (2,))[0] == []
    true = sampled(FAST, 0.163, FAST.B[0], 20)
    E = expm(np.array(FAST.A[0]) * (sum(both) - 2 * 0.163))  # to the other one
    other = sampled(FAST, sum(both) - 0.163, E @ FAST.B[0], 20)
    assert np.abs(other - true).max() < 1e-3 * np.abs(true).max()


@pytest.mark.long
def test_uneven_rows_tell_a_zero_from_that_on_the_other_side():
    table = logged(FAST, [[1.0, 0.0]], 500, sensor=1e-5, hold=2, jitter=0.3)
    fit = dt.identify(table, modes=None, delay=(0.0, 1.0), order=2)
    low, high = fit.interval("delay")
    assert low < 0.163 < high < low + 1e-3
    assert "may as well be" not in fit.message


@pytest.mark.long
def test_a_sensor_of_a_quiet_log_keeps_its_noise():
    own = [[0.0, 1.0, 0.0], [-4.79, -4.57, -0.25], [-0.07, 0.18, -1.9]]
    B = [[0.0, 0.0], [-0.6, -1.78], [1.22, -1.83]]
    plant = Plant([own], [B], [[0.328, 0.395]], 1e-8 * np.eye(3))
    table = logged(plant, OUTPUTS[2, 1], 400, 1, sensor=1e-3, hold=2)
    fit = dt.identify(table, modes=None, delay=(0.0, 1.0), order=(2, 1))
    for name in ("noise[0]", "noise[1]"):
        low, high = fit.interval(name)
        assert 0.85e-3 < low < high < 1.2e-3
    assert "act on all of them" not in fit.message
