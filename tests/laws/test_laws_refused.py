"""Gains, weights, modes and signals that make no law, and how they are refused."""

import re

import numpy as np
import pytest

import deadtime as dt
import plants

H = 0.1
PLANT = plants.paper()
GAINS = plants.gains(PLANT)
GAIN = plants.mean_gain(PLANT)
WRONG_SIGN = "leaves A + B K of mode 0 unstable (rightmost eigenvalue at"
BUILDERS = {
    "averaged": dt.AveragedPredictor,
    "single": lambda plant, gains, **free: dt.SingleModePredictor(plant, gains, 0, **free),
    "mean": lambda plant, gains, **free: dt.MeanPredictor(plant, GAIN, gains, **free),
    "exact": dt.ExactPredictor,
    "delayed": dt.DelayedStateFeedback,
}


@pytest.mark.parametrize("build", BUILDERS.values(), ids=BUILDERS)
@pytest.mark.parametrize(
    ("gains", "message"),
    [
        (GAINS[0], "gains must have shape (modes, m, n), got (1, 2): stack one matrix per mode"),
        (
            GAINS[:1],
            "gains must hold one (m, n) matrix per mode, 2, got 1: they may be the "
            "gains of another plant.",
        ),
        (
            GAINS.transpose(0, 2, 1),
            "gains[0] must have shape (m, n) = (1, 2), got (2, 1): pass the transpose.",
        ),
        (np.zeros((2, 1, 3)), "gains[0] must have shape (m, n) = (1, 2), got (1, 3)."),
        (np.where(GAINS < -7, np.nan, GAINS), "gains[0, 0, 0] must be finite, got nan."),
        (-GAINS, f"gains[0] {WRONG_SIGN}"),
        (np.stack([GAINS[0], -GAINS[1]]), "gains[1] leaves A + B K of mode 1 unstable"),
    ],
)
def test_gains_that_do_not_fit_the_plant_are_refused_by_name(build, gains, message):
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        build(PLANT, gains)


@pytest.mark.parametrize("build", BUILDERS.values(), ids=BUILDERS)
def test_unstable_gains_are_taken_when_they_are_meant(build):
    assert np.array_equal(build(PLANT, -GAINS, allow_unstable=True).gains, -GAINS)


SHORT = dt.SwitchingSignal([0, 0.5], [0, 1], end=2.0)
THIRD = dt.SwitchingSignal([0, 0.5], [0, 2])
ORACLE = dt.ExactPredictor(PLANT, GAINS)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: dt.AveragedPredictor(PLANT, GAINS, [1.0]),
            "weights must have shape (modes,) = (2,), got (1,).",
        ),
        (
            lambda: dt.AveragedPredictor(PLANT, GAINS, [1.5, -0.5]),
            "weights must be probabilities, ≥ 0 with sum 1, got [1.5, -0.5] with sum 1",
        ),
        (
            lambda: dt.AveragedPredictor(PLANT, GAINS, [0.5, 0.6]),
            "with sum 1.1: if none is negative, divide them by their sum.",
        ),
        (
            lambda: dt.SingleModePredictor(PLANT, GAINS, 2),
            "mode must be in 0..1, got 2: modes count from 0.",
        ),
        (lambda: dt.SingleModePredictor(PLANT, GAINS, -1), "mode must be in 0..1, got -1"),
        (
            lambda: dt.SingleModePredictor(PLANT, GAINS, True),
            "mode must be an integer in 0..1, got True.",
        ),
        (
            lambda: dt.MeanPredictor(PLANT, GAIN.T),
            "gain must have shape (m, n) = (1, 2), got (2, 1): pass the transpose.",
        ),
        (
            lambda: dt.MeanPredictor(PLANT, GAINS),
            "gain must have shape (m, n), got (2, 1, 2): give one matrix, not one per mode.",
        ),
        (lambda: dt.MeanPredictor(PLANT, -GAIN), "gain leaves A + B K of the mean plant unstable"),
        (
            lambda: dt.MeanPredictor(PLANT, GAIN, mean=(np.eye(3), [[0], [1]])),
            "mean[0] must have shape (n, n) = (2, 2), got (3, 3).",
        ),
        (
            lambda: dt.MeanPredictor(PLANT, GAIN, mean=(np.eye(2), [[0, 1]])),
            "mean[1] must have shape (n, m) = (2, 1), got (1, 2): pass the transpose.",
        ),
        (
            lambda: dt.ExactPredictor(PLANT, GAINS, THIRD),
            "signal enters mode 2 at 0.5 s, but the plant's modes are 0..1",
        ),
        (lambda: ORACLE.digital(H, THIRD, 5), "signal enters mode 2 at 0.5 s"),
        (lambda: ORACLE.digital(H), "steps must be given"),
        (
            lambda: ORACLE.digital(H, steps=5),
            "signal must be given: ExactPredictor needs the future",
        ),
        (lambda: ORACLE.digital(H, SHORT), "steps must be given"),
        (
            lambda: ORACLE.digital(H, SHORT, 12),
            "signal must be known up to the last sample plus the delay, 2.1 s, for "
            "an exact predictor, but it ends at 2 s",
        ),
    ],
)
def test_what_makes_no_law_is_refused_by_name(call, message):
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        call()


