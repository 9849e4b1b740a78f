"""How a run ends: judged by what its loop does, and by where it comes to rest."""

import dataclasses

import numpy as np
import pytest

import deadtime as dt
import plants
from deadtime.imperfections import ColouredDisturbance, Noise, StepDisturbance, WhiteDisturbance
from deadtime.problems.comparison import compare
from deadtime.reports.verdict import table, verdict
from deadtime.simulation.outcome import outcome_of

PLANT = plants.scalar([0.4, 0.5])
GAINS = dt.place(PLANT, [-1.5])
SIGNAL = dt.SwitchingSignal.periodic([0.7, 0.9], [0, 1], 30.0)
STEP = 0.05


def problem(x0=(0.1,), plant=PLANT, law=None, **changes):
    law = dt.AveragedPredictor(PLANT, GAINS) if law is None else law
    whole = {
        "name": "x", "title": "x", "source": "", "plant": plant, "gains": GAINS,
        "laws": {"lead": law, "delay ignored": dt.DelayedStateFeedback(PLANT, GAINS)},
        "signal": SIGNAL, "x0": np.array(x0), "horizon": 20.0, "step": STEP,
    }  # fmt: skip
    return dt.problems.Problem(**whole | changes)


PUSHED = {
    "force": [StepDisturbance([2.0])],
    "late force": [StepDisturbance([2.0], start=5.0)],
    "white": [WhiteDisturbance(0.5)],
    "coloured": [ColouredDisturbance(2.0, 0.5, [1.0])],
    "noise": [Noise(0.3)],
}


def tracking():
    servo = dt.Servo(PLANT, C=[[1.0]])
    law = dt.AveragedPredictor(servo.plant, servo.place([-1.0, -1.5], STEP), allow_unstable=True)
    observer = dt.luenberger(servo.model, servo.C, poles=[-4.0], step=STEP)
    return dt.OutputFeedback(law, observer, servo=servo, reference=3.0)


@pytest.mark.few(3)
@pytest.mark.parametrize("kind", [*PUSHED, "reference"])
@pytest.mark.parametrize("x0", [1e-6, 0.0])
def test_what_stays_bounded_is_never_said_to_fail(kind, x0):
    given = problem([x0], imperfections=tuple(PUSHED.get(kind, ())))
    if kind == "reference":
        given = problem([x0], law=tracking())
    result = compare(given)
    assert result.outcomes["lead"].final > x0  # which is no failure
    assert result.outcomes["lead"].kind in ("settles", "bounded")
    said = verdict(result)[0]
    assert "fails" not in said
    assert "works" in said or "keeps the loop stable" in said


@pytest.mark.parametrize("kind", PUSHED)
def test_a_loop_that_grows_is_said_to_fail_whatever_pushes_it(kind):
    weak = dt.DelayedStateFeedback(PLANT, -0.2 + 0.0 * GAINS, allow_unstable=True)
    result = compare(problem(law=weak, imperfections=tuple(PUSHED[kind]), horizon=12.0))
    assert result.outcomes["lead"].kind == "grows"
    assert "fails" in verdict(result)[0]


@pytest.mark.parametrize(("force", "delay"), [(2.0, 0.3), (-0.5, 0.3), (1.0, 0.12)])
def test_a_constant_force_is_settled_to_where_the_loop_is_at_rest(force, delay):
    plant = dt.SwitchedSystem(PLANT.A[:1], PLANT.B[:1], delay)
    law = dt.SingleModePredictor(plant, GAINS[:1], 0)
    changes = {
        "imperfections": (StepDisturbance([force]),),
        "signal": dt.SwitchingSignal.constant(0),
    }
    result = compare(problem(plant=plant, law=law, laws={"lead": law}, **changes))
    # At rest: A x + B u + f = 0 and u = F x + Σ G_j u.
    table_of_law, A, B = law.digital(STEP), plant.A[0, 0, 0], plant.B[0, 0, 0]
    F, G = table_of_law.state_gain[0, 0, 0], table_of_law.input_gain[0].sum()
    x, _ = np.linalg.solve([[A, B], [F, G - 1.0]], [-force, 0.0])
    found = result.outcomes["lead"]
    assert found.kind == "settles"
    assert found.rest == pytest.approx([x], rel=1e-6)
    run = result.runs["lead"]
    outside = np.abs(run.states[0] - x) > 0.02 * np.abs(run.states[0] - x).max()
    assert found.settling == pytest.approx(run.time[np.flatnonzero(outside)[-1] + 1], abs=STEP)
    assert table(result)[0][5] == f"{found.settling:.2f}"
    assert "x settles in" in verdict(result)[0]


