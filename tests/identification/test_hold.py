"""Inputs that change linearly between samples: the period's map, and held against linear."""

from typing import Any

import numpy as np
import pytest

import deadtime as dt
from analog_logs import AnalogPlant, table
from deadtime.cli import main
from deadtime.identification.departures import departures_of
from deadtime.identification.likelihoods.likelihood import ExactLog
from deadtime.identification.likelihoods.noisy_log import NoiseLevels, NoisyLog
from deadtime.identification.log.recording import Part, Recording
from deadtime.identification.parameters import Layout
from deadtime.identification.residuals import FittedModel
from deadtime.identification.sampling import nodes_for, sampling_of
from synthetic_logs import Plant

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
@pytest.mark.parametrize("D", [(0.312, 0.174), (0.021, 0.05)])
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


LINEAR: Any = {"hold": "linear"}
SPEAKS = "speaks for an input that changes linearly between samples"
SUPPORTS = "The input is taken as held between samples: the log supports that."
UNDECIDED = "does not tell whether the input is held between samples"


def log_of(kind, D, seed=0, count=300, jitter=0.0, noise=1e-2, modes=1, **sensor):
    """A log of white inputs, held or linear between samples."""
    rng = np.random.default_rng(seed)
    t = H * (np.arange(count) + jitter * rng.uniform(-1.0, 1.0, count))
    mode, u = (np.arange(count) // 23) % modes, rng.standard_normal((count, 1))
    of = [[[0.0], [1.0]], [[0.3], [1.2]]]
    if kind == "held":
        x, u = Plant(A, of, D, noise**2 * np.eye(2)).log(t, u, rng, mode, **sensor)
    else:
        x = AnalogPlant(A, of, [D], noise**2 * np.eye(2)).log(t, u, rng, mode, **sensor)
    return table(t, x, u, mode)


def fitted(log, **given):
    return dt.identify(log, delay=(0.0, 0.6), switches="samples", **given)


def inside(fit, D):
    low, high = fit.delay_interval[0, 0]
    return low <= D <= high


@pytest.mark.parametrize("jitter", [0.0, 0.25], ids=["even", "uneven"])
def test_a_linear_input_is_named_and_its_delay_lies_in_the_interval_of_the_linear_one(jitter):
    log = log_of("linear", 0.312, modes=2, jitter=jitter)
    fit = fitted(log)
    assert SPEAKS in fit.message
    assert not inside(fit, 0.312)
    assert any("held between samples" in doubt for doubt in fit.doubts)
    lags = [one for one in departures_of(fit._estimate).found if one.like_a_lag]
    assert lags  # the same cause, which is reported once
    assert not {one.name for one in fit.departures} & {one.name for one in lags}
    assert not any("departs from the model" in doubt for doubt in fit.doubts)
    right = fitted(log, **LINEAR)
    assert inside(right, 0.312)
    assert right.delays[0, 0] - fit.delays[0, 0] == pytest.approx(0.5 * H, rel=0.1)
    assert "Inputs are taken to change linearly between samples." in right.message
    assert not right.doubts


@pytest.mark.parametrize("jitter", [0.0, 0.25], ids=["even", "uneven"])
def test_a_held_input_is_supported_and_its_interval_stays(jitter):
    log = log_of("held", 0.312, modes=2, jitter=jitter)
    fit = fitted(log)
    assert SUPPORTS in fit.sentences
    assert not fit.doubts
    asked = fitted(log, hold="held")
    np.testing.assert_array_equal(fit.delay_interval, asked.delay_interval)
    assert SUPPORTS not in asked.sentences


def test_where_the_log_does_not_tell_the_interval_holds_both_delays():
    log = log_of("linear", 0.312, count=200, noise=0.1)
    fit, right, held = fitted(log), fitted(log, **LINEAR), fitted(log, hold="held")
    assert UNDECIDED in fit.message
    low, high = fit.delay_interval[0, 0]
    assert low == held.delay_interval[0, 0, 0]
    assert low <= right.delays[0, 0] <= high
    assert high == pytest.approx(right.delay_interval[0, 0, 1], abs=0.2 * H)


def test_a_smooth_input_is_never_said_to_be_held():
    """The likelihood may prefer a held one, but the delay is that of a linear one."""
    t, rng = H * np.arange(400), np.random.default_rng(1)
    waves, phases = 2.0 * np.pi * np.linspace(0.3, 4.0, 12), rng.uniform(0.0, 6.28, 12)

    def u(time):
        return np.sin(np.outer(time, waves) + phases).sum(axis=1) / 3.5

    fine = np.linspace(-1.0, t[-1], 10 * t.size)
    dense = u(fine)[:, None]
    plant = AnalogPlant(A[:1], [[[0.0], [1.0]]], [0.2713])
    x = np.zeros((t.size, 2))
    for k in range(t.size - 1):
        x[k + 1] = plant._piece(fine, dense, 0, t[k], t[k + 1], x[k])
        x[k + 1] += 1e-3 * rng.standard_normal(2)
    log = table(t, x, u(t)[:, None])
    fit = dt.identify(log, None, (0.1, 0.4))
    assert UNDECIDED in fit.message
    assert inside(fit, 0.2713)
    assert fit.delays[0, 0] + 0.5 * H == pytest.approx(0.2713, abs=0.05 * H)
    right = dt.identify(log, None, (0.1, 0.4), **LINEAR)
    assert right.delays[0, 0] == pytest.approx(0.2713, abs=0.02 * H)


def test_inputs_of_steps_are_not_tested():
    log = log_of("held", 0.212)
    rng = np.random.default_rng(4)
    u = np.repeat(rng.standard_normal((75, 1)), 4, axis=0)
    x, u = Plant(A[:1], [[[0.0], [1.0]]], 0.212, 1e-4 * np.eye(2)).log(H * np.arange(300), u, rng)
    fit = fitted(table(H * np.arange(300), x, u, np.zeros(300, int)))
    assert "between samples" not in fit.message
    assert inside(fit, 0.212)
    assert SUPPORTS in fitted(log).message


def test_a_linear_input_that_acts_before_its_row_is_named_at_the_edge_0():
    log = log_of("linear", 0.002, noise=0.05)
    fit = fitted(log)
    assert fit.delays[0, 0] == pytest.approx(0.0, abs=1e-6)
    assert "acts up to half a row earlier than logged" in fit.message
    assert any("edge of the range" in doubt for doubt in fit.doubts)
    right = fitted(log, noise=False, **LINEAR)
    assert inside(right, 0.002)
    assert "taken not to follow its measurement" in right.message


def test_linear_inputs_of_a_loop_need_delays_of_a_row():
    rng, t = np.random.default_rng(0), H * np.arange(300)
    plant = Plant(A[:1], [[[0.0], [1.0]]], 0.212, 1e-4 * np.eye(2))
    x, u = plant.log(t, np.zeros((300, 1)), rng, feedback=np.array([[-0.5, -0.5]]))
    log = table(t, x, u)
    with pytest.raises(dt.ArgumentError, match=r"delays of at least a row, 0\.05 s, because u1"):
        dt.identify(log, None, (0.0, 0.6), **LINEAR)


def test_noisy_sensors_and_outputs_alone_have_the_delay_of_linear_inputs():
    log = log_of("linear", 0.312, noise=0.01, sensor=0.01)
    fit = fitted(log, noise=True, **LINEAR)
    assert inside(fit, 0.312)
    assert inside(fitted(log, noise=True), 0.312)  # not decided, or linear: see the next line
    assert UNDECIDED in fitted(log, noise=True).message
    alone = log.rename(columns={"x1": "y1"}).drop(columns=["x2", "mode"])
    assert inside(dt.identify(alone, None, (0.0, 0.6), order=2, **LINEAR), 0.312)


def test_hold_is_refused_in_words_and_read_by_the_command_line(tmp_path, capsys):
    log = log_of("linear", 0.312)
    with pytest.raises(dt.ArgumentError, match='hold must be "held", "linear", or None'):
        fitted(log, hold="foh")
    log.to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(SystemExit) as stopped:
        main(["identify", str(tmp_path / "log.csv"), "--hold", "linear", "--switches", "samples"])
    assert stopped.value.code == 0
    assert "Inputs are taken to change linearly" in capsys.readouterr().out.replace("\n", " ")


@pytest.mark.long
@pytest.mark.parametrize("jitter", [0.0, 0.25], ids=["even", "uneven"])
@pytest.mark.parametrize("kind", ["held", "linear"])
def test_the_right_hold_is_found_and_its_intervals_hold_the_delay(kind, jitter):
    delays = np.random.default_rng(2).uniform(0.06, 0.4, 20)
    held, wrong = 0, 0
    for seed, D in enumerate(delays):
        log = log_of(kind, D, seed, jitter=jitter)
        held += inside(fitted(log, hold=kind), D)
        said = fitted(log).message
        wrong += (SUPPORTS if kind == "linear" else "speaks for") in said
    assert held >= 17
    assert wrong <= 1