def test_the_oracle_needs_the_signal_up_to_the_last_arrival_and_no_further():
    assert ORACLE.digital(H, SHORT, 11).state_gain.shape == (11, 1, 2)


def test_an_unstable_mean_gain_is_taken_when_it_is_meant():
    law = dt.MeanPredictor(PLANT, -GAIN, allow_unstable=True)
    assert np.array_equal(law.gain, -GAIN)


@pytest.mark.parametrize("dwell_time", [0.0, -0.2, np.nan, np.inf])
def test_a_dwell_time_that_is_none_is_refused(dwell_time):
    with pytest.raises(dt.ArgumentError, match="dwell_time must be"):
        dt.AveragedPredictor(PLANT, GAINS, None, dwell_time)
    with pytest.raises(dt.ArgumentError, match="dwell_time must be"):
        dt.MeanPredictor(PLANT, GAIN, None, dwell_time)


@pytest.mark.parametrize("dwell_time", [1e9, 1e30])
def test_a_dwell_time_whose_table_memory_does_not_hold_is_refused(dwell_time):
    law = dt.AveragedPredictor(PLANT, GAINS, None, dwell_time)
    with pytest.raises(dt.ArgumentError, match=r"dwell_time needs a table of .* ages"):
        law.digital(H)


def test_a_loop_that_is_stable_only_with_its_delay_is_a_case_that_the_message_names():
    # x'' + x = 0.1 x(t − 1): the delay turns a spring into a damper.
    plant = dt.SwitchedSystem([[[0.0, 1.0], [-1.0, 0.0]]], [[[0.0], [1.0]]], 1.0)
    with pytest.raises(dt.ArgumentError, match="loops that are stable only with their delay"):
        dt.DelayedStateFeedback(plant, [[[0.1, 0.0]]])
    law = dt.DelayedStateFeedback(plant, [[[0.1, 0.0]]], allow_unstable=True)
    assert dt.growth_rate(plant, law, 0, None) < -0.03
    assert dt.delay_margin(plant, law, None).upper == pytest.approx(np.pi / np.sqrt(1.1))


def test_an_oracle_whose_prediction_overflows_is_refused_wherever_it_runs():
    plant, signal = dt.SwitchedSystem([[[10.0]]], [[[1.0]]], 100.0), dt.SwitchingSignal.constant(0)
    law = dt.ExactPredictor(plant, [[[-11.0]]])
    for run in (
        lambda: law.digital(0.1, signal, 10),
        lambda: dt.simulate(plant, law, signal, [1.0], 5.0, 0.1),
        lambda: dt.monte_carlo(plant, {"law": law}, [signal] * 2, [1.0], 5.0, 0.1),
    ):
        with pytest.raises(dt.ArgumentError, match="gains over its delay overflow"):
            run()
