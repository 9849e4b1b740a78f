"""Plants whose mode is a function of their state, and the law that runs the rule forward."""

import re
from itertools import pairwise

import numpy as np
import pytest

import deadtime as dt
import plants
import rule_reference as second
from deadtime.feedback.law import TableLaw
from deadtime.laws import StateDependentPredictor
from deadtime.switching import FunctionRule, HalfSpace, Polyhedra

H = 0.1


def swinging(delay=0.234, seed=3):
    """Three modes that swing alike, so that trajectories cross boundaries and few chatter.

    Three states, two inputs; D = 0.234 gives N = 3 and φ = 0.034.
    """
    rng = np.random.default_rng(seed)
    A = [[0.1, 2.0, 0.3], [-2.0, 0.1, 0.0], [0.2, 0.0, -0.3]]
    B = [[0.0, 0.2], [1.0, 0.0], [0.1, 1.0]]
    size = 0.08
    return dt.SwitchedSystem(
        A + size * rng.normal(size=(3, 3, 3)), B + size * rng.normal(size=(3, 3, 2)), delay
    )


SOFT = (-0.02 + 2.0j, -0.02 - 2.0j, -0.7)


def soft(plant):
    """Gains that let the plant go on swinging."""
    return dt.place(plant, SOFT)


PLANT = swinging()
X0 = np.array([1.0, -0.5, 0.8])
HISTORY = np.random.default_rng(5).normal(size=(2, 3))

# Three modes: a half-space, and the other half cut in two.
NORMALS = np.array([[1.0, 0.2, -0.3], [-0.4, 1.0, 0.1]])
OFFSETS = np.array([0.1, -0.05])
WEDGE = Polyhedra(
    [
        (NORMALS[:1], OFFSETS[:1]),
        (np.stack((-NORMALS[0], NORMALS[1])), [-OFFSETS[0], OFFSETS[1]]),
        (np.stack((-NORMALS[0], -NORMALS[1])), [-OFFSETS[0], -OFFSETS[1]]),
    ]
)


def wedge(x):
    """The same rule as a function."""
    if NORMALS[0] @ x <= OFFSETS[0]:
        return 0
    return 1 if NORMALS[1] @ x <= OFFSETS[1] else 2


def ball(x):
    """A rule with a curved boundary."""
    return 0 if x[0] ** 2 + 2.0 * x[1] ** 2 < 0.5 else 1 + int(x[1] > 0.0)


RULES = {"wedge": WEDGE, "wedge as a function": wedge, "ball": ball}
BOUNDARIES = {
    "wedge": [lambda x: NORMALS[0] @ x - OFFSETS[0], lambda x: NORMALS[1] @ x - OFFSETS[1]],
    "ball": [lambda x: x[0] ** 2 + 2.0 * x[1] ** 2 - 0.5, lambda x: x[1]],
}
BOUNDARIES["wedge as a function"] = BOUNDARIES["wedge"]


def predictor(plant=PLANT, rule=WEDGE):
    return StateDependentPredictor(plant, soft(plant), rule)


def run(law, rule=WEDGE, plant=PLANT, x0=X0, horizon=3.0, u0=HISTORY, step=H, times=None):
    return dt.simulate(plant, law, rule, x0, horizon, step=step, u0=u0, times=times)


# -- closed forms ------------------------------------------------------------------------------


def passing(a, b, start, target, u):
    """When x' = a x + b u reaches `target` from `start`."""
    rest = -b * u / a
    return np.log((target - rest) / (start - rest)) / a


def test_crossings_of_a_scalar_plant_are_at_their_closed_form_to_1e_12():
    a, b, u = np.array([0.7, -0.4, 0.3]), np.array([1.0, 2.0, 0.5]), 1.5
    plant = plants.scalar(a, b, delay=2.0)
    law = dt.DelayedStateFeedback(plant, np.zeros((3, 1, 1)), allow_unstable=True)
    first = passing(a[0], b[0], 0.1, 1.0, u)
    switches = [first, first + passing(a[1], b[1], 1.0, 2.0, u)]
    intervals = Polyhedra([([[1.0]], [1.0]), ([[-1.0], [1.0]], [-1.0, 2.0]), ([[-1.0]], [-2.0])])
    for rule in (intervals, lambda x: int(x[0] > 1.0) + int(x[0] > 2.0)):
        for step in (0.01, 0.37, 1.0):
            one = run(law, rule, plant, [0.1], 1.5, u, step)
            assert one.signal.modes.tolist() == [0, 1, 2]
            assert np.abs(one.signal.times[1:] - switches).max() <= 1e-12
            later = -b[2] * u / a[2] + (2.0 + b[2] * u / a[2]) * np.exp(a[2] * (1.5 - switches[1]))
            assert one.states[0, -1] == pytest.approx(later, rel=1e-12)


