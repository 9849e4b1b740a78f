"""A of outputs alone from what they were, against plants of three states, two modes and inputs."""

import numpy as np
import pytest

from deadtime.identification.likelihoods.noisy_log import Embedding
from deadtime.identification.log.recording import Part
from deadtime.identification.outputs_maxima import chains_by_past
from output_logs import OUTPUTS, H, logged, truth_of
from synthetic_logs import Plant

PLANT = Plant(
    [
        [[0.0, 1.0, 0.0], [-4.8, -1.6, -0.3], [0.2, 0.2, -1.9]],
        [[0.0, 1.0, 0.0], [-1.1, -2.5, 0.4], [-0.3, 0.1, 0.4]],
    ],
    [[[0.3, -0.5], [-0.6, -1.8], [1.2, -1.8]], [[0.0, 0.4], [1.3, 0.2], [-0.7, 0.9]]],
    [[0.328, 0.1], [0.213, 0.395]],
    np.zeros((3, 3)),
)


def parts_of(tables, p=2):
    """As the package has them; the first table's mode changes once, so that runs are long."""
    return tuple(
        Part(
            one["t"].to_numpy(),
            one[[f"y{j + 1}" for j in range(p)]].to_numpy(),
            one[["u1", "u2"]].to_numpy(),
            one["mode"].to_numpy(),
        )
        for one in tables
    )


def found(order, apart, sensor=0.0, missing=0.0, lag=9):
    C = OUTPUTS[order]
    tables = [logged(PLANT, C, 700, seed, 2, sensor, missing=missing) for seed in range(3)]
    shape = Embedding(order, True, np.ones(3))
    A = chains_by_past(parts_of(tables), shape, np.ones(2), H, lag, 2, apart)
    return A, np.array([own for own, _ in truth_of(PLANT, C, order)])


@pytest.mark.parametrize("order", [(2, 1), (1, 2)])
@pytest.mark.parametrize("apart", [1, 3])
@pytest.mark.parametrize("missing", [0.0, 0.02])
def test_without_noise_it_is_the_truth_whatever_the_delays(order, apart, missing):
    A, true = found(order, apart, missing=missing)
    assert np.abs(A - true).max() < 1e-6 * np.abs(true).max()


def test_sensors_noise_matters_less_of_outputs_that_are_farther_apart():
    near, far = (np.abs(np.subtract(*found((2, 1), apart, 1e-3))).max() for apart in (1, 6))
    assert far < 0.2 * near
    assert far < 0.1


def test_rows_that_are_too_few_within_a_mode_tell_nothing():
    assert found((2, 1), 12)[0] is None  # 23 rows within a mode, and 24 that have to lie there
    assert found((2, 1), 1, lag=400)[0] is None


def test_outputs_that_grow_without_measure_tell_no_plant():
    u = np.random.default_rng(0).standard_normal((40, 1))
    for growth, plant in ((1.5, True), (20.0, False)):
        y, t = growth ** np.arange(40.0)[:, None], H * np.arange(40)
        part = Part(t, y, u, np.zeros(40, np.int64))
        A = chains_by_past((part,), Embedding((1,), True, np.ones(1)), np.ones(1), H, 2, 1, 1)
        assert (A is not None) == plant


def test_logs_shorter_than_their_lags_have_no_past():
    part = Part(0.1 * np.arange(9), np.zeros((9, 1)), np.zeros((9, 2)), np.zeros(9, np.int64))
    assert (
        chains_by_past((part,), Embedding((2,), False, np.ones(1)), np.ones(1), 0.1, 8, 1, 2)
        is None
    )
