"""Laws: one contract for all, hand-derived tables, relations."""

import numpy as np
import pytest

import deadtime as dt
import plants

A, B, K, H = -0.7, 1.3, -0.4, 0.1
DELAYS = [0.234, 0.3, 0.07, 0.04, 1.75]


def table(law, signal=None, steps=12, step=H):
    return law.digital(step, plants.off_grid() if signal is None else signal, steps)


# -- one contract ------------------------------------------------------------------------------


@pytest.mark.parametrize("delay", DELAYS)
@pytest.mark.parametrize("name", plants.LAWS)
def test_every_law_is_a_finite_read_only_table_of_the_right_shape(name, delay):
    plant = plants.generic(delay)
    law = plants.LAWS[name](plant)
    feedback = table(law)
    contexts = {
        "exact": ("step", 12),
        "delayed": ("mode", 3),
        "expected": ("mode", 3),
        "averaged, dwell-aware": ("mode_age", 3 * 3),
        "mean, dwell-aware": ("mode_age", 3 * 5),
    }
    context, rows = contexts.get(name, ("none", 1))
    taps = int(np.ceil(round(delay / H, 9)))
    assert feedback.state_gain.shape == (rows, 2, 3)
    assert feedback.input_gain.shape == (rows, taps, 2, 2)
    assert feedback.context == context
    assert (feedback.step, feedback.taps) == (H, taps)
    for array in (feedback.state_gain, feedback.input_gain, *(feedback.factor or ())):
        assert np.isfinite(array).all()
        assert not array.flags.writeable
    assert law.plant is plant
    assert law.gains is None or law.gains.shape == (3, 2, 3)
    assert law.label


@pytest.mark.parametrize("name", plants.LAWS)
def test_a_delay_shorter_than_the_step_leaves_one_tap(name):
    assert table(plants.LAWS[name](plants.generic(0.04))).taps == 1


@pytest.mark.parametrize("name", plants.LAWS)
def test_every_law_refuses_a_step_that_is_not_positive(name):
    with pytest.raises(dt.ArgumentError, match=r"step must be positive, in s, got 0\."):
        table(plants.LAWS[name](plants.generic()), step=0.0)


@pytest.mark.parametrize("name", plants.LAWS)
def test_a_law_is_immutable(name):
    law = plants.LAWS[name](plants.generic())
    with pytest.raises(AttributeError):
        law.plant = plants.generic(0.5)
    if law.gains is not None:
        with pytest.raises(ValueError, match="read-only"):
            law.gains[0] = 0.0


def test_labels_tell_the_laws_apart():
    labels = [
        plants.LAWS[name](plants.generic()).label
        for name in plants.LAWS
        if name not in ("weighted", "mean with gains")
    ]
    assert labels == [
        "averaged",
        "mode 2 only",
        "mean",
        "averaged, dwell-aware",
        "mean, dwell-aware",
        "expected",
        "oracle",
        "delay ignored",
        "averaged, low-pass",
    ]


# -- hand-derived tables -----------------------------------------------------------------------


def by_hand(a, b, gain, delay):
    """F = K e^{aD}, G_j = K b e^{a(j−1)h} (e^{ah} − 1)/a, G_N with φ in place of h."""
    taps = int(np.ceil(round(delay / H, 9)))
    phase = delay - (taps - 1) * H
    length = np.array([H] * (taps - 1) + [phase])
    G = gain * b * np.exp(a * H * np.arange(taps)) * np.expm1(a * length) / a
    return gain * np.exp(a * delay), G


@pytest.mark.parametrize("delay", DELAYS)
def test_the_table_of_one_scalar_mode_is_its_closed_form(delay):
    plant = plants.scalar(A, B, delay)
    F, G = by_hand(A, B, K, delay)
    for law in (
        dt.AveragedPredictor(plant, [[[K]]]),
        dt.SingleModePredictor(plant, [[[K]]], 0),
        dt.MeanPredictor(plant, [[K]]),
        dt.ExactPredictor(plant, [[[K]]]),
    ):
        feedback = table(law, dt.SwitchingSignal.constant(0))
        for row in range(feedback.state_gain.shape[0]):
            plants.close(feedback.state_gain[row, 0, 0], F, 1e-13)
            plants.close(feedback.input_gain[row, :, 0, 0], G, 1e-13)


def test_the_averaged_table_is_the_weighted_sum_of_the_modes_closed_forms():
    a, gains, weights = np.array([-0.7, 0.5]), np.array([-0.4, -1.1]), np.array([0.3, 0.7])
    plant = plants.scalar(a, B, 0.234)
    feedback = table(dt.AveragedPredictor(plant, gains[:, None, None], weights))
    forms = [by_hand(a[i], B, gains[i], 0.234) for i in range(2)]
    plants.close(feedback.state_gain[0, 0, 0], weights @ [F for F, _ in forms], 1e-13)
    plants.close(feedback.input_gain[0, :, 0, 0], weights @ [G for _, G in forms], 1e-13)


