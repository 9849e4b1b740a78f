"""A plant or a prediction that chatters ends its run, and says when and why."""

import re
from itertools import pairwise

import numpy as np
import pytest

import deadtime as dt
import plants
from deadtime.laws import StateDependentPredictor
from deadtime.switching import FunctionRule, HalfSpace, Polyhedra
from swinging import H, idle, idle_scalar, rotating, run


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
