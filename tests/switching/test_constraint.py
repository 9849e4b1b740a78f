"""What signals may do: refusals by name, drawn signals that obey, truncated sojourns."""

import math

import numpy as np
import pytest
from scipy.stats import expon, gamma, kstest

import deadtime as dt
import plants
from deadtime.base.errors import ArgumentError

RING = [[0, 1, 0], [0, 0, 1], [1, 0, 0]]
SIGNAL = dt.SwitchingSignal([0.0, 0.5, 1.5, 1.75], [0, 1, 2, 0], end=3.0, initial_age=0.25)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"dwell_time": [0.2, 0.3]}, "dwell_time must be .* one for each of the 3"),
        ({"dwell_time": [0.2, -0.3, 0.1]}, r"dwell_time\[1\] must be positive"),
        ({"dwell_time": [0.2, math.inf, 0.1]}, r"dwell_time\[1\] must be finite"),
        (
            {"dwell_time": 0.5, "maximum_dwell": [1.0, 0.4, 1.0]},
            r"maximum_dwell\[1\] must be at least .* got 0.4",
        ),
        ({"transitions": [[0, 1], [1, 0]]}, r"transitions must have shape \(modes, modes\)"),
        (
            {"transitions": [[0, 0.5, 0.5], [1, 0, 0], [1, 0, 0]]},
            r"transitions\[0, 1\] must be True or False",
        ),
        (
            {"transitions": [[0, 1, 0], [1, 0, 1], [0, 0, 1]], "maximum_dwell": 1.0},
            r"transitions\[2\] .* left after 1 s",
        ),
        (
            {"transitions": [[0, 1, 0], [1, 0, 0], [0, 0, 0]]},
            "no switch to mode 2 and none from it",
        ),
    ],
)
def test_a_malformed_class_of_signals_is_refused_by_name(given, message):
    with pytest.raises(dt.ArgumentError, match=message):
        dt.SignalClass(**given).limits(3)
    with pytest.raises(dt.ArgumentError, match=message):
        dt.SwitchingSignal.random(3, 5.0, **{"dwell_time": 0.2} | given)
    plant = dt.SwitchedSystem(-np.eye(2)[None].repeat(3, 0), np.ones((3, 2, 1)), 0.1)
    law = dt.DelayedStateFeedback(plant, np.zeros((3, 1, 2)))
    for ask in (dt.certify, dt.falsify):
        with pytest.raises(dt.ArgumentError, match=message):
            ask(plant, law, **{"dwell_time": 0.2} | given)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"transitions": [[0, 1, 1], [1, 0, 0], [1, 0, 0]]},
            "from mode 1 to mode 2 at 1.5 s, .* from mode 1 only mode 0 may",
        ),
        ({"dwell_time": 0.3}, "from 1.5 s to 1.75 s, shorter than its dwell_time of 0.3"),
        (
            {"maximum_dwell": [0.7, 2, 2]},
            "from -0.25 s to 0.5 s, longer than its maximum_dwell of 0.7",
        ),
        ({"maximum_dwell": [1.0, 2, 2]}, "stays in mode 0 from 1.75 s to 3 s, longer"),
    ],
)
def test_a_signal_is_refused_by_what_it_does_first(given, message):
    with pytest.raises(dt.ArgumentError, match=message):
        SIGNAL.require_admissible(**given)


def test_an_admissible_signal_is_itself():
    allowed = {"dwell_time": [0.7, 1.0, 0.25], "maximum_dwell": [1.25, 1.0, 0.25]}
    assert SIGNAL.require_admissible(transitions=RING, **allowed) is SIGNAL
    with pytest.raises(dt.ArgumentError, match="on without end"):
        dt.SwitchingSignal.constant(0).require_admissible(maximum_dwell=2.0)


