"""Markov chains at samples: signals on the grid, the chain at longer periods, and the fit."""

import numpy as np
import pytest
from scipy.linalg import expm

import deadtime as dt

P = np.array([[0.8, 0.15, 0.05], [0.3, 0.6, 0.1], [0.0, 0.5, 0.5]])
STEP = 0.1


def periods(signal, step=STEP):
    return np.rint(signal.times / step).astype(int)


def test_signals_switch_at_multiples_of_the_period_to_the_bit_and_nowhere_else():
    signal = dt.MarkovChain(P, STEP).sample(500.0, seed=2)
    assert signal.switches > 1000
    np.testing.assert_array_equal(signal.times, periods(signal) * STEP)
    assert np.diff(periods(signal)).min() == 1


def test_modes_follow_each_other_as_often_as_P_says():
    signal = dt.MarkovChain(P, STEP).sample(20_000.0, seed=4)
    modes = np.repeat(signal.modes, np.diff(periods(signal), append=200_000))
    counts = np.zeros((3, 3))
    np.add.at(counts, (modes[:-1], modes[1:]), 1.0)
    total = counts.sum(axis=1, keepdims=True)
    error = np.sqrt(P * (1.0 - P) / total)
    assert (np.abs(counts / total - P) <= 4.0 * error).all()
    assert counts[2, 0] == 0


def test_a_signal_is_the_same_alone_in_a_batch_and_continued():
    model = dt.MarkovChain(P, STEP)
    batch = model.draw(20.0, seed=7, count=40)
    for number in (0, 17, 39):
        alone, longer = (model.draw(T, seed=7, first=number)[0] for T in (20.0, 60.0))
        np.testing.assert_array_equal(batch[number].times, alone.times)
        np.testing.assert_array_equal(batch[number].modes, alone.modes)
        np.testing.assert_array_equal(longer.times[: alone.times.size], alone.times)
    assert {batch[i].modes[0] for i in range(40)} == {0, 1, 2}


@pytest.mark.parametrize("horizon", [0.3, 0.7, 3 * 0.1, 0.35, 0.05])
def test_switches_lie_before_the_horizon_whatever_floats_make_of_it(horizon):
    """0.3/0.1 < 3 and 3·0.1 > 0.3 in floats."""
    always = dt.MarkovChain([[0.0, 1.0], [1.0, 0.0]], STEP)
    signal = always.sample(horizon, seed=1)
    expected = np.arange(np.ceil(np.round(horizon / STEP, 9)))
    np.testing.assert_array_equal(signal.times, expected * STEP)
    assert signal.end == horizon


def test_a_mode_that_is_never_left_is_held():
    model = dt.MarkovChain([[1.0, 0.0], [0.5, 0.5]], STEP)
    assert model.mean.tolist() == [np.inf, 0.2]
    assert model.transitions.tolist() == [[False, False], [True, False]]
    for number in range(20):
        assert model.draw(50.0, seed=3, first=number)[0].modes[-1] == 0


def test_at_a_period_of_several_steps_the_chain_is_the_power_of_P():
    model = dt.MarkovChain(P, STEP)
    for count in (1, 2, 5):
        chain = model.chain(count * STEP, ages=7)
        whole = np.linalg.matrix_power(P, count)
        np.testing.assert_allclose(chain.hazard[:, 0], 1.0 - np.diag(whole), atol=1e-15)
        moved = chain.hazard * chain.jump
        np.testing.assert_allclose(moved + np.diag(np.diag(whole)), whole, atol=1e-15)
        assert chain.hazard.shape == (3, 1)
        assert chain.within == (count > 1)
    assert model.ages(STEP) is None
    assert model.generator is None


