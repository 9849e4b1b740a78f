"""The low-pass law: its table against the filter's own recursion, and the loop that it makes."""

import numpy as np
import pytest

import deadtime as dt
import plants

H = 0.1
T = np.array([[0.06, 0.03], [-0.02, 0.05]])


@pytest.mark.parametrize("delay", [0.234, 0.3, 0.05, 0.1])
@pytest.mark.parametrize("inner", ["averaged", "mean, dwell-aware", "expected", "delayed", "exact"])
def test_a_run_s_inputs_are_the_wrapped_law_s_through_the_filter(inner, delay):
    plant, signal = plants.generic(delay), plants.off_grid()
    law = plants.LAWS[inner](plants.generic(1.1 * delay))
    history = np.random.default_rng(0).normal(size=(2, 8))
    taps = law.digital(H, signal, 20).taps
    past = history[:, : max(taps, int(np.ceil(round(delay / H, 9))))]
    run = dt.simulate(plant, dt.LowPassPredictor(law, T), signal, [1.0, -1.0, 0.5], 1.9, H, past)
    u = run.inputs.T
    held = past[:, past.shape[1] - taps :].T
    v, scale = plants.expected_inputs(law.digital(H, signal, 20), run.states.T, run.mode, u, held)
    E = plants.expm(-H * np.linalg.inv(T))
    before = np.concatenate((held[-1:], u[:-1]))
    plants.close(u, before @ E.T + v @ (np.eye(2) - E).T, 1e-12, scale.max())


@pytest.mark.parametrize("delay", [0.234, 0.3, 0.05, 0.1, 1.77])
def test_the_factorisation_is_the_dense_taps(delay):
    table = plants.LAWS["averaged, low-pass"](plants.generic(delay)).digital(H)
    taps = table.factor.taps(table.taps)
    plants.close(taps, table.input_gain, 1e-12)
    assert table.factor.S.shape == (9 + 2, 9 + 2)


@pytest.mark.parametrize("delay", [0.234, 0.3, 0.05])
def test_one_mode_under_its_own_law_has_the_spectrum_of_prediction_and_filter(delay):
    whole = plants.generic(delay)
    plant = dt.SwitchedSystem(whole.A[:1], whole.B[:1], delay)
    K = plants.gains(plant)
    law = dt.LowPassPredictor(dt.SingleModePredictor(plant, K, 0), T)
    E = plants.expm(-H * np.linalg.inv(T))
    Phi, Gamma = plants.held(plant.A[0], plant.B[0], H)
    v = (np.eye(2) - E) @ np.hstack((K[0], np.zeros((2, 2)))) + np.hstack((np.zeros((2, 3)), E))
    augmented = np.vstack((np.hstack((Phi, np.zeros((3, 2)))) + Gamma @ v, v))
    L = dt.spectrum.lifted_loop(plant, law.digital(H), 0)
    found = np.linalg.eigvals(L)
    for value in np.linalg.eigvals(augmented):
        assert np.abs(found - value).min() < 1e-7
    radius = np.abs(np.linalg.eigvals(augmented)).max()
    assert dt.growth_rate(plant, law, 0, H) == pytest.approx(np.log(radius) / H, abs=1e-7)


def test_a_fast_filter_is_no_filter():
    law = plants.LAWS["averaged"](plants.generic())
    plain, fast = law.digital(H), dt.LowPassPredictor(law, 1e-4).digital(H)
    plants.close(fast.state_gain, plain.state_gain, 1e-14)
    plants.close(fast.input_gain, plain.input_gain, 1e-14)


def test_a_filter_that_gains_were_not_chosen_for_costs_margin_and_so_does_a_longer_step():
    whole = dt.problems.paper()
    plant = dt.SwitchedSystem(whole.plant.A[:1], whole.plant.B[:1], 1.0)
    law = dt.SingleModePredictor(plant, whole.gains[:1], 0)
    margins = [dt.delay_margin(plant, law, 0.01).relative]
    margins += [
        dt.delay_margin(plant, dt.LowPassPredictor(law, time), 0.01).relative
        for time in (0.02, 0.05, 0.1)
    ]
    assert margins[0] == pytest.approx(0.0135, abs=1e-4)
    assert all(np.diff(margins) < 0.0)
    assert dt.delay_margin(plant, law, 0.1).relative < margins[0]


def test_it_can_be_certified_and_run():
    plant = plants.generic().apart(0.1)
    law = dt.LowPassPredictor(dt.AveragedPredictor(plant, plants.gains(plant)), T)
    assert dt.certify(plant, law, 0.3, H).proven
    controller, run = dt.Controller(law, H), None
    run = dt.simulate(plant, law, plants.off_grid(), [1.0, -1.0, 0.5], 2.0, H)
    for k in range(run.time.size):
        u = controller.update(run.states[:, k], int(run.mode[k]))
        plants.close(np.asarray(u), run.inputs[:, k], 1e-9, 1.0)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (0.0, r"time_constant must be positive, in s, or a matrix .* got 0"),
        (-1.0, r"positive real parts, got -1: without a filter use the law itself"),
        ([0.1, 0.2], r"time_constant must have shape \(\) or \(m, m\), got \(2,\)"),
        (np.eye(3), r"or \(m, m\) = \(2, 2\), got \(3, 3\)"),
        (np.nan, r"must be finite"),
        ([[1.0, 0.0], [1.0]], r"\(2, 2\), got rows of different lengths"),
        ([[0.0, 1.0], [-1.0, 0.0]], r"positive real parts, got 0"),
    ],
)
def test_a_time_constant_that_is_none_is_refused(value, message):
    with pytest.raises(dt.ArgumentError, match=message):
        dt.LowPassPredictor(plants.LAWS["averaged"](plants.generic()), value)


def test_what_cannot_be_filtered_is_refused_by_name():
    plant = plants.generic()
    law = dt.StateDependentPredictor(plant, plants.gains(plant), lambda x: 0)
    with pytest.raises(dt.ArgumentError, match="law must be a table, got StateDependentPredictor"):
        dt.LowPassPredictor(law, 0.1)
    filtered = plants.LAWS["averaged, low-pass"](plant)
    with pytest.raises(dt.ArgumentError, match="step must be given: LowPassPredictor feeds back"):
        dt.simulate(plant, filtered, plants.off_grid(), np.ones(3), 1.0, step=None)
    oracle = dt.ExactPredictor(plant, plants.gains(plant), plants.off_grid())
    with pytest.raises(dt.ArgumentError, match="must not assume a signal of its own"):
        dt.growth_rate(plant, dt.LowPassPredictor(oracle, 0.1), 0, H)


def test_a_problem_file_can_ask_for_it(tmp_path):
    text = """
[plant]
delay = 0.2
A = [[[1.0]], [[1.1]]]
B = [[[1.0]], [[1.0]]]
[gains]
poles = [-2.0]
[[law]]
kind = "averaged"
low_pass = 0.05
[signal]
kind = "constant"
mode = 0
[run]
x0 = [1.0]
horizon = 2.0
"""
    path = tmp_path / "problem.toml"
    path.write_text(text)
    from deadtime.problems.file import load_problem

    (law,) = load_problem(str(path)).laws.values()
    assert law.time_constant == pytest.approx(0.05)
    path.write_text(text.replace("0.05", "-0.05"))
    with pytest.raises(dt.ArgumentError, match=r"law.*time_constant must be positive"):
        load_problem(str(path))
