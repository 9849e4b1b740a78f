"""The transformations, the target system and the Lyapunov functional along ideal runs."""

import numpy as np
import pytest

import deadtime as dt
import plants
from deadtime.certificates.theorem.backstepping import (
    Backstepping,
    lyapunov_derivative,
    lyapunov_functional,
    mismatch_at,
    target_rate,
)
from deadtime.simulation.initial_input import InputHistory

PAPER = dt.problems.paper()
GENERIC = plants.generic()
SETTINGS = {
    "paper": (PAPER.plant, PAPER.gains, PAPER.signal, np.array([-1.0, 1.0])),
    "three modes, two inputs": (
        GENERIC,
        plants.gains(GENERIC),
        dt.SwitchingSignal.random(3, 6.0, dwell_time=0.07, seed=2),
        np.array([1.0, -0.5, 0.3]),
    ),
}


def ideal_run(setting, horizon=3.0):
    plant, gains, signal, x0 = SETTINGS[setting]
    law = dt.AveragedPredictor(plant, gains, allow_unstable=True)
    return dt.simulate(plant, law, signal, x0, horizon, step=None), gains


@pytest.mark.few(1)
@pytest.mark.parametrize("setting", SETTINGS)
def test_forward_then_inverse_transformation_is_the_identity(setting):
    run, gains = ideal_run(setting)
    change = Backstepping(run.plant, gains, run.signal, run.end)
    u = run.history
    w = change.direct(run.states[:, -1], u)
    back = change.inverse(run.states[:, -1], InputHistory(w, w.edges))
    s = np.linspace(-0.999 * run.plant.delay, -1e-6, 500)
    size = np.abs(u.function(s)).max()
    assert np.abs(back(s) - u.function(s)).max() <= 1e-10 * size
    assert np.abs(w(s)).max() > 1e-3 * size  # the identity is not trivial


@pytest.mark.parametrize("setting", SETTINGS)
def test_direct_transformation_equals_the_mismatch_along_the_run(setting):
    run, gains = ideal_run(setting)
    w = Backstepping(run.plant, gains, run.signal, run.end).direct(run.states[:, -1], run.history)
    s = np.linspace(-0.999 * run.plant.delay, -1e-6, 500)
    along = mismatch_at(run, gains, run.end + s)
    assert np.abs(w(s) - along).max() <= 1e-10 * np.abs(run.inputs).max()


def test_mismatch_from_time_zero_on_is_that_of_the_run():
    run, gains = ideal_run("paper")
    np.testing.assert_allclose(mismatch_at(run, gains, run.time).T, run.mismatch, atol=1e-13)


@pytest.mark.parametrize("setting", SETTINGS)
def test_target_system_moves_as_the_plant_does(setting):
    run, gains = ideal_run(setting)
    t = np.linspace(0.0, 2.9, 301)
    mode, x = run.signal(t), run.record.states_at(t)
    u = run.record.inputs_at(t - run.plant.delay)
    slope = np.einsum("kij,kj->ki", run.plant.A[mode], x)
    slope += np.einsum("kij,kj->ki", run.plant.B[mode], u)
    error = np.abs(target_rate(run, gains, t) - slope).max()
    assert error <= 1e-11 * np.abs(slope).max()


@pytest.mark.parametrize("setting", SETTINGS)
def test_derivative_of_the_functional_is_the_expression_before_youngs_inequality(setting):
    run, gains = ideal_run(setting)
    P, b, h = np.diag(np.arange(1.0, run.plant.states + 1.0)), 0.7, 1e-3
    breaks = np.concatenate((run.record.states.edges, run.record.inputs.edges))
    t = np.linspace(0.01, 2.9, 120)
    clear = np.ones(t.size, bool)
    for shift in (-run.plant.delay, 0.0, run.plant.delay):
        clear &= np.abs(t[:, None] + shift - breaks).min(axis=1) > 3.5 * h
    t = t[clear]
    assert t.size > 30

    def V(times):
        return lyapunov_functional(run, gains, P, b, times)

    # Sixth-order difference: its error is far below the tolerance for these smooth pieces.
    slope = (
        45.0 * (V(t + h) - V(t - h)) - 9.0 * (V(t + 2 * h) - V(t - 2 * h)) + V(t + 3 * h) - V(t - 3 * h)
    ) / (60.0 * h)  # fmt: skip
    exact = lyapunov_derivative(run, gains, P, b, t)
    assert np.abs(slope - exact).max() <= 1e-8 * np.abs(exact).max()


@pytest.mark.parametrize("delay", [0.3, 0.7, 1.1])
def test_identities_hold_at_the_switches_themselves_however_sums_round(delay):
    plant = dt.SwitchedSystem(PAPER.plant.A, PAPER.plant.B, delay)
    signal = dt.SwitchingSignal(np.arange(0, 30) * 0.1, np.arange(30) % 2)
    law = dt.AveragedPredictor(plant, PAPER.gains)
    t = np.arange(0, 19) * 0.1
    run = dt.simulate(plant, law, signal, [-1.0, 1.0], 2.0, step=None, times=t)
    size = np.abs(run.inputs).max()
    assert np.abs(mismatch_at(run, PAPER.gains, t) - run.mismatch.T).max() <= 1e-12 * size
    mode = np.arange(19) % 2
    u = run.record.inputs_at(t - delay)
    slope = np.einsum("kij,kj->ki", plant.A[mode], run.states.T)
    slope += np.einsum("kij,kj->ki", plant.B[mode], u)
    assert np.abs(target_rate(run, PAPER.gains, t) - slope).max() <= 1e-11 * size


def test_functional_needs_an_ideal_run():
    digital = PAPER.simulate("averaged")
    with pytest.raises(dt.ArgumentError, match="run must be an ideal one: simulate with step=None"):
        lyapunov_functional(digital, PAPER.gains, np.eye(2), 1.0, np.array([2.0]))


def test_functional_decreases_where_the_theorem_holds():
    A = np.array([[[0.0, 1.0], [0.0, -0.5]]])
    plant = dt.SwitchedSystem(np.repeat(A, 2, axis=0), np.array([[[0.0], [1.0]]] * 2), delay=0.3)
    gains = dt.place(plant, [-0.6, -0.8])
    step = np.array([[[0.0, 0.0], [0.0, 0.0]], [[0.0, 0.0], [1e-9, 0.0]]])
    plant = dt.SwitchedSystem(plant.A + step, plant.B, plant.delay)
    bound = dt.theorem_bound(plant, gains, dwell_time=0.1)
    assert bound.holds
    signal = dt.SwitchingSignal.random(2, 8.0, dwell_time=0.1, seed=5)
    law = dt.AveragedPredictor(plant, gains)
    run = dt.simulate(plant, law, signal, [1.0, -1.0], 6.0, step=None, u0=2.0)
    t = np.linspace(0.0, 6.0, 200)
    values = lyapunov_functional(run, gains, bound.lyapunov.P, bound.b, t)
    assert (np.diff(values) < 0.0).all()
    assert (values <= values[0] * np.exp(-bound.mu * t) * (1.0 + 1e-12)).all()
