"""The ideal loop: closed forms, a second discretisation, limits, and relations between runs."""

import math
import re
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import fixed_quad
from scipy.linalg import expm

import deadtime as dt
import ideal_reference
import plants

PAPER = plants.paper()
SWITCHING = dt.problems.paper().signal
PLANT, SIGNAL = plants.generic(), plants.off_grid()  # D = 0.234
X0 = np.array([1.0, -0.5, 0.8])
CONSTANT = dt.SwitchingSignal.constant(0)


def run(name="averaged", plant=PLANT, signal=SIGNAL, x0=X0, horizon=3.0, **options):
    law = plants.LAWS[name](plant) if isinstance(name, str) else name
    return dt.simulate(plant, law, signal, x0, horizon, step=None, **options)


def belief(law, signal):
    """What the reference needs to know of a law."""
    model, known = law.plant, getattr(law, "signal", None) or signal
    sigma = ideal_reference.Piecewise(known.times, known.modes)
    A, B, lead = model.A, model.B, model.delay
    if isinstance(law, dt.SingleModePredictor):
        i = law.mode
        return ideal_reference.single(A[i], B[i], lead, law.gains[i])
    if isinstance(law, (dt.AveragedPredictor, dt.MeanPredictor)):
        frozen = (
            ideal_reference.averaged(A, B, lead, law.gains, law.weights)
            if isinstance(law, dt.AveragedPredictor)
            else ideal_reference.single(*law.mean, lead, law.gain)
        )
        if law.dwell_time is None:
            return frozen
        age = known.initial_age
        return ideal_reference.dwelling(A, B, lead, frozen, law.dwell_time, sigma, age)
    if isinstance(law, dt.ExpectedPredictor):
        return ideal_reference.markov(A, B, lead, law.gains, law.model.generator, sigma)
    if isinstance(law, dt.ExactPredictor):
        return ideal_reference.exact(A, B, lead, law.gains, sigma)
    return ideal_reference.delayed(law.gains, sigma)


def reference(law, plant, signal, x0, horizon, u0=None, u0_breaks=(), **options):
    sigma = ideal_reference.Piecewise(signal.times, signal.modes)
    return ideal_reference.solve(
        plant.A,
        plant.B,
        plant.delay,
        sigma,
        belief(law, signal),
        x0,
        horizon,
        u0,
        u0_breaks,
        **options,
    )


def agrees(law, plant, signal, x0, horizon, tolerance=1e-10, u0=None, expected=None, breaks=()):
    """The run and the reference at the run's 1001 points."""
    one = run(law, plant, signal, x0, horizon, u0=u0)
    assert not one.diverged
    other = reference(law, plant, signal, x0, horizon, expected, breaks)
    plants.close(one.states, other.states(one.time), tolerance)
    plants.close(one.inputs, other.inputs(one.time), tolerance)


def same_run(one, other, tolerance, scale=1.0):
    plants.close(one.states, other.states * scale, tolerance)
    plants.close(one.inputs, other.inputs, tolerance)


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


def test_the_reference_does_not_depend_on_its_mesh():
    law = plants.LAWS["averaged"](PAPER)
    coarse = reference(law, PAPER, SWITCHING, [-1.0, 1.0], 5.0)
    fine = reference(law, PAPER, SWITCHING, [-1.0, 1.0], 5.0, nodes=18, longest=0.04)
    t = np.linspace(0.0, 5.0, 501)
    plants.close(coarse.states(t), fine.states(t), 1e-12)
    plants.close(coarse.inputs(t), fine.inputs(t), 1e-12)


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


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_any_off_grid_signal_agrees_with_a_second_discretisation(seed):
    signal = dt.SwitchingSignal.random(2, 12.0, dwell_time=0.05, mean_sojourn=0.5, seed=seed)
    agrees(plants.LAWS["averaged"](PAPER), PAPER, signal, [-1.0, 1.0], 5.0)


@pytest.mark.parametrize("name", plants.IDEAL)
def test_three_modes_agree_with_a_second_discretisation(name):
    agrees(plants.LAWS[name](PLANT), PLANT, SIGNAL, X0, 3.0)


def other_model(delay):
    rng = np.random.default_rng(0)
    A, B = (M + 0.1 * rng.normal(size=M.shape) for M in (PLANT.A, PLANT.B))
    return dt.SwitchedSystem(A, B, delay)


@pytest.mark.parametrize("name", plants.IDEAL)
@pytest.mark.parametrize("delay", [0.234, pytest.param(0.3171, marks=pytest.mark.long), 0.1517])
def test_a_law_with_a_wrong_model_agrees_with_a_second_discretisation(name, delay):
    agrees(plants.LAWS[name](other_model(delay)), PLANT, SIGNAL, X0, 1.5)


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


# -- long runs do not drift --------------------------------------------------------------------

LONG = dt.SwitchingSignal.random(2, 35.0, dwell_time=0.2, mean_sojourn=0.4, seed=3)


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


# -- the digital loop's limit ------------------------------------------------------------------


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