@pytest.mark.parametrize("step", [0.05, 0.15, 0.1001])
def test_a_period_that_is_no_multiple_of_the_chains_is_refused_by_name(step):
    problem = dt.problems.paper()
    model = dt.MarkovChain([[0.9, 0.1], [0.2, 0.8]], STEP)
    message = rf"step = {step:g} s must be that of the MarkovChain, 0\.1 s, or a multiple of it"
    for asked in (
        lambda: dt.ExpectedPredictor(problem.plant, problem.gains, model).digital(step),
        lambda: dt.ModeFilter(problem.plant, model, step, disturbance=1e-4),
    ):
        with pytest.raises(dt.ArgumentError, match=message):
            asked()


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ([[0.5, 0.5]], r"P must have shape \(modes, modes\)"),
        (
            [[0.5, 0.4], [0.0, 1.0]],
            r"P\[0\] must be probabilities, ≥ 0 with sum 1, got .* with sum 0\.9",
        ),
        ([[1.0, 0.0], [1.1, -0.1]], r"P\[1\] must be probabilities, ≥ 0 with sum 1"),
    ],
)
def test_what_holds_no_probabilities_is_refused_by_its_row(table, message):
    with pytest.raises(dt.ArgumentError, match=message):
        dt.MarkovChain(table, STEP)


def test_a_period_that_is_not_positive_is_refused():
    with pytest.raises(dt.ArgumentError, match="step must be positive"):
        dt.MarkovChain(P, 0.0)


# -- the fit ----------------------------------------------------------------------------------


def test_a_fit_counts_what_follows_what_at_samples():
    """They are 0 0 0 1 1 0 0 2 2 2; none sees mode 1 from 0.62 to 0.68 s."""
    times, modes = [0.0, 3 * 0.1, 0.45, 0.62, 0.68], [0, 1, 0, 1, 2]
    signal = dt.SwitchingSignal(times, modes, end=1.0)
    with pytest.raises(dt.ArgumentError, match="no sample after one of mode 3"):
        dt.MarkovChain.fit(signal, STEP, modes=4)
    expected = [[3 / 5, 1 / 5, 1 / 5], [1 / 2, 1 / 2, 0.0], [0.0, 0.0, 1.0]]
    np.testing.assert_allclose(dt.MarkovChain.fit(signal, STEP).P, expected, atol=1e-15)


def test_of_a_log_without_an_end_only_the_first_sample_of_the_last_mode_counts():
    signal = dt.SwitchingSignal([0.0, 0.3, 0.5], [0, 1, 0])
    np.testing.assert_allclose(
        dt.MarkovChain.fit(signal, STEP).P, [[2 / 3, 1 / 3], [1 / 2, 1 / 2]], atol=1e-15
    )


def test_fewer_modes_than_the_logs_have_are_refused():
    with pytest.raises(dt.ArgumentError, match="modes must be at least 2, got 1: signals enter"):
        dt.MarkovChain.fit(dt.SwitchingSignal([0.0, 0.2], [0, 1], end=0.4), STEP, modes=1)


def test_several_logs_are_counted_together():
    log = dt.SwitchingSignal([0.0, 0.2], [0, 1], end=0.4)
    other = dt.SwitchingSignal([0.0, 0.2], [1, 0], end=0.4)
    fitted = dt.MarkovChain.fit([log, other], STEP)
    np.testing.assert_allclose(fitted.P, [[2 / 3, 1 / 3], [1 / 3, 2 / 3]], atol=1e-15)


@pytest.mark.parametrize("seed", range(3))
def test_a_fit_finds_the_chain_that_was_drawn_within_its_error(seed):
    fitted = dt.MarkovChain.fit(dt.MarkovChain(P, STEP).sample(4000.0, seed=seed), STEP)
    visits = 40_000 * np.array([0.5, 0.3, 0.1])  # at least
    error = np.sqrt(P * (1.0 - P) / visits[:, None])
    assert (np.abs(fitted.P - P) <= 4.0 * error).all()
    assert fitted.step == STEP


def test_a_process_in_continuous_time_is_fitted_as_its_chain_at_samples():
    model = dt.Markov([[0.0, 2.0], [1.0, 0.0]])
    fitted = dt.MarkovChain.fit(model.sample(20_000.0, seed=1), STEP)
    np.testing.assert_allclose(fitted.P, expm(STEP * model.generator), atol=0.003)