def test_a_reference_is_settled_to_and_held():
    result = compare(problem(law=tracking(), signal=dt.SwitchingSignal.constant(0)))
    found = result.outcomes["lead"]
    assert found.kind == "settles"
    assert found.rest == pytest.approx([3.0], rel=1e-2)
    assert found.settling < 10.0
    assert not np.isfinite(result.metrics["lead"]["settling_time"])


def test_an_offset_in_the_pipe_that_dies_out_is_no_failure():
    result = compare(problem([0.01], u0=0.02, horizon=2.0, signal=dt.SwitchingSignal.constant(0)))
    found = result.outcomes["lead"]
    assert found.kind == "falls" or (found.kind == "bounded" and found.final > found.start)
    assert "fails" not in verdict(result)[0]


@pytest.mark.parametrize("first", [12.0, 0.5])
def test_a_first_switch_after_settling_is_said_to_test_nothing(first):
    signal = dt.SwitchingSignal([0.0, first], [0, 1], end=30.0)
    said = " ".join(verdict(compare(problem([1.0], signal=signal))))
    assert ("this signal has not tested the law by switching" in said) == (first == 12.0)


def test_a_run_that_diverges_or_ends_early_is_lost():
    weak = dt.DelayedStateFeedback(PLANT, 0.0 * GAINS, allow_unstable=True)
    run = dt.simulate(PLANT, weak, SIGNAL, [1.0], 600.0, STEP)
    assert (outcome_of(run, 600.0).kind, outcome_of(run, 600.0).lost) == ("diverged", True)
    short = dataclasses.replace(run, diverged=False)
    assert outcome_of(short, 600.0).kind == "ends early"


@pytest.mark.few(1)
@pytest.mark.parametrize("kind", ["force", "coloured", "noise"])
def test_robustness_does_not_lose_what_is_only_pushed(kind):
    law = dt.AveragedPredictor(PLANT, GAINS)
    result = dt.robustness(
        PLANT, law, SIGNAL, [0.1], 8.0, STEP, scenarios=1, imperfections=PUSHED[kind]
    )
    assert result.late.tolerated is not None
    assert result.late.tolerated >= 1.0
    assert not any("lost as they are" in sentence for sentence in result.sentences)


def slow(rate, horizon, push):
    """A plant that decays by itself, under gains of 0, from x = 8."""
    plant = dt.SwitchedSystem([[[-rate]]], [[[1.0]]], 17.8)
    law = dt.AveragedPredictor(plant, [[[0.0]]])
    changes = {"signal": dt.SwitchingSignal.constant(0), "horizon": horizon, "step": 2.0}
    given = problem([8.0], plant, law, laws={"lead": law}, imperfections=push, **changes)
    return compare(given)


RANDOM = [Noise(0.05), WhiteDisturbance(1e-8), ColouredDisturbance(1e-4, 5.0, [1.0])]


@pytest.mark.parametrize("push", RANDOM, ids=["noise", "white", "coloured"])
@pytest.mark.parametrize(("rate", "horizon"), [(0.009, 420.0), (0.02, 188.0), (0.002, 600.0)])
def test_a_slow_loop_that_noise_alone_pushes_is_said_to_fall_and_not_to_have_settled(
    rate, horizon, push
):
    result = slow(rate, horizon, (push,))
    found = result.outcomes["lead"]
    assert found.final == pytest.approx(8.0 * np.exp(-rate * horizon), rel=0.02)
    assert (found.kind, found.settling, found.rest) == ("falls", np.inf, None)
    assert found.sentence.endswith("and has not settled when the run ends")
    assert "holds" not in " ".join(verdict(result))


@pytest.mark.parametrize(("rate", "force"), [(0.009, 0.02), (0.02, 0.05), (0.05, -0.3)])
def test_a_force_is_said_to_hold_x_once_the_loop_has_come_to_rest_there(rate, force):
    push = (StepDisturbance([force]),)
    there = slow(rate, 5.0 / rate, push).outcomes["lead"]
    assert there.kind == "settles"
    assert there.rest == pytest.approx([force / rate], rel=0.05)
    assert "where a force or a reference holds it" in there.sentence
    on_its_way = slow(rate, 2.0 / rate, push).outcomes["lead"]
    assert (on_its_way.kind, on_its_way.rest) == ("bounded", None)


def test_what_has_settled_without_a_force_is_said_to_fall():
    found = slow(0.02, 400.0, (Noise(0.05),)).outcomes["lead"]
    assert (found.kind, found.sentence) == ("falls", "|x| falls from 8.00 to 0.00268")
