"""Runs of the ideal loop are the limit of digital ones and relate as scaling and symmetry say."""

import numpy as np
import pytest

import deadtime as dt
import plants
from ideal_runs import PLANT, SIGNAL, X0, run, same_run

# -- the digital loop's limit ------------------------------------------------------------------


@pytest.mark.few(2)
@pytest.mark.parametrize("name", plants.IDEAL)
def test_the_digital_loop_tends_to_the_ideal_one_with_order_one(name):
    plant = plants.generic(0.2)
    signal = dt.SwitchingSignal([0.0, 0.4, 0.7, 1.2, 1.5], [0, 1, 2, 0, 1])
    law, t = plants.LAWS[name](plant), np.arange(21) * 0.1
    ideal = run(law, plant, signal, X0, 2.0, times=t).states
    steps = 0.005 / 2.0 ** np.arange(4)
    errors = [
        np.abs(dt.simulate(plant, law, signal, X0, 2.0, step=h, times=t).states - ideal).max()
        for h in steps
    ]
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(1.0, abs=0.05)


# -- relations between runs --------------------------------------------------------------------


def test_identical_modes_make_every_predictor_the_same_run():
    plant = plants.identical()
    same = run("single", plant)
    for name in plants.PREDICTORS:
        same_run(run(name, plant), same, 1e-12)


@pytest.mark.few(2)
@pytest.mark.parametrize("name", plants.IDEAL)
def test_a_change_of_state_variables_commutes_with_simulation(name):
    T = np.array([[2.0, 0.5, 0.0], [-1.0, 1.0, 0.3], [0.2, 0.0, 0.7]])
    plant, law = plants.in_other_units(name, T, 1.0)
    one, other = run(name), run(law, plant, x0=T @ X0)
    plants.close(other.states, T @ one.states, 1e-11)
    plants.close(other.inputs, one.inputs, 1e-11)


@pytest.mark.few(2)
@pytest.mark.parametrize("name", plants.IDEAL)
def test_a_change_of_time_unit_commutes_with_simulation(name):
    c = 60.0
    plant, law = plants.in_other_units(name, np.eye(3), c)
    signal = dt.SwitchingSignal(SIGNAL.times * c, SIGNAL.modes)
    one, other = run(name), run(law, plant, signal, horizon=3.0 * c)
    plants.close(other.time, c * one.time, 1e-15)
    same_run(other, one, 1e-10)


@pytest.mark.few(2)
@pytest.mark.parametrize("name", plants.IDEAL)
def test_runs_superpose(name):
    whole = run(name, u0=[0.4, -1.0])
    free, forced = run(name), run(name, x0=np.zeros(3), u0=[0.4, -1.0])
    plants.close(free.states + forced.states, whole.states, 1e-11)
    plants.close(free.inputs + forced.inputs, whole.inputs, 1e-11)


def test_the_mismatch_is_u_minus_k_of_the_mode_and_state_a_delay_later():
    K = plants.gains(PLANT)[SIGNAL(np.linspace(0.0, 3.0, 1001) + PLANT.delay)]
    for name in ("averaged", "single", "mean with gains", "delayed"):
        one = run(name)
        later = run(name, horizon=3.5, times=one.time + PLANT.delay)
        expected = one.inputs - np.einsum("kij,jk->ik", K, later.states)
        plants.close(one.mismatch, expected, 1e-11, scale=np.abs(one.inputs).max())
    assert run("mean").mismatch is None


def test_a_fast_oscillation_under_slow_inputs_loses_nothing(monkeypatch):
    # What is interpolated on a segment is e^{−Aθ} f(θ), which turns as fast as the plant does.
    plant = dt.SwitchedSystem([[[0.0, 30.0], [-30.0, 0.0]]], [[[0.0], [1.0]]], 1.0)
    law = dt.ExactPredictor(plant, [[[0.0, -5.0]]])
    runs = []
    for resolution in (None, 0.4):
        if resolution:
            monkeypatch.setattr("deadtime.simulation.ideal.segments._RESOLUTION", resolution)
        signal = dt.SwitchingSignal.constant(0)
        runs.append(dt.simulate(plant, law, signal, [1.0, 0.0], 3.0, None, u0=5.0).states)
    assert np.abs(runs[0] - runs[1]).max() <= 3e-11 * np.abs(runs[1]).max()


@pytest.mark.parametrize("error", [0.8, 1.2])
@pytest.mark.parametrize("name", ["averaged", "delayed", "oracle"])
def test_shorter_segments_change_nothing_where_the_loop_grows_under_a_wrong_delay(
    monkeypatch, name, error
):
    problem = dt.problems.paper()
    law = {
        "averaged": dt.AveragedPredictor(problem.plant, problem.gains),
        "delayed": dt.DelayedStateFeedback(problem.plant, 3.0 * problem.gains),
        "oracle": dt.ExactPredictor(problem.plant, problem.gains),
    }[name]
    plant = dt.SwitchedSystem(problem.plant.A, problem.plant.B, error * problem.plant.delay)
    signal, runs = dt.SwitchingSignal([0.0, 0.37, 1.2, 2.9], [0, 1, 0, 1]), []
    for resolution in (1.5, 0.4):
        monkeypatch.setattr("deadtime.simulation.ideal.segments._RESOLUTION", resolution)
        runs.append(dt.simulate(plant, law, signal, [1.0, -0.5], 4.0, None).states)
    assert np.abs(runs[0] - runs[1]).max() <= 1e-11 * np.abs(runs[1]).max()


def test_a_plant_that_does_nothing_has_an_ideal_run():
    plant = dt.SwitchedSystem([[[0.0]]], [[[1.0]]], 1.0)
    law = dt.ExactPredictor(plant, [[[0.0]]], allow_unstable=True)
    run = dt.simulate(plant, law, dt.SwitchingSignal.constant(0), [2.0], 3.0, None)
    np.testing.assert_allclose(run.states, 2.0, rtol=1e-12)
