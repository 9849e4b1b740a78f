"""A constant force per mode, dx/dt = A_σ x + B_σ u(t − D) + c_σ, against solve_ivp and by hand."""

import itertools
import re

import numpy as np
import pytest
from scipy.integrate import quad_vec, solve_ivp

import deadtime as dt

A = np.array([[[0.0, 1.0], [-1.0, -0.4]], [[0.1, 1.0], [-2.0, -0.6]]])
B = np.array([[[0.0], [1.0]], [[0.3], [0.8]]])
PLANT = dt.SwitchedSystem(A, B, 0.27)
LAW = dt.AveragedPredictor(PLANT, dt.place(PLANT, [-1.0, -2.0]))
SIGNAL = dt.SwitchingSignal([0.0, 0.43, 0.47, 1.9, 3.0, 4.41], [0, 1, 0, 1, 0, 1])
C = np.array([[0.2, -1.0], [-0.5, 0.7]])
H, HORIZON, X0 = 0.1, 6.0, [0.5, -0.2]


def run_of(*more, signal=SIGNAL, plant=PLANT, law=LAW, **options):
    offset = dt.imperfections.StepDisturbance(C, **options)
    return dt.simulate(plant, law, signal, X0, HORIZON, H, imperfections=[offset, *more])


def integrated(run, signal=SIGNAL, plant=PLANT):
    """x of the same inputs by solve_ivp, stopped wherever something jumps."""
    delay, u = plant.delay, run.inputs[0]
    arrivals = np.arange(-3, run.time.size) * H + delay
    stops = np.unique(np.concatenate((arrivals, signal.times, [0.0, HORIZON])))
    stops = stops[(stops >= 0.0) & (stops <= HORIZON)]
    dense = []
    x = np.array(X0)
    for a, b in itertools.pairwise(stops):
        middle = 0.5 * (a + b)
        mode, k = int(signal(middle)), int(np.floor((middle - delay) / H))
        push = plant.B[mode][:, 0] * (u[k] if k >= 0 else 0.0) + C[mode]
        found = solve_ivp(
            lambda _, x, mode=mode, push=push: plant.A[mode] @ x + push,
            (a, b), x, method="DOP853", rtol=1e-12, atol=1e-13, dense_output=True,
        )  # fmt: skip
        dense.append((a, b, found.sol))
        x = found.y[:, -1]

    def at(t):
        return next(sol(t) for a, b, sol in dense if a <= t <= b)

    return at, stops


def test_states_at_and_between_samples_are_those_of_an_integrator_wherever_switches_fall():
    run = run_of()
    at, _ = integrated(run)
    for k in range(run.time.size):
        assert run.states[:, k] == pytest.approx(at(run.time[k]), rel=1e-9, abs=1e-10)
    times = np.array([0.44, 0.46, 0.48, 1.95, 3.07, 4.405, 4.415, 5.333])
    offset = dt.imperfections.StepDisturbance(C)
    between = dt.simulate(PLANT, LAW, SIGNAL, X0, HORIZON, H, times=times, imperfections=[offset])
    for k, t in enumerate(times):
        assert between.states[:, k] == pytest.approx(at(t), rel=1e-9, abs=1e-10)


def test_integrals_are_exact_in_periods_that_switches_cut():
    run = run_of()
    at, stops = integrated(run)
    total = sum(
        quad_vec(lambda t: at(t) @ at(t), a, b, epsrel=1e-12)[0]
        for a, b in itertools.pairwise(stops)
    )
    assert run.metrics()["ise"] == pytest.approx(total, rel=1e-9)


def test_the_same_row_for_all_modes_is_the_plain_force():
    same = dt.imperfections.StepDisturbance([C[0], C[0]], start=1.0, end=3.0)
    plain = dt.imperfections.StepDisturbance(C[0], start=1.0, end=3.0)
    runs = [
        dt.simulate(PLANT, LAW, SIGNAL, X0, HORIZON, H, imperfections=[one])
        for one in (same, plain)
    ]
    assert runs[0].states == pytest.approx(runs[1].states, rel=1e-12, abs=1e-12)
    assert runs[0].metrics()["cost"] == pytest.approx(runs[1].metrics()["cost"], rel=1e-12)