ROTATION = np.array([[0.0, 1.0], [-1.0, 0.0]])


def rotating(speeds, delay=0.5):
    """x = R(cos θ, −sin θ), θ' the speed of the mode; no input reaches it."""
    A = np.array([w * ROTATION for w in speeds])
    return dt.SwitchedSystem(A, np.zeros((len(speeds), 2, 1)), delay)


def idle(plant):
    return dt.DelayedStateFeedback(plant, np.zeros((plant.modes, 1, 2)), allow_unstable=True)


@pytest.mark.parametrize("step", [0.05, 0.3, 3.0])
def test_a_rotation_switches_speed_at_its_closed_form_for_many_turns(step):
    # Mode 1 where x₁ ≥ 0: half a turn takes π/w of the half's speed.
    plant = rotating([1.0, 1.7])
    one = run(idle(plant), HalfSpace([1.0, 0.0]), plant, [1.0, 0.0], 60.0, None, step)
    quarter, halves = 0.5 * np.pi / 1.7, np.array([np.pi / 1.0, np.pi / 1.7])
    count = one.signal.switches
    expected = quarter + np.concatenate(([0.0], np.cumsum(np.resize(halves, count - 1))))
    assert count > 20
    assert np.abs(one.signal.times[1:] - expected).max() <= 1e-12
    assert expected[-1] + halves[(count - 1) % 2] > 60.0


@pytest.mark.parametrize("width", [1e-2, 1e-4, 1e-6])
def test_a_slab_entered_and_left_within_one_step_is_found(width):
    # cos θ > cos(width) only for |θ| < width; the step is 0.4 and θ passes 0 in the middle of one.
    plant = rotating([1.0, 1.0])
    edge = np.cos(width)
    angle = -0.61
    x0 = [np.cos(angle), -np.sin(angle)]
    one = run(idle(plant), HalfSpace([1.0, 0.0], edge), plant, x0, 2.0, None, 0.4)
    # The edge itself is rounded: its angle is good to 1e-16/width.
    assert one.signal.modes.tolist() == [0, 1, 0]
    assert np.abs(one.signal.times[1:] - [0.61 - width, 0.61 + width]).max() <= 1e-15 / width
    missed = FunctionRule(lambda x: int(x[0] >= edge), samples=4)
    assert run(idle(plant), missed, plant, x0, 2.0, None, 0.4).signal.switches == 0


def test_more_samples_find_what_few_samples_of_a_function_miss():
    plant, edge = rotating([1.0, 1.0]), np.cos(0.01)
    x0 = [np.cos(-0.61), -np.sin(-0.61)]
    fine = FunctionRule(lambda x: int(x[0] >= edge), samples=50)
    assert run(idle(plant), fine, plant, x0, 2.0, None, 0.4).signal.switches == 2


# -- a second method ---------------------------------------------------------------------------


@pytest.mark.parametrize("model_delay", [0.234, 0.31, 0.1])
@pytest.mark.parametrize("name", RULES)
def test_the_loop_equals_an_integration_with_event_detection(name, model_delay):
    truth, model = swinging(), swinging(model_delay, seed=4)
    gains = soft(model)
    law = StateDependentPredictor(model, gains, RULES[name])
    history = np.random.default_rng(8).normal(size=(2, 4 if model_delay == 0.31 else 3))
    one = run(law, RULES[name], truth, u0=history, horizon=2.5)

    rule = RULES[name] if callable(RULES[name]) else RULES[name].__call__
    pair = [second.Plant(p.A, p.B, p.delay, rule, BOUNDARIES[name]) for p in (truth, model)]
    control = second.predictor(pair[1], gains, H)
    states, inputs, switches = second.run(pair[0], control, X0, history.T, H, 26)
    plants.close(one.states.T, states, 1e-11)
    plants.close(one.inputs.T, inputs, 1e-11)
    found = one.signal.times[1:] <= 2.5
    assert len(switches) >= 1
    expected = np.array([time for time, _ in switches if time <= 2.5])
    assert np.abs(one.signal.times[1:][found] - expected).max() <= 1e-11