@pytest.mark.parametrize("name", plants.IDEAL)
def test_a_change_of_state_variables_commutes_with_simulation(name):
    T = np.array([[2.0, 0.5, 0.0], [-1.0, 1.0, 0.3], [0.2, 0.0, 0.7]])
    plant, law = plants.in_other_units(name, T, 1.0)
    one, other = run(name), run(law, plant, x0=T @ X0)
    plants.close(other.states, T @ one.states, 1e-11)
    plants.close(other.inputs, one.inputs, 1e-11)


@pytest.mark.parametrize("name", plants.IDEAL)
def test_a_change_of_time_unit_commutes_with_simulation(name):
    c = 60.0
    plant, law = plants.in_other_units(name, np.eye(3), c)
    signal = dt.SwitchingSignal(SIGNAL.times * c, SIGNAL.modes)
    one, other = run(name), run(law, plant, signal, horizon=3.0 * c)
    plants.close(other.time, c * one.time, 1e-15)
    same_run(other, one, 1e-10)


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


# -- histories ---------------------------------------------------------------------------------

HELD = np.random.default_rng(5).normal(size=(2, 3))
D = PLANT.delay
HISTORIES = {
    "constant": ([0.3, -1.2], lambda t: [0.3, -1.2], ()),
    "held": (HELD, lambda t: HELD[:, min(2, int((t + D) / D * 3))], (-D / 3, -2 * D / 3)),
    "smooth": (lambda t: [np.sin(9 * t), np.exp(t)], None, ()),
    "fast": (lambda t: [np.sin(60 * t), np.cos(45 * t)], None, ()),
    "jump": (lambda t: [1.0 if t < -0.1 else -1.0, t], None, (-0.1,)),
    "kink": (lambda t: [abs(t + 0.0777), np.cos(3 * t)], None, (-0.0777,)),
}


@pytest.mark.parametrize("form", HISTORIES)
@pytest.mark.parametrize("name", ["averaged", "exact", "delayed"])
def test_every_form_of_history_agrees_with_a_second_discretisation(form, name):
    u0, function, breaks = HISTORIES[form]
    law = plants.LAWS[name](PLANT)
    agrees(law, PLANT, SIGNAL, X0, 1.0, u0=u0, expected=function or u0, breaks=breaks)


def test_a_history_is_read_over_the_longer_delay():
    law = plants.LAWS["averaged"](other_model(0.3171))
    u0 = HISTORIES["smooth"][0]
    agrees(law, PLANT, SIGNAL, X0, 1.0, u0=u0, expected=u0)


@pytest.mark.parametrize(
    "forms",
    [
        [None, [0.0, 0.0], lambda t: [0.0, 0.0], np.zeros((2, 4))],
        [[0.3, -1.2], lambda t: [0.3, -1.2], np.tile([[0.3], [-1.2]], 3)],
    ],
    ids=["zero", "constant"],
)
def test_every_form_of_the_same_history_gives_the_same_run(forms):
    runs = [run(u0=u0) for u0 in forms]
    for other in runs[1:]:
        same_run(other, runs[0], 1e-12)


def test_a_history_that_is_smooth_nowhere_is_not_searched_for_ever():
    calls = 0

    def u0(t):
        nonlocal calls
        calls += 1
        assert calls < 50_000
        return [float(np.float32(np.sin(3 * t))), 0.0]

    one = run(u0=u0, horizon=1.0)
    plants.close(one.states, run(u0=lambda t: [np.sin(3 * t), 0.0], horizon=1.0).states, 1e-6)


@pytest.mark.parametrize(
    ("u0", "message"),
    [
        (np.nan, "u0[0] must be finite, got nan."),
        ([1.0], "u0 must have shape (m,) = (2,), got (1,)"),
        (np.zeros((3, 4)), "u0 must hold (m, N) = (2, N) samples, got (3, 4)."),
        ([[1.0, np.inf], [0.0, 0.0]], "u0[0, 1] must be finite, got inf."),
        ([[1.0], [0.0, 0.0]], "u0 must be a number, (m,), (m, N) or a function"),
        (lambda t: 1.0, "u0 must have shape (m,) at every time = (2,), got (1,)"),
        (lambda t: [0.0, np.nan], "u0[1] must be finite, got nan."),
        (lambda t: "no", "u0 must"),
    ],
)
def test_a_bad_history_is_refused(u0, message):
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        run(u0=u0)


def test_a_law_without_an_ideal_form_is_refused_by_name():
    class SemiMarkovLaw(dt.AveragedPredictor):
        def ideal(self, signal, horizon):
            raise dt.ArgumentError("SemiMarkovLaw has no ideal form: pass a step.")

    with pytest.raises(dt.ArgumentError, match="SemiMarkovLaw has no ideal form"):
        run(SemiMarkovLaw(PLANT, plants.gains(PLANT)))


# -- what is reported --------------------------------------------------------------------------