def test_drawn_signals_obey_and_fill_what_is_allowed():
    allowed = {"dwell_time": [0.1, 0.4, 0.2], "maximum_dwell": [0.3, math.inf, 0.2]}
    ways = [[0, 1, 1], [1, 0, 0], [0, 1, 0]]
    signal = dt.SwitchingSignal.random(3, 400.0, transitions=ways, mean_sojourn=0.4, **allowed)
    signal.require_admissible(transitions=ways, **allowed)
    pairs = set(zip(signal.modes[:-1].tolist(), signal.modes[1:].tolist(), strict=True))
    assert pairs == {(0, 1), (0, 2), (1, 0), (2, 1)}
    first = signal.sojourns[signal.modes[:-1] == 0]
    shares = expon(scale=0.3).cdf(first - 0.1) / expon(scale=0.3).cdf(0.2)
    assert kstest(shares, "uniform").pvalue > 0.01


def test_one_number_for_all_is_drawn_as_a_list_of_it():
    one = dt.SwitchingSignal.random(3, 20.0, dwell_time=0.3, seed=4)
    each = dt.SwitchingSignal.random(3, 20.0, dwell_time=[0.3] * 3, seed=4)
    assert np.array_equal(one.times, each.times)
    averaged = dt.SwitchingSignal.random(3, 50.0, average_dwell_time=0.3, transitions=RING)
    averaged.require_admissible(transitions=RING)


def test_truncated_sojourns_are_those_in_between():
    model = dt.SemiMarkov(
        gamma(2.0, scale=0.3), RING, dwell_time=[0.2, 0.3, 0.4], maximum_dwell=1.0
    )
    signal = model.sample(300.0, seed=1)
    signal.require_admissible([0.2, 0.3, 0.4], 1.0, model.transitions)
    own, full = signal.sojourns[signal.modes[:-1] == 1], gamma(2.0, scale=0.3)
    low, high = full.cdf(0.3), full.cdf(1.0)
    assert kstest((full.cdf(own) - low) / (high - low), "uniform").pvalue > 0.01
    density = np.linspace(0.3, 1.0, 20_001)
    mean = np.trapezoid(density * full.pdf(density), density) / (high - low)
    assert model.mean[1] == pytest.approx(mean, rel=1e-7)
    hazard = model.hazard(0.1, 12)
    assert np.array_equal(hazard[1, :3], np.zeros(3))
    assert hazard[1, 9] == 1.0
    assert hazard[1, 5] == pytest.approx((full.cdf(0.6) - full.cdf(0.5)) / (high - full.cdf(0.5)))


def test_sojourns_that_cannot_be_are_refused():
    with pytest.raises(dt.ArgumentError, match=r"sojourn\[1\] = 0.5 has no sojourn between"):
        dt.SemiMarkov([0.2, 0.5], maximum_dwell=0.4)


def test_models_hand_out_their_graph_and_a_fit_refuses_a_log_beside_it():
    assert dt.Markov([[0, 2.0, 0], [0, 0, 1], [1, 1, 0]]).transitions.tolist() == [
        [False, True, False], [False, False, True], [True, True, False]
    ]  # fmt: skip
    model = dt.SemiMarkov(gamma(4.0, scale=0.1), RING)
    log = model.sample(60.0, seed=2)
    fitted = dt.SemiMarkov.fit(log, family="gamma", transitions=RING)
    assert np.array_equal(fitted.transitions, np.array(RING) > 0)
    back = dt.SwitchingSignal([0.0, 0.5, 1.0], [0, 1, 0], end=2.0)
    with pytest.raises(dt.ArgumentError, match="switches from mode 1 to mode 0 at 1 s"):
        dt.SemiMarkov.fit([log, back], family="gamma", transitions=RING)


def test_a_maximum_of_inf_is_none_for_one_mode_and_for_all():
    free = dt.SignalClass(0.2).limits(3)
    for endless in (math.inf, np.inf, [math.inf] * 3):
        assert dt.SignalClass(0.2, endless).limits(3) == free
    plant = plants.generic()
    law = dt.AveragedPredictor(plant, np.zeros((3, 2, 3)), allow_unstable=True)
    with pytest.raises(ArgumentError, match="dwell_time must be"):
        dt.certify(plant, law, math.inf, 0.1, maximum_dwell=math.inf)
    with pytest.raises(ArgumentError, match="maximum_dwell must be"):
        dt.SignalClass(0.2, -math.inf).limits(3)