def test_a_law_with_a_rule_on_a_plant_along_a_signal_equals_that_integration():
    signal = plants.off_grid()
    law = predictor()
    one = run(law, signal, horizon=1.2)
    model = second.Plant(PLANT.A, PLANT.B, PLANT.delay, wedge, BOUNDARIES["wedge"])
    control = second.predictor(model, soft(PLANT), H)
    update = law.online(H)
    pipe = list(HISTORY.T)
    for k, x in enumerate(one.states.T):
        u = control(x, pipe)
        plants.close(one.inputs[:, k], u, 1e-9)
        plants.close(update(x, np.array(pipe), 0, 0), u, 1e-9)
        pipe.append(one.inputs[:, k])
    # The plant follows the signal: the same inputs under a law that is a table of nothing.
    times = np.linspace(0.0, 1.2, 37)
    fine = run(law, signal, horizon=1.2, times=times)
    for i in range(36):
        a, b = times[i], times[i + 1]
        cuts = np.concatenate((signal.times, np.arange(15) * H + PLANT.delay - 0.3))
        cuts = [a, *np.sort(cuts[(cuts > a + 1e-12) & (cuts < b - 1e-12)]), b]
        x = fine.states[:, i]
        for low, high in pairwise(cuts):
            middle = 0.5 * (low + high)
            mode, held = int(signal([middle])[0]), int(np.floor((middle - 0.234) / H)) + 3
            Phi, Gamma = plants.held(PLANT.A[mode], PLANT.B[mode], high - low)
            x = Phi @ x + Gamma @ pipe[held]
        plants.close(fine.states[:, i + 1], x, 1e-11)


# -- exact predictor feedback ------------------------------------------------------------------


@pytest.mark.parametrize("delay", [0.234, 0.3, 0.04])
@pytest.mark.parametrize("name", RULES)
def test_a_law_with_the_right_model_and_rule_leaves_no_mismatch(name, delay):
    plant = swinging(delay)
    history = HISTORY[:, : plants.LAWS["mean"](plant).window(H).count]
    for x0 in (X0, -2.0 * X0, [0.2, 0.9, -0.4]):
        one = run(predictor(plant, RULES[name]), RULES[name], plant, x0, 4.03, history)
        assert one.signal.switches >= 2
        # The last instant is no sample: there the input is held over.
        assert np.abs(one.mismatch[:, :-1]).max() <= 1e-13 * np.abs(one.inputs).max()


def test_the_paper_s_plant_under_a_rule_is_stabilised_without_a_mismatch():
    problem = dt.problems.paper()
    rule = HalfSpace([1.0, 1.0], 0.5)
    law = StateDependentPredictor(problem.plant, problem.gains, rule)
    one = dt.simulate(problem.plant, law, rule, [-1.0, 1.0], 15.0)
    assert one.metrics()["final_norm"] < 1e-4
    assert np.abs(one.mismatch).max() <= 1e-13 * np.abs(one.inputs).max()
    blind = dt.simulate(problem.plant, idle(problem.plant), rule, [-1.0, 1.0], 15.0)
    assert blind.metrics()["final_norm"] > 1e6


def test_the_loop_shifted_by_the_delay_is_the_loop_without_one():
    # z = x(t_k + D) moves under K_r(z) z held over each period; an independent integration.
    gains = soft(PLANT)
    samples = np.arange(21) * H
    shifted = run(predictor(), horizon=2.5, times=samples + PLANT.delay, u0=None)
    free = second.Plant(PLANT.A, PLANT.B, H, wedge, BOUNDARIES["wedge"])
    z = shifted.states[:, 0]
    for k in range(20):
        z, _ = free.flow(z, gains[wedge(z)] @ z, H)
        plants.close(shifted.states[:, k + 1], z, 1e-9)


@pytest.mark.parametrize("rising", [True, False])
@pytest.mark.parametrize("delay", [0.25, 0.375, 0.0625])
def test_a_crossing_exactly_a_delay_ahead_counts(rising, delay):
    # An integrator, all numbers binary fractions: x(D) = 1 exactly, crossing as it arrives.
    step, sign = 0.125, 1.0 if rising else -1.0
    plant = plants.scalar([0.0, 0.0], delay=delay)
    gains = np.array([[[-1.0]], [[-3.0]]])
    law = StateDependentPredictor(plant, gains, HalfSpace([1.0], 1.0))
    history = np.full((1, int(np.ceil(delay / step))), sign)
    one = run(law, HalfSpace([1.0], 1.0), plant, [1.0 - sign * delay], 1.0, history, step)
    assert one.inputs[0, 0] == gains[int(rising), 0, 0]
    # Only a rising state goes on into mode 1 or stays there; a falling one is pushed on, too.
    update = law.online(step)
    for nudge in (-1e-14, 0.0, 1e-14):
        u = update(np.array([1.0 - sign * delay + nudge]), history.T, 0, 0)
        assert u[0] == pytest.approx(gains[int(rising), 0, 0], rel=1e-12)