def test_at_time_zero_the_input_is_already_the_law_s():
    expected = np.mean(
        [K @ expm(A * PLANT.delay) @ X0 for A, K in zip(PLANT.A, plants.gains(PLANT), strict=True)],
        axis=0,
    )
    plants.close(run().inputs[:, 0], expected, 1e-13)


def test_the_oracle_s_input_jumps_a_delay_before_a_switch():
    K = plants.gains(PLANT)
    for switch, old, new in [(0.3727, 2, 0), (0.8, 0, 1), (1.1234, 1, 2)]:
        at = run("exact", times=[switch - D - 1e-9, switch - D, switch])
        x = at.states[:, 2]
        plants.close(at.inputs[:, 0], K[old] @ x, 1e-7)
        plants.close(at.inputs[:, 1], K[new] @ x, 1e-12)


def test_delayed_feedback_jumps_at_a_switch():
    K = plants.gains(PLANT)
    for switch, old, new in [(0.3727, 2, 0), (0.8, 0, 1), (1.1234, 1, 2)]:
        at = run("delayed", times=[switch - 1e-9, switch])
        plants.close(at.inputs[:, 0], K[old] @ at.states[:, 0], 1e-12)
        plants.close(at.inputs[:, 1], K[new] @ at.states[:, 1], 1e-12)
        assert at.mode.tolist() == [old, new]


def test_switches_at_reported_instants_are_right_limits():
    # Switches, and switches less the delay, fall on multiples of 0.01, up to round-off.
    switches = [0.0, 0.3, 0.7, 1.1, 1.3, 2.3, 2.9]
    signal = dt.SwitchingSignal(switches, [0, 1, 0, 1, 0, 1, 0])
    for times in (np.arange(301) * 0.01, np.linspace(0.0, 3.0, 301), np.cumsum([0.01] * 299)):
        one = run("exact", PAPER, signal, [-1.0, 1.0], 3.0, times=times)
        assert np.abs(one.mismatch).max() <= 1e-11 * np.abs(one.inputs).max()
        other = run("delayed", PAPER, signal, [-1.0, 1.0], 3.0, times=times)
        u = np.einsum("kij,jk->ik", plants.gains(PAPER)[signal(times + 1e-9)], other.states)
        plants.close(other.inputs, u, 1e-12)
        assert np.array_equal(other.mode, signal(times + 1e-9))


def test_an_ideal_run_reports_1001_uniform_points_unless_asked_for_others():
    one = run()
    assert np.array_equal(one.time, np.linspace(0.0, 3.0, 1001))
    assert np.array_equal(one.mode, SIGNAL(one.time))
    some = run(times=one.time[[0, 17, 500, 1000]])
    plants.close(some.states, one.states[:, [0, 17, 500, 1000]], 1e-14)
    plants.close(some.inputs, one.inputs[:, [0, 17, 500, 1000]], 1e-14)


@pytest.mark.parametrize("name", ["averaged", "exact", "delayed"])
def test_the_cost_is_the_integral_of_the_reference(name):
    law = plants.LAWS[name](PLANT)
    other = reference(law, PLANT, SIGNAL, X0, 3.0)
    edges = other.edges[(other.edges >= 0.0) & (other.edges <= 3.0 + 1e-9)]
    ise, energy = (
        sum(
            fixed_quad(lambda t, f=f: np.sum(f(t) ** 2, axis=0), a, b, n=20)[0]
            for a, b in pairwise(edges)
        )
        for f in (other.states, other.inputs)
    )
    metrics = run(law).metrics()
    assert metrics["ise"] == pytest.approx(ise, rel=1e-11)
    assert metrics["energy"] == pytest.approx(energy, rel=1e-11)
    assert metrics["cost"] == metrics["ise"] + metrics["energy"]


def test_a_signal_that_ends_early_is_continued_and_the_message_says_so():
    short = dt.SwitchingSignal([0.0, 0.3], [0, 1], end=0.5)
    one = run(signal=short)
    assert one.message == "the signal ends at 0.5 s and was continued in mode 1."
    same_run(one, run(signal=dt.SwitchingSignal([0.0, 0.3], [0, 1])), 1e-14)


@pytest.mark.parametrize("horizon", [150.0, 1000.0])
def test_a_run_that_diverges_ends_with_a_message(horizon):
    one = run("delayed", PAPER, CONSTANT, [-1.0, 1.0], horizon)
    assert one.diverged
    assert re.fullmatch(r"diverged: \|x\| left 1e100 after t = 116\.\d+ s.*", one.message)
    assert one.end == one.time[-1] < 117.0
    assert 1e98 < np.abs(one.states[:, -1]).max() <= 1e100
    for values in (one.states, one.inputs):
        assert np.isfinite(values).all()
    assert not np.isnan(one.mismatch).any()
    assert all(not np.isnan(value) for value in one.metrics().values())
    before = run("delayed", PAPER, CONSTANT, [-1.0, 1.0], 100.0)
    assert not before.diverged
    again = run("delayed", PAPER, CONSTANT, [-1.0, 1.0], horizon, times=before.time)
    plants.close(again.states, before.states, 1e-11)
