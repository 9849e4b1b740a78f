"""One delay, one per input, one per mode, one of each: what a plant takes, and what it refuses."""

import re

import numpy as np
import pytest

import deadtime as dt
from deadtime.plant import SampledPlant

A, B = np.zeros((2, 1, 1)), np.ones((2, 1, 2))


@pytest.mark.parametrize(
    ("delay", "delays"),
    [
        (0.3, [[0.3, 0.3], [0.3, 0.3]]),
        ([0.3, 0.1], [[0.3, 0.1], [0.3, 0.1]]),  # as many inputs as modes: per input
        ([[0.3], [0.1]], [[0.3, 0.3], [0.1, 0.1]]),
        ([[0.3, 0.1], [0.2, 0.4]], [[0.3, 0.1], [0.2, 0.4]]),
    ],
)
def test_delays_are_those_of_every_mode_and_input(delay, delays):
    plant = dt.SwitchedSystem(A, B, delay)
    assert plant.delays.tolist() == delays
    assert plant.longest_delay == np.max(delays)
    assert dt.SwitchedSystem(A, B, plant.delay_data).delays.tolist() == delays


def test_the_delay_is_a_number_where_there_is_one():
    assert dt.SwitchedSystem(A, B, [[0.3, 0.3], [0.3, 0.3]]).delay == 0.3
    several = dt.SwitchedSystem(A, B, [0.3, 0.1])
    with pytest.raises(dt.ArgumentError, match=r"must have one delay.*delay=\[0.3, 0.1\]"):
        _ = several.delay


def test_the_mean_plant_has_the_mean_delays_and_those_alike_to_the_last_bit():
    plant = dt.SwitchedSystem(
        np.zeros((3, 1, 1)), np.ones((3, 1, 2)), [[0.1, 1], [0.1, 2], [0.1, 3]]
    )
    assert plant.mean().delays.tolist() == [[0.1, 2.0]]


@pytest.mark.parametrize(
    ("delay", "message"),
    [
        (float("nan"), "delay must be finite, got nan."),
        ([0.3, float("inf")], "delay[1] must be finite"),
        (-1.0, "delay must be positive"),
        ([0.3, 0.0], "delay of input 1 in mode 0 must be positive, in s, got 0: for an input that"),
        ([[0.3], [-0.2]], "delay of input 0 in mode 1 must be positive"),
        ([0.3, 0.2, 0.1], "a list is one per input."),
        (
            [[[0.3]]],
            "delay must have shape (m,) = (2,), (modes, 1) = (2, 1) or (modes, m) = (2, 2)",
        ),
        ("0.3", "delay must be a number, got '0.3'"),
    ],
)
def test_delays_that_are_none_are_refused(delay, message):
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        dt.SwitchedSystem(A, B, delay)


def test_a_list_for_modes_is_refused_with_the_shape_that_is_meant():
    with pytest.raises(
        dt.ArgumentError, match=r"for one per mode give \[\[0.1\], \[0.2\], \[0.3\]\]"
    ):
        dt.SwitchedSystem(np.zeros((3, 1, 1)), np.ones((3, 1, 2)), [0.1, 0.2, 0.3])


def test_an_input_that_acts_nowhere_has_no_delay_of_its_own():
    with pytest.raises(dt.ArgumentError, match=r"B\[:, :, 1\] must not be zero in every mode"):
        dt.SwitchedSystem(A, B * [1.0, 0.0], [0.3, 0.1])


def test_too_many_periods_are_refused_by_input_and_mode():
    plant = dt.SwitchedSystem(A, B, [[0.1, 0.1], [0.1, 1e5]])
    with pytest.raises(
        dt.ArgumentError, match=r"delay of input 1 in mode 1 / step = 1e\+07 periods"
    ):
        SampledPlant(plant, 0.01)


def test_a_period_is_cut_at_every_arrival_and_fractions_that_are_one_are_one():
    plant = dt.SwitchedSystem(A, B, [[0.27, 0.1], [0.43 + 1e-13, 0.03]])
    sampled = SampledPlant(plant, 0.1)
    first, second = sampled.stretches(0), sampled.stretches(1)
    assert [part.lag.tolist() for part in first] == [[3, 1], [2, 1]]
    assert [part.lag.tolist() for part in second] == [[5, 1], [4, 0]]
    assert first[0].stop == pytest.approx(0.07)
    assert second[0].stop == pytest.approx(0.03)
    assert sampled.longest_lag == 5


@pytest.mark.parametrize(
    "ask",
    [
        lambda plant, law: dt.theorem_bound(plant, law.gains, 0.5),
    ],
)
def test_what_knows_one_delay_only_refuses_several_by_name(ask):
    plant = dt.SwitchedSystem([[[0.1]], [[0.2]]], [[[1.0, 0.5]], [[1.0, 0.6]]], [0.3, 0.1])
    law = dt.AveragedPredictor(plant, dt.place(plant, [-1.0]))
    with pytest.raises(dt.ArgumentError, match="form must be 'sharp' where inputs have several"):
        ask(plant, law)


IDLE = np.array([[[0.0, 1.0], [1.0, 0.0]], [[0.0, -1.0], [1.0, 0.0]]])  # input 1 turns its sign


@pytest.mark.parametrize("delay", [0.3, [0.3, 0.2]])
def test_plants_made_from_one_may_have_inputs_that_act_on_nothing(delay):
    plant = dt.SwitchedSystem([np.diag([-1.0, -2.0])] * 2, IDLE, delay)
    assert not plant.mean().B[0, :, 1].any()
    K = np.zeros((2, 2, 2))
    for law in (dt.MeanPredictor(plant, K[0]), dt.MeanPredictor(plant, K[0], dwell_time=0.2)):
        assert law.digital(0.1).taps == 3
    once = dt.SwitchedSystem(plant.A, IDLE * [[[1.0, 1.0]], [[1.0, 0.0]]], delay)
    assert dt.SingleModePredictor(once, K, 1).digital(0.1).taps == 3
    nowhere = dt.SwitchedSystem(plant.A, IDLE * [1.0, 0.0], 0.3)
    assert nowhere.apart(0.5).delays.tolist() == nowhere.delays.tolist()


def test_delays_that_differ_by_round_off_are_one():
    assert dt.SwitchedSystem(A, B, [0.3, 0.1 * 3]).delay == 0.3


def test_rows_of_different_lengths_are_refused():
    with pytest.raises(
        dt.ArgumentError, match=r"delay must have shape .*rows of different lengths"
    ):
        dt.SwitchedSystem(A, B, [[0.3], [0.2, 0.1]])


def test_robustness_says_what_all_delays_and_each_inputs_delay_may_be():
    plant = dt.SwitchedSystem([[[0.1]], [[0.2]]], [[[1.0, 0.5]], [[1.0, 0.6]]], [0.3, 0.1])
    law, signal = dt.AveragedPredictor(plant, dt.place(plant, [-1.0])), dt.SwitchingSignal([0], [0])
    found = dt.robustness(plant, law, signal, [1.0], 3.0, 0.1, scenarios=2)
    assert found.left_out == ()
    assert [one.input for one in found.of_inputs] == [0, 1]
    said = [found.delay, *found.of_inputs, found.gain]
    assert [text[:-1].lower() for text in found.sentences[:4]] == [
        one.message.lower() for one in said
    ]
    for j, sentence in enumerate(found.sentences[1:3]):
        assert f"the true delay of input {j} is" in sentence
