"""The law that runs a rule forward leaves no mismatch; its runs are those along their signals."""

import re

import numpy as np
import pytest

import deadtime as dt
import plants
import rule_reference as second
from deadtime.feedback.law import TableLaw
from deadtime.laws import StateDependentPredictor
from deadtime.switching import HalfSpace, Polyhedra
from swinging import (
    BOUNDARIES,
    HISTORY,
    NORMALS,
    OFFSETS,
    PLANT,
    RULES,
    SOFT,
    WEDGE,
    X0,
    H,
    ball,
    idle,
    idle_scalar,
    predictor,
    run,
    soft,
    swinging,
    wedge,
)

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


TABLES = [name for name in plants.LAWS if name != "exact"]
NEVER = HalfSpace([1.0, 0.0, 0.0], 1e6), lambda x: 0


# -- relations between runs --------------------------------------------------------------------


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


@pytest.mark.few(4)
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