# -- relations between runs --------------------------------------------------------------------

TABLES = [name for name in plants.LAWS if name != "exact"]
NEVER = HalfSpace([1.0, 0.0, 0.0], 1e6), lambda x: 0


@pytest.mark.parametrize("name", TABLES)
def test_a_rule_that_never_switches_gives_the_run_along_a_constant_signal(name):
    law = plants.LAWS[name](PLANT)
    assert isinstance(law, TableLaw)
    constant = run(law, dt.SwitchingSignal.constant(0))
    for rule in NEVER:
        one = run(law, rule)
        assert one.signal.switches == 0
        plants.close(one.states, constant.states, 1e-12)
        plants.close(one.inputs, constant.inputs, 1e-12)
        if one.mismatch is not None:
            plants.close(one.mismatch, constant.mismatch, 1e-12, np.abs(one.inputs).max())
        for key, value in constant.metrics().items():
            assert one.metrics()[key] == pytest.approx(value, rel=1e-9)


@pytest.mark.parametrize("name", TABLES)
@pytest.mark.parametrize("model_delay", [0.234, 0.31])
def test_a_run_under_a_rule_is_the_run_along_the_signal_that_it_turned_out_to_be(
    name, model_delay, monkeypatch
):
    monkeypatch.setattr(plants, "POLES", SOFT)
    law = plants.LAWS[name](swinging(model_delay))
    history = np.hstack((HISTORY, HISTORY[:, :1]))[:, : 4 if model_delay == 0.31 else 3]
    for rule in (WEDGE, ball):
        one = run(law, rule, horizon=2.97, u0=history)
        other = run(law, one.signal, horizon=2.97, u0=history)
        assert one.signal.switches >= 2
        assert np.array_equal(one.mode, other.mode)
        plants.close(one.states, other.states, 1e-10)
        plants.close(one.inputs, other.inputs, 1e-10)
        if one.mismatch is not None:
            plants.close(one.mismatch, other.mismatch, 1e-10, np.abs(one.inputs).max())
        for key, value in other.metrics().items():
            assert one.metrics()[key] == pytest.approx(value, rel=1e-8)


def test_a_rule_and_its_signal_are_the_same_truth_for_the_law_that_runs_a_rule():
    one = run(predictor())
    other = run(predictor(), one.signal)
    plants.close(other.states, one.states, 1e-10)
    plants.close(other.mismatch, one.mismatch, 1e-10, np.abs(one.inputs).max())
    assert one.signal.end >= 3.0 + PLANT.delay


def test_a_function_and_polyhedra_that_say_the_same_give_the_same_run():
    one, other = run(predictor()), run(predictor(rule=wedge), wedge)
    plants.close(other.states, one.states, 1e-12)
    assert np.array_equal(one.signal.modes, other.signal.modes)
    plants.close(other.signal.times, one.signal.times, 1e-13)


def test_the_rule_of_the_law_may_be_wrong():
    wrong = HalfSpace([1.0, 0.0, 0.0])
    one = run(predictor(rule=wrong), WEDGE)
    assert np.abs(one.mismatch).max() > 0.01 * np.abs(one.inputs).max()


def test_other_units_of_the_states_change_nothing():
    unit = np.array([1e-6, 1.0, 1e5])
    plant = dt.SwitchedSystem(PLANT.A * unit[:, None] / unit, PLANT.B * unit[:, None], PLANT.delay)
    rule = Polyhedra(
        [(H_ / unit, h) for H_, h in (
            (NORMALS[:1], OFFSETS[:1]),
            (np.stack((-NORMALS[0], NORMALS[1])), [-OFFSETS[0], OFFSETS[1]]),
            (np.stack((-NORMALS[0], -NORMALS[1])), [-OFFSETS[0], -OFFSETS[1]]),
        )]
    )  # fmt: skip
    law = StateDependentPredictor(plant, soft(PLANT) / unit, rule)
    one, other = run(predictor()), run(law, rule, plant, X0 * unit)
    plants.close(other.states / unit[:, None], one.states, 1e-10)
    plants.close(other.signal.times, one.signal.times, 1e-11)


@pytest.mark.parametrize("first", [0.2, 0.8, 1.5])
def test_splitting_the_horizon_changes_nothing(first):
    whole, start = run(predictor()), run(predictor(), horizon=first)
    rest = run(predictor(), x0=start.states[:, -1], horizon=3.0 - first, u0=start.history)
    cut = start.time.size - 1
    plants.close(np.hstack([start.states[:, :-1], rest.states]), whole.states, 1e-11)
    assert np.array_equal(rest.mode, whole.mode[cut:])


