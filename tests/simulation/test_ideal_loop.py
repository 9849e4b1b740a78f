"""The ideal loop agrees with closed forms and a second discretisation, however long it runs."""

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import expm

import deadtime as dt
import plants
from ideal_runs import (
    CONSTANT,
    PAPER,
    PLANT,
    SIGNAL,
    X0,
    agrees,
    other_model,
    reference,
    run,
    same_run,
)
from shares import mostly_long

SWITCHING = dt.problems.paper().signal


# -- hand-derived solutions --------------------------------------------------------------------


@pytest.mark.parametrize("u0", [None, 0.7])
def test_a_matched_scalar_loop_is_the_delay_free_one_after_the_delay(u0):
    a, b, k, x0, D = 1.3, 0.8, -4.0, 1.7, 0.45
    plant = plants.scalar(a, b, D)
    law = dt.SingleModePredictor(plant, [[[k]]], 0)
    one = run(law, plant, CONSTANT, [x0], 4.0, u0=u0)
    t, c = one.time, u0 or 0.0
    free = np.exp(a * t) * x0 + b * c * np.expm1(a * t) / a
    arrived = math.exp(a * D) * x0 + b * c * math.expm1(a * D) / a
    after = arrived * np.exp((a + b * k) * (t - D))
    plants.close(one.states[0], np.where(t < D, free, after), 1e-12)
    plants.close(one.inputs[0], k * arrived * np.exp((a + b * k) * t), 1e-12)


def test_delayed_feedback_on_an_integrator_is_the_delayed_exponential():
    # dx/dt = k x(t − D), x = 0 before 0, x(0) = 1:  x = Σ_j k^j (t − jD)₊^j / j!
    k, D, t = -1.6, 0.5, np.linspace(0.0, 4.0, 1001)
    plant = plants.scalar(0.0, 1.0, D)
    one = run(dt.DelayedStateFeedback(plant, [[[k]]]), plant, CONSTANT, [1.0], 4.0)
    x = sum(k**j * np.maximum(t - j * D, 0.0) ** j / math.factorial(j) for j in range(1, 9)) + 1.0
    plants.close(one.states[0], x, 1e-12)
    plants.close(one.inputs[0], k * x, 1e-12)


@pytest.mark.parametrize("delay", [0.234, 0.37])
def test_under_the_exact_predictor_the_state_follows_the_delay_free_ode_after_the_delay(delay):
    plant = plants.generic(delay)
    K = plants.gains(plant)
    marks = np.unique([*(delay + np.linspace(0.0, 2.5, 41)), *SIGNAL.times[SIGNAL.times > delay]])
    one = run("exact", plant, times=marks[marks <= 3.0])
    z, loop = one.states[:, 0], [one.states[:, 0]]
    for start, end in pairwise(one.time):
        i = SIGNAL((start + end) / 2.0)
        z = expm((plant.A[i] + plant.B[i] @ K[i]) * (end - start)) @ z
        loop.append(z)
    plants.close(one.states, np.array(loop).T, 1e-12)


def test_until_the_first_input_arrives_the_state_moves_freely():
    one = run(times=[0.0, 0.1, 0.1718, 0.234])
    x = expm(PLANT.A[0] * 0.1718) @ X0
    expected = [X0, expm(PLANT.A[0] * 0.1) @ X0, x, expm(PLANT.A[1] * 0.0622) @ x]
    plants.close(one.states, np.array(expected).T, 1e-13)


# -- a second discretisation -------------------------------------------------------------------


@pytest.mark.long
def test_the_reference_does_not_depend_on_its_mesh():
    law = plants.LAWS["averaged"](PAPER)
    coarse = reference(law, PAPER, SWITCHING, [-1.0, 1.0], 5.0)
    fine = reference(law, PAPER, SWITCHING, [-1.0, 1.0], 5.0, nodes=18, longest=0.04)
    t = np.linspace(0.0, 5.0, 501)
    plants.close(coarse.states(t), fine.states(t), 1e-12)
    plants.close(coarse.inputs(t), fine.inputs(t), 1e-12)


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("name", "horizon"),
    [
        ("averaged", 10.0),
        ("mean", 10.0),
        ("weighted", 4.0),
        ("single", 4.0),
        ("exact", 4.0),
        ("delayed", 4.0),
    ],
)
def test_the_paper_s_example_agrees_with_a_second_discretisation(name, horizon):
    agrees(plants.LAWS[name](PAPER), PAPER, SWITCHING, [-1.0, 1.0], horizon)


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_any_off_grid_signal_agrees_with_a_second_discretisation(seed):
    signal = dt.SwitchingSignal.random(2, 12.0, dwell_time=0.05, mean_sojourn=0.5, seed=seed)
    agrees(plants.LAWS["averaged"](PAPER), PAPER, signal, [-1.0, 1.0], 5.0)


@pytest.mark.few(3)
@pytest.mark.parametrize("name", plants.IDEAL)
def test_three_modes_agree_with_a_second_discretisation(name):
    agrees(plants.LAWS[name](PLANT), PLANT, SIGNAL, X0, 3.0)


