"""Inputs that change linearly between samples: the period's map, and held against linear."""

import numpy as np
import pytest

from analog_logs import AnalogPlant
from deadtime.identification.likelihoods.likelihood import ExactLog
from deadtime.identification.likelihoods.noisy_log import NoiseLevels, NoisyLog
from deadtime.identification.log.recording import Part, Recording
from deadtime.identification.parameters import Layout
from deadtime.identification.residuals import FittedModel
from deadtime.identification.sampling import nodes_for, sampling_of

H, T = 0.05, 40
A = [[[0.0, 1.0], [-2.0, -1.0]], [[0.3, 1.0], [-3.0, -0.5]]]
B = [[[0.0, 0.4], [1.0, -0.2]], [[0.3, 0.0], [1.2, 0.5]]]
MODE = (np.arange(T) // 7) % 2
EVEN = H * np.arange(T)
JITTER = EVEN + np.random.default_rng(3).uniform(-0.3, 0.3, T) * H
LAYOUT = Layout(2, 2, 2, per_mode=False)


def recording(t, D, rests=False, W=1e-4):
    """A record of two modes and inputs, linear between samples, and its plant."""
    rng = np.random.default_rng(7)
    plant, u = AnalogPlant(A, B, D, W * np.eye(2)), rng.standard_normal((T, 2))
    part = Part(t, plant.log(t, u, rng, MODE), u, MODE, rests)
    of = ("x1", "x2"), ("u1", "u2"), ("0", "1"), True
    return plant, Recording((part,), H, t is EVEN, *of, hold=1)


def theta_of(plant, change=1.0):
    return LAYOUT.join(change * plant.A, plant.B, np.tile(plant.D, (2, 1)))


@pytest.mark.parametrize("rests", [True, False])
@pytest.mark.parametrize("D", [(0.312, 0.174), (0.021, 0.05), (0.1, 0.137)])
@pytest.mark.parametrize("t", [EVEN, JITTER], ids=["even", "uneven"])
def test_a_period_of_linear_inputs_is_that_of_a_run_with_interpolated_ones(t, D, rests):
    plant, record = recording(t, D, rests)
    part, nodes = record.parts[0], nodes_for(record.parts, plant.A)
    sampling, theta = sampling_of(record, nodes), theta_of(plant)
    cells, window = np.ceil(np.array(D) / H - 1e-9).astype(int), (min(D), max(D))
    k = sampling.usable(part, False, *window)
    assert k.size >= T - 1 - (0 if rests else 8)
    maps, reads = sampling.maps(LAYOUT, theta, cells), sampling.reads(LAYOUT, theta, cells)
    model = FittedModel(LAYOUT.plant(theta), np.zeros((2, 2)), sampling)
    ahead = model.one_step(part, k, part.output[k])
    for row, at in enumerate(k):
        expected = plant.period(t, part.input, MODE, at, part.output[at])
        i, length = MODE[at], part.time[at + 1] - part.time[at]
        z = sampling.rows(part, np.array([at]), reads[i], False)[0, 2:]
        scale = 1.0 if record.even else np.sqrt(length / H)
        np.testing.assert_allclose(scale * maps[i].P @ z, expected, atol=1e-9)
        np.testing.assert_allclose(ahead[row], expected, atol=1e-9)


def slopes(value, theta, size):
    """Central differences, extrapolated to a step of 0."""
    result = np.empty(theta.size)
    for a, e in enumerate(np.eye(theta.size)):
        d = [
            (value(theta + s * e) - value(theta - s * e)) / (2.0 * s)
            for s in size[a] * np.array([1.0, 0.5])
        ]
        result[a] = (4.0 * d[1] - d[0]) / 3.0
    return result


@pytest.mark.parametrize("t", [EVEN, JITTER], ids=["even", "uneven"])
@pytest.mark.parametrize("noisy", [False, True])
def test_the_score_with_linear_inputs_is_the_derivative(t, noisy):
    plant, record = recording(t, (0.312, 0.174))
    nodes, theta = nodes_for(record.parts, plant.A), theta_of(plant, 1.05)
    given = record, LAYOUT, False, (0.1, 0.4), nodes
    log = ExactLog(*given)
    if noisy:
        log = NoisyLog(*given, np.eye(2))
        theta = log.join(theta, NoiseLevels(1e-3 * np.eye(2), np.array([0.02, 0.03])))
    evaluate = log.evaluate_in(0.15, 0.35)(np.array([7, 4]))
    size = 1e-3 / np.sqrt(np.diagonal(evaluate(theta).information))
    by_hand = slopes(lambda one: evaluate(one).value, theta, 10.0 * size)
    assert np.abs((evaluate(theta).score - by_hand) * size).max() < 1e-8


def test_an_even_log_of_linear_inputs_may_be_taken_for_an_uneven_one():
    plant, record = recording(EVEN, (0.312, 0.174))
    nodes, theta = nodes_for(record.parts, plant.A), theta_of(plant, 1.05)
    each = [
        ExactLog(one, LAYOUT, False, (0.1, 0.4), nodes).evaluate_in(0.15, 0.35)(np.array([7, 4]))
        for one in (record, record._replace(even=False))
    ]
    even, uneven = (one(theta) for one in each)
    assert even.value == pytest.approx(uneven.value, rel=1e-9)
    np.testing.assert_allclose(even.score, uneven.score, rtol=1e-7)
    np.testing.assert_allclose(even.information, uneven.information, rtol=1e-6, atol=1e-6)


def test_the_likelihood_of_linear_inputs_has_no_kink_at_a_whole_number_of_periods():
    """Of held inputs the score jumps there."""
    plant, record = recording(EVEN, (0.3, 0.174))
    nodes, theta = nodes_for(record.parts, plant.A), theta_of(plant, 1.05)
    jumps = []
    for hold in (0, 1):
        log = ExactLog(record._replace(hold=hold), LAYOUT, False, (0.1, 0.4), nodes)
        left, right = (log.evaluate_in(0.2, 0.35)(np.array([n, 4]))(theta) for n in (6, 7))
        assert left.value == pytest.approx(right.value, rel=1e-12)
        place = LAYOUT.delay_places[0]
        jumps.append(
            abs(left.score[place] - right.score[place]) / np.sqrt(left.information[place, place])
        )
    assert jumps[1] < 1e-8
    assert jumps[0] > 0.1