def test_between_samples_the_state_follows_the_plant_through_its_crossings():
    one = run(predictor())
    times = np.sort(np.concatenate((np.linspace(0.0, 2.9, 30), one.signal.times[1:-1])))
    times = times[times <= 2.9]
    fine = run(predictor(), times=times)
    at_crossings = fine.states[:, np.isin(times, one.signal.times[1:])]
    distance = np.abs(NORMALS @ at_crossings - OFFSETS[:, None]).min(axis=0)
    assert distance.size >= 2
    assert distance.max() <= 1e-11
    assert [WEDGE(x) for x in run(predictor(), times=times + 1e-6).states.T] == [
        int(mode) for mode in run(predictor(), times=times + 1e-6).mode
    ]


# -- where runs begin and end ------------------------------------------------------------------


def test_a_start_on_a_boundary_takes_the_mode_that_the_plant_goes_on_in():
    for start, u, mode in [(1.0, 1.0, 1), (1.0, -1.0, 0)]:
        plant = plants.scalar([0.0, 0.0])
        one = run(idle_scalar(plant), HalfSpace([1.0], 1.0), plant, [start], 0.2, u, 0.1)
        assert one.mode.tolist() == [mode] * 3
        assert one.signal.switches == 0


def idle_scalar(plant):
    return dt.DelayedStateFeedback(plant, np.zeros((plant.modes, 1, 1)), allow_unstable=True)


def test_a_state_at_rest_on_a_boundary_stays():
    one = run(
        predictor(rule=HalfSpace([1.0, 0, 0])), HalfSpace([1.0, 0, 0]), x0=np.zeros(3), u0=None
    )
    assert not one.states.any()
    assert (one.signal.switches, one.message) == (0, "")


def test_a_run_that_diverges_under_a_rule_ends_and_says_so():
    plant = plants.scalar([50.0, 60.0])
    law = dt.DelayedStateFeedback(plant, [[[0.1]], [[0.1]]], allow_unstable=True)
    for rule in (HalfSpace([1.0], 5.0), lambda x: int(x[0] ** 8 > 5.0)):
        one = run(law, rule, plant, [1.0], 100.0, None)
        assert one.diverged
        assert (
            one.message == f"diverged: |x| left 1e100 after t = {one.end:g} s, where the run ends."
        )
        assert 3.0 < one.end < 5.0
        assert one.signal.switches == 1


# -- chattering --------------------------------------------------------------------------------


def pushing(towards=True, delay=0.25):
    """x₁' = ∓x₂ in modes 0 and 1 with x₂ = 1 for ever: towards x₁ = 0 from both sides, or away."""
    up = 1.0 if towards else -1.0
    A = np.array([[[0.0, up], [0.0, 0.0]], [[0.0, -up], [0.0, 0.0]]])
    return dt.SwitchedSystem(A, [[[0.0], [0.0]], [[0.0], [0.0]]], delay)


SIGN = HalfSpace([1.0, 0.0])
FACING = (
    "both vector fields point at the boundary between modes 0 and 1, and a function does not say "
    "how to slide along it: use HalfSpace, Polyhedra or QuadraticRegions"
)


def sign(x):
    """The same half-space, along whose boundary nothing can slide."""
    return int(x[0] >= 0.0)


@pytest.mark.parametrize("start", [-0.537, 0.537, -0.5])
def test_a_plant_that_chatters_ends_the_run_and_says_when_and_why(start):
    plant = pushing()
    one = run(idle(plant), sign, plant, [start, 1.0], 2.0, None)
    assert one.message == f"chattering at t = {abs(start):.12g} s: {FACING}; the run ends there."
    assert not one.diverged
    assert [one.end, one.time[-1]] == pytest.approx([abs(start)] * 2, abs=1e-12)
    assert one.states[0, -1] == pytest.approx(0.0, abs=1e-12)
    metrics = one.metrics()
    assert metrics["ise"] == pytest.approx(abs(start) ** 3 / 3.0 + abs(start), rel=1e-12)
    assert metrics["final_norm"] == pytest.approx(1.0, rel=1e-12)
    assert np.isfinite(one.mismatch).all()
    assert one.signal.end == pytest.approx(abs(start), abs=1e-12)
    one.to_pandas()
    one.plot()


def test_a_plant_that_chatters_from_the_start_has_a_run_of_one_sample():
    plant = pushing()
    one = run(idle(plant), sign, plant, [0.0, 1.0], 2.0, None)
    assert one.message.startswith("chattering at t = 0 s: both vector fields point at the boundary")
    assert one.time.tolist() == [0.0]
    assert one.metrics()["ise"] == 0.0
    one.plot()