def test_beside_other_forces_they_add_up():
    other = dt.imperfections.StepDisturbance([0.1, 0.3], start=0.5)
    both, alone = run_of(other).states, run_of().states
    none = dt.simulate(PLANT, LAW, SIGNAL, X0, HORIZON, H).states
    plain = dt.simulate(PLANT, LAW, SIGNAL, X0, HORIZON, H, imperfections=[other]).states
    assert both - alone == pytest.approx(plain - none, abs=1e-12)


def test_delays_of_its_own_in_every_mode_change_nothing_about_it():
    own = dt.SwitchedSystem(A, B, [[0.27], [0.13]])
    law = dt.AveragedPredictor(own, LAW.gains)
    forced = run_of(plant=own, law=law)
    still = dt.simulate(own, law, SIGNAL, X0, HORIZON, H)
    twice = dt.imperfections.StepDisturbance(2.0 * C)
    double = dt.simulate(own, law, SIGNAL, X0, HORIZON, H, imperfections=[twice])
    assert double.states - still.states == pytest.approx(2.0 * (forced.states - still.states))
    same = dt.SwitchedSystem(A, B, [[0.27], [0.27]])
    assert np.array_equal(run_of(plant=same, law=LAW).states, run_of().states)


def test_a_rule_takes_it_as_the_signal_that_it_makes_of_it():
    rule = dt.HalfSpace([1.0, 0.3], 0.1)
    run = run_of(signal=rule)
    assert run.signal.times.size > 1
    again = run_of(signal=run.signal)
    assert run.states == pytest.approx(again.states, rel=1e-8, abs=1e-9)
    assert run.metrics()["ise"] == pytest.approx(again.metrics()["ise"], rel=1e-8)


def test_many_runs_say_the_same_one_by_one():
    offset = [dt.imperfections.StepDisturbance(C)]
    options = {"x0": X0, "horizon": HORIZON, "step": H, "imperfections": offset}
    data = dt.monte_carlo(PLANT, [LAW], [SIGNAL], **options)
    assert data.one_by_one == ["averaged"]
    assert data.ise.item() == run_of().metrics()["ise"]


def test_a_servo_leaves_no_offset_within_a_mode():
    servo = dt.Servo(PLANT, [[1.0, 0.0]])
    gains = servo.lqr(np.eye(3), [[1.0]], step=H)
    law = dt.AveragedPredictor(servo.plant, gains, allow_unstable=True)
    observer = dt.luenberger(servo.model, servo.C, [-4.0, -5.0], H)
    loop = dt.OutputFeedback(law, observer, servo=servo, reference=2.0)
    last = dt.SwitchingSignal([0.0, 2.0], [0, 1])
    offset = dt.imperfections.StepDisturbance(C)
    run = dt.simulate(PLANT, loop, last, [0.0, 0.0], 60.0, H, imperfections=[offset])
    assert run.states[0, -1] == pytest.approx(2.0, abs=1e-6)
    assert run.inputs[:, -1] == pytest.approx(servo.steady_input(2.0, C)[1], rel=1e-6)


def test_there_must_be_a_row_for_every_mode():
    wrong = dt.imperfections.StepDisturbance(C[:1])
    message = "StepDisturbance.force must have shape (modes, n) = (2, 2), got (1, 2)"
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        dt.simulate(PLANT, LAW, SIGNAL, X0, HORIZON, H, imperfections=[wrong])
    with pytest.raises(dt.ArgumentError, match="the ideal loop has no samples"):
        dt.simulate(PLANT, LAW, SIGNAL, X0, HORIZON, None, imperfections=[wrong])