@pytest.mark.few(3)
@pytest.mark.parametrize("name", plants.IDEAL)
@pytest.mark.parametrize("delay", mostly_long([0.234, 0.3171, 0.1517], 0.234))
def test_a_law_with_a_wrong_model_agrees_with_a_second_discretisation(name, delay):
    agrees(plants.LAWS[name](other_model(delay)), PLANT, SIGNAL, X0, 1.5)


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("delay", "model_delay"),
    [(1.0, 0.95), (1.0, 1.05), (1.0, 0.5), (0.5, 1.0), (0.05, 0.6), (0.6, 0.05)],
)
def test_a_wrong_delay_agrees_with_a_second_discretisation(delay, model_delay):
    law = plants.LAWS["averaged"](plants.paper(model_delay))
    agrees(law, plants.paper(delay), SWITCHING, [-1.0, 1.0], 3.0)


def test_an_oracle_that_believes_in_another_signal_agrees_with_a_second_discretisation():
    believed = dt.SwitchingSignal([0.0, 0.2222, 0.31, 0.9], [2, 1, 0, 2])
    agrees(dt.ExactPredictor(PLANT, plants.gains(PLANT), believed), PLANT, SIGNAL, X0, 2.0)


def test_an_oracle_whose_gains_differ_agrees_with_a_second_discretisation():
    gains = dt.place(PAPER, [[-1.0, -2.0], [-15.0, -20.0]])
    signal = dt.SwitchingSignal([0.0, 1.55, 2.31, 3.7], [0, 1, 0, 1])
    agrees(dt.ExactPredictor(PAPER, gains), PAPER, signal, [-1.0, 1.0], 4.0)


def test_a_plant_faster_than_its_loop_is_resolved():
    # x = e^{at} before the delay, and the law hardly acts.
    plant = plants.scalar(-50.0, delay=0.25)
    one = run(dt.SingleModePredictor(plant, [[[-0.1]]], 0), plant, CONSTANT, [1.0], 1.0)
    x = np.exp(-50.0 * np.minimum(one.time, 0.25) - 50.1 * np.maximum(one.time - 0.25, 0.0))
    plants.close(one.states[0], x, 1e-10)


LONG = dt.SwitchingSignal.random(2, 35.0, dwell_time=0.2, mean_sojourn=0.4, seed=3)


# -- long runs do not drift --------------------------------------------------------------------


@pytest.mark.parametrize("name", ["averaged", "mean", "exact"])
def test_a_longer_run_begins_as_the_shorter_one(name):
    t = np.linspace(0.0, 10.0, 501)
    long, short = (
        run(name, PAPER, LONG, [-1.0, 1.0], horizon, times=t) for horizon in (30.0, 10.0)
    )
    same_run(long, short, 1e-11)


def test_the_oracle_s_mismatch_stays_zero():
    one = run("exact", PAPER, LONG, [-1.0, 1.0], 30.0)
    assert np.abs(one.mismatch).max() <= 1e-11 * np.abs(one.states).max()


@pytest.mark.long
def test_thirty_seconds_agree_with_a_second_discretisation():
    law = plants.LAWS["mean"](PAPER)
    agrees(law, PAPER, LONG, [-1.0, 1.0], 30.0)


@pytest.mark.parametrize("name", ["averaged", "mean", "exact"])
def test_thirty_seconds_in_three_runs_are_one_run(name):
    t = np.linspace(0.0, 10.0, 401)
    whole = run(name, PAPER, LONG, [-1.0, 1.0], 30.0, times=np.linspace(0.0, 30.0, 1201))
    state, history, states, inputs = [-1.0, 1.0], None, [], []
    for start in (0.0, 10.0, 20.0):
        part = run(name, PAPER, LONG.after(start), state, 10.0, u0=history, times=t)
        state, history = part.states[:, -1], part.history
        states.append(part.states[:, :-1])
        inputs.append(part.inputs[:, :-1])
    plants.close(np.hstack(states), whole.states[:, :-1], 1e-10)
    plants.close(np.hstack(inputs), whole.inputs[:, :-1], 1e-10)


@pytest.mark.few(6)
@pytest.mark.parametrize("name", plants.IDEAL)
@pytest.mark.parametrize("first", [0.1, 0.8, 1.5])
def test_splitting_the_horizon_changes_nothing(name, first):
    history = np.random.default_rng(5).normal(size=(2, 3))
    whole = run(name, u0=history, times=np.linspace(0.0, 3.0, 301))
    start = run(name, horizon=first, u0=history, times=[first])
    rest = run(
        name,
        signal=SIGNAL.after(first),
        x0=start.states[:, -1],
        horizon=3.0 - first,
        u0=start.history,
        times=np.clip(np.linspace(0.0, 3.0, 301)[round(100 * first) :] - first, 0.0, 3.0 - first),
    )
    plants.close(rest.states, whole.states[:, round(100 * first) :], 1e-11)
    plants.close(rest.inputs, whole.inputs[:, round(100 * first) :], 1e-11)