def test_a_boundary_that_both_fields_leave_is_no_chattering():
    plant = pushing(towards=False)
    one = run(idle(plant), SIGN, plant, [0.0, 1.0], 2.0, None)
    assert one.message == ""
    assert one.states[0, -1] == pytest.approx(2.0)
    assert one.mode.tolist() == [1] * 21


@pytest.mark.parametrize("horizon", [0.4, 0.51])
def test_chattering_past_the_end_is_told_and_concerns_the_mismatch_alone(horizon):
    plant = pushing(delay=0.25)
    one = run(idle(plant), sign, plant, [-0.53, 1.0], horizon, None)
    assert one.end == one.time[-1] == horizon
    assert one.message == (
        f"chattering at t = 0.53 s: {FACING}; from there on the mismatch takes mode 0 to last."
    )


def test_a_prediction_that_chatters_ends_the_run_and_says_so():
    model, truth = pushing(delay=0.25), pushing(towards=False, delay=0.25)
    law = StateDependentPredictor(model, np.zeros((2, 1, 2)), sign, allow_unstable=True)
    one = run(law, dt.SwitchingSignal.constant(1), truth, [-0.537, 1.0], 2.0, [3.0])
    # x₁ = −0.537 + t: the boundary is within 0.25 s at the sample 0.3.
    assert one.message == (
        f"chattering in the prediction of StateDependentPredictor, 0.237 s ahead: {FACING}. The "
        "run ends at t = 0.3 s, its last input held over."
    )
    assert [one.end, one.time[-1]] == pytest.approx([0.3, 0.3])
    assert one.inputs[0, -1] == one.inputs[0, -2]
    assert not one.diverged
    assert one.metrics()["final_norm"] == pytest.approx(np.hypot(0.237, 1.0))
    with pytest.raises(dt.ChatteringError, match=r"0\.237 s ahead"):
        law.online(H)(np.array([-0.237, 1.0]), np.zeros((3, 1)), 0, 0)


def test_too_many_crossings_within_a_piece_are_chattering():
    edges = np.linspace(0.0, 1.0, 80)
    slabs = [([[1.0, 0.0]], [0.0])]
    slabs += [([[-1.0, 0.0], [1.0, 0.0]], [-a, b]) for a, b in pairwise(edges)]
    slabs += [([[-1.0, 0.0]], [-1.0])]
    rule = Polyhedra(slabs, modes=[i % 2 for i in range(81)])
    plant = pushing()
    plant = dt.SwitchedSystem(np.abs(plant.A), plant.B, plant.delay)
    function = FunctionRule(lambda x: int(np.clip(np.ceil(79.0 * x[0]), 0, 80)) % 2, samples=200)
    for same in (rule, function):
        one = run(idle(plant), same, plant, [-0.35, 1.0], 2.0, None, step=1.0)
        assert re.match(
            r"chattering at t = 0\.9\d* s: more than 50 boundaries are crossed within 0.75 s; if "
            "they are meant to be, shorten the step; the run ends there.",
            one.message,
        )
        assert run(idle(plant), same, plant, [-0.35, 1.0], 2.0, None, 0.1).message == ""


@pytest.mark.parametrize("step", [1.0, 0.1])
def test_many_crossings_of_a_fast_plant_within_a_step_are_no_chattering(step):
    plant = rotating([300.0, 300.0], delay=0.25)
    one = run(idle(plant), SIGN, plant, [1.0, 0.3], 3.0, None, step)
    turns = 300.0 * (one.signal.times[1:] - one.signal.times[1]) / np.pi
    assert one.message == ""
    assert one.signal.switches > 280
    assert np.abs(turns - np.arange(turns.size)).max() <= 1e-9


def test_a_rule_that_keeps_changing_its_mind_does_not_hang():
    calls = iter(range(10**9))
    plant = pushing(towards=False)
    one = run(idle(plant), lambda x: next(calls) % 2, plant, [1.0, 1.0], 2.0, None)
    assert one.end <= 2.0