def test_the_mean_table_is_that_of_the_mean_plant_or_of_the_centre_given():
    plant = plants.scalar([-0.7, 0.5], B, 0.234)
    for mean, a, b in [(None, -0.1, B), (([[-0.3]], [[0.9]]), -0.3, 0.9)]:
        feedback = table(dt.MeanPredictor(plant, [[-0.6]], mean=mean))
        F, G = by_hand(a, b, -0.6, 0.234)
        plants.close(feedback.state_gain[0, 0, 0], F, 1e-13)
        plants.close(feedback.input_gain[0, :, 0, 0], G, 1e-13)


def test_one_switch_on_the_way_gives_the_oracle_s_closed_form():
    # D = 0.25, h = 0.1, φ = 0.05: u_{−3}, u_{−2}, u_{−1} act on [0, φ), [φ, φ + h), [φ + h, D).
    a, gains, switch = np.array([-0.7, 0.5]), np.array([-0.4, -1.1]), 0.11
    plant = plants.scalar(a, B, 0.25)
    law = dt.ExactPredictor(plant, gains[:, None, None])
    feedback = law.digital(H, dt.SwitchingSignal([0, switch], [0, 1]), 1)
    early, late = np.exp(a[0] * switch), np.exp(a[1] * (0.25 - switch))

    def before(s, t):  # ∫ of the transition over [s, t] ⊂ [0, switch]
        return late * early * (np.exp(-a[0] * s) - np.exp(-a[0] * t)) / a[0]

    def after(s, t):
        return (np.exp(a[1] * (0.25 - s)) - np.exp(a[1] * (0.25 - t))) / a[1]

    G = [after(0.15, 0.25), before(0.05, switch) + after(switch, 0.15), before(0.0, 0.05)]
    plants.close(feedback.state_gain[0, 0, 0], gains[1] * late * early, 1e-13)
    plants.close(feedback.input_gain[0, :, 0, 0], gains[1] * B * np.array(G), 1e-13)


@pytest.mark.parametrize("delay", [0.25, 0.3, 0.04])
@pytest.mark.parametrize("k", range(8))
def test_a_switch_exactly_when_the_input_arrives_counts(delay, k):
    plant = plants.scalar([A, A], B, delay)
    law = dt.ExactPredictor(plant, [[[-0.4]], [[-1.1]]])
    arrival = k * H + delay
    for switch in (arrival, np.nextafter(arrival, 0), np.nextafter(arrival, 9)):
        F = law.digital(H, dt.SwitchingSignal([0, switch], [0, 1]), 8).state_gain[:, 0, 0]
        gain = np.where(np.arange(8) < k, -0.4, -1.1)
        plants.close(F, gain * np.exp(A * delay), 1e-13)


def test_the_baseline_is_the_gain_and_no_past_input():
    plant = plants.generic()
    feedback = table(plants.LAWS["delayed"](plant))
    assert np.array_equal(feedback.state_gain, plants.gains(plant))
    assert not feedback.input_gain.any()


# -- relations ---------------------------------------------------------------------------------


@pytest.mark.parametrize("delay", DELAYS)
def test_identical_modes_make_every_predictor_the_same_table(delay):
    plant = plants.identical(delay)
    reference = table(plants.LAWS["single"](plant))
    for name in plants.PREDICTORS:
        feedback = table(plants.LAWS[name](plant))
        for row in range(feedback.state_gain.shape[0]):
            plants.close(feedback.state_gain[row], reference.state_gain[0], 1e-13)
            plants.close(feedback.input_gain[row], reference.input_gain[0], 1e-13)


@pytest.mark.parametrize("delay", DELAYS)
def test_the_oracle_of_a_constant_signal_is_the_law_of_that_mode(delay):
    plant = plants.generic(delay)
    for mode in range(3):
        oracle = table(plants.LAWS["exact"](plant), dt.SwitchingSignal.constant(mode))
        single = table(dt.SingleModePredictor(plant, plants.gains(plant), mode))
        for row in range(12):
            plants.close(oracle.state_gain[row], single.state_gain[0], 1e-13)
            plants.close(oracle.input_gain[row], single.input_gain[0], 1e-13)


def test_the_oracle_prefers_the_signal_it_was_built_with():
    plant = plants.generic()
    law = dt.ExactPredictor(plant, plants.gains(plant), dt.SwitchingSignal.constant(1))
    own = law.digital(H, None, 5)
    assert np.array_equal(own.state_gain, law.digital(H, plants.off_grid(), 5).state_gain)
    constant = table(plants.LAWS["exact"](plant), dt.SwitchingSignal.constant(1), 5)
    assert np.array_equal(own.state_gain, constant.state_gain)


def test_equal_weights_are_the_default():
    plant = plants.generic()
    law = dt.AveragedPredictor(plant, plants.gains(plant), np.full(3, 1 / 3))
    assert np.array_equal(table(law).input_gain, table(plants.LAWS["averaged"](plant)).input_gain)