@pytest.mark.parametrize("speed", [1e-4, 1e-8, 1e-12])
@pytest.mark.parametrize(
    ("rule", "message"),
    [
        (SIGN, "slid along the boundary between modes 0 and 1, once, for 1.463 s in all, first at "
               "t = 0.537 s."),
        (sign, f"chattering at t = 0.537 s: {FACING}"),
    ],
    ids=["half-space", "function"],
)  # fmt: skip
def test_a_boundary_that_both_fields_point_at_is_found_however_slow_they_are(rule, message, speed):
    plant = dt.SwitchedSystem(
        [[[0.0, speed], [0.0, 0.0]], [[0.0, -2.0 * speed], [0.0, 0.0]]], np.zeros((2, 2, 1)), 0.25
    )
    one = run(idle(plant), rule, plant, [-0.537 * speed, 1.0], 2.0, None)
    assert one.message.startswith(message)
    assert one.signal.switches == 0


@pytest.mark.parametrize("start", [-0.7, -0.9, -0.3 + 1e-12, -0.3 - 1e-12, 0.3])
@pytest.mark.parametrize("delay", [0.25, 0.1])
def test_chattering_within_round_off_of_a_sample_ends_the_run_at_that_sample(start, delay):
    plant = pushing(delay=delay)
    one = run(idle(plant), sign, plant, [start, 1.0], 2.0, None)
    samples = round(abs(start) / H)
    assert one.end == one.time[-1] == samples * H
    assert one.time.size == one.inputs.shape[1] == samples + 1
    assert one.message == f"chattering at t = {samples * H:.12g} s: {FACING}; the run ends there."


@pytest.mark.parametrize("towards", [True, False], ids=["chattering", "diverging"])
def test_times_past_an_early_end_are_dropped(towards):
    plant = pushing() if towards else plants.scalar([500.0, 500.0])
    x0 = [-0.35, 1.0] if towards else [1.0]
    law = idle(plant) if towards else idle_scalar(plant)
    rule = sign if towards else HalfSpace([1.0])
    some = run(law, rule, plant, x0, 2.0, None, times=[0.0, 0.2, 1.5])
    assert some.time.tolist() == [0.0, 0.2]
    none = run(law, rule, plant, x0, 2.0, None, times=[1.5, 1.9])
    assert none.time.size == none.states.size == none.mode.size == 0
    assert none.metrics() == some.metrics()
    assert repr(none).endswith("samples=0, ended early)" if towards else "samples=0, diverged)")
    none.plot()


# -- round-off at a boundary -------------------------------------------------------------------


def nodes(seed, alike):
    """Two stable modes that share the eigenvector v of their slowest motion; v, and v's normal."""
    rng = np.random.default_rng(seed)
    V = rng.normal(size=(2, 2))
    fast = rng.uniform(2.0, 5.0, size=2)
    A = [V @ np.diag([-0.5, -fast[0 if alike else i]]) @ np.linalg.inv(V) for i in range(2)]
    v = V[:, 0]
    return dt.SwitchedSystem(A, [[[0.0], [1.0]]] * 2, 0.25), V, np.array([-v[1], v[0]])


@pytest.mark.parametrize("alike", [True, False], ids=["one mode twice", "two modes"])
@pytest.mark.parametrize(
    "as_function",
    [pytest.param(False, marks=pytest.mark.long), True],
    ids=["half-space", "function"],
)
def test_a_plant_that_moves_along_a_boundary_does_not_chatter(alike, as_function):
    for seed in range(10 if as_function else 30):
        plant, V, normal = nodes(seed, alike)
        rule = (lambda x, n=normal: int(n @ x >= 0.0)) if as_function else HalfSpace(normal)
        for x0 in (V[:, 0], V[:, 0] + 0.3 * V[:, 1]):
            one = run(idle(plant), rule, plant, x0, 30.0, None)
            assert (one.message, one.end) == ("", 30.0), seed
            assert one.signal.switches <= 1
            # Along the boundary the modes agree.
            late = np.linalg.norm(one.states[:, 250:], axis=0)
            plants.close(late, np.exp(-0.5 * one.time[250:]) * np.linalg.norm(V[:, 0]), 1e-9)


def test_a_law_predicts_along_a_boundary():
    for seed in range(8):
        plant, V, normal = nodes(seed, True)
        gains = dt.place(plant, [-1.5, -2.0])
        free = run(dt.MeanPredictor(plant, gains[0], gains), dt.SwitchingSignal.constant(0), plant,
                   V[:, 0], 20.0, None)  # fmt: skip
        for rule in (HalfSpace(normal), lambda x, n=normal: int(n @ x >= 0.0)):
            law = StateDependentPredictor(plant, gains, rule)
            one = run(law, rule, plant, V[:, 0], 20.0, None)
            assert one.message == ""
            plants.close(one.states, free.states, 1e-10)


def test_a_plant_that_comes_to_rest_on_an_offset_boundary_does_not_slide():
    """Nodes, affine by a third state that is 1; far from rest they may truly slide."""
    rng = np.random.default_rng(3)
    rested = 0
    for _ in range(40):
        normal, rest = rng.normal(size=(2, 2))
        A = np.zeros((2, 3, 3))
        for i in range(2):
            V = rng.normal(size=(2, 2))
            A[i, :2, :2] = V @ np.diag(-rng.uniform(0.5, 3.0, size=2)) @ np.linalg.inv(V)
            A[i, :2, 2] = -A[i, :2, :2] @ rest
        plant = dt.SwitchedSystem(A, np.zeros((2, 3, 1)), 0.25)
        law = dt.DelayedStateFeedback(plant, np.zeros((2, 1, 3)), allow_unstable=True)
        rule = HalfSpace([*normal, 0.0], float(normal @ rest))
        one = run(law, rule, plant, [*(rest + rng.normal(size=2)), 1.0], 120.0, None, 0.2)
        away = one.states[:2, -1] - rest
        if one.message:
            # Both fields do point at the boundary, far beyond round-off.
            begin = one.record.slides.slides(0.2, 120.0)[0].begin
            away = one.record.states_at(np.array([begin]))[0, :2] - rest
            slopes = normal @ (A[:, :2, :2] @ away).T
            assert np.linalg.norm(away) > 1e-7
            assert slopes[0] > 1e-7
            assert slopes[1] < -1e-7
        else:
            rested += 1
            assert np.linalg.norm(away) < 1e-9
        assert one.signal.switches < 10
    assert rested > 25


CORNERS = {
    "quadrants": [np.diag(s) for s in ([-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0])],
    "junction": [np.array([[1.0, 0.0]]), np.diag([-1.0, -1.0]), np.diag([-1.0, 1.0])],
}


@pytest.mark.parametrize("corner", CORNERS)
def test_a_plant_that_passes_through_a_corner_goes_on_in_the_region_beyond(corner):
    rng = np.random.default_rng(5)
    for _ in range(100):
        angle, at, v = rng.uniform(0.0, 6.28), 10.0 * rng.normal(size=2), rng.normal(size=2)
        R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        rows = [np.column_stack((H @ R.T, np.zeros(len(H)))) for H in CORNERS[corner]]
        rule = Polyhedra([(H, H[:, :2] @ at) for H in rows])
        A = np.zeros((len(rows), 3, 3))
        A[:, :2, 2] = v * (1.0 + 0.1 * np.arange(len(rows))[:, None])
        plant = dt.SwitchedSystem(A, np.zeros((len(rows), 3, 1)), 0.25)
        law = dt.DelayedStateFeedback(plant, np.zeros((len(rows), 1, 3)), allow_unstable=True)
        x0 = [*(at - v * rng.uniform(0.2, 0.9)), 1.0]
        one = run(law, rule, plant, x0, 2.0, None)
        assert one.message == ""
        assert one.signal.modes[-1] == rule([*(at + 0.3 * v), 1.0])


# -- what is refused ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: run(dt.ExactPredictor(PLANT, plants.gains(PLANT))),
            "where a rule switches the plant by its state, use StateDependentPredictor.",
        ),
        (
            lambda: run(plants.LAWS["averaged"](PLANT), step=None),
            "step must be given where a rule switches the plant: of the laws only StateDependentP",
        ),
        (
            lambda: run(predictor(), plants.off_grid(), step=None, u0=None),
            "step must be given for StateDependentPredictor where the plant follows a signal: its",
        ),
        (lambda: predictor().digital(H), "StateDependentPredictor has no table: its input is not"),
        (lambda: predictor().online(-1.0), "step must be positive, in s, got -1."),
        (lambda: run(predictor(), HalfSpace([1.0, 0.0])), "rule must be one of 3 states"),
        (lambda: predictor(rule=HalfSpace([1.0, 0.0])), "rule must be one of 3 states"),
        (
            lambda: predictor(rule=lambda x: 3).online(H)(X0, HISTORY.T, 0, 0),
            "rule([ 1.  -0.5  0.8]) must be in 0..2, got 3: modes count from 0.",
        ),
        (
            lambda: run(predictor(), lambda x: x[0] > 0.0),
            "rule([ 1.  -0.5  0.8]) must be an integer in 0..2, got np.True_.",
        ),
        (lambda: run(predictor(), lambda x: 0.5), "must be an integer in 0..2, got 0.5."),
        (
            lambda: StateDependentPredictor(PLANT, -plants.gains(PLANT), WEDGE),
            "gains[0] leaves A + B K of mode 0 unstable",
        ),
    ],
)
def test_what_makes_no_sense_is_refused_by_name(make, message):
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        make()
