"""Units mistaken: what does not fit is said, and no work is without bounds."""

import dataclasses
import time

import numpy as np
import pytest

import deadtime as dt
import plants
from deadtime.problems.comparison import compare
from deadtime.problems.unit_checks import disagreement_of, unit_checks_of
from deadtime.reports.certificate_tables import delay_sentence, judge
from deadtime.reports.verdict import verdict
from deadtime.spectrum.held_mode_checks import MOST, seconds_of, why_left_out

PAPER = dt.problems.paper()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"horizon": 0.9}, ["The delay, 1 s, is not shorter than the horizon, 0.9 s"]),
        ({"step": 0.3}, ["The step, 0.3 s, is longer than the dwell time, 0.2 s"]),
        (
            {"step": 0.3, "signals": dt.SignalClass()},
            ["The step, 0.3 s, is longer than the dwell time"],
        ),
        (
            {"step": 15.0, "signals": dt.SignalClass(20.0)},
            ["The step, 15 s, is not shorter than the horizon"],
        ),
        ({"step": 10.0, "horizon": 5.0}, ["The step, 10 s, is not", "The step, 10 s, is longer"]),
        ({"step": None, "horizon": 0.5}, ["The delay, 1 s"]),
        ({}, []),
    ],
)
def test_numbers_that_do_not_fit_each_other_are_named(changes, said):
    found = unit_checks_of(dataclasses.replace(PAPER, **changes))
    assert len(found) == len(said)
    assert all(text.startswith(start) for text, start in zip(found, said, strict=True))


def test_a_step_to_ask_about_takes_the_place_of_the_problem_s():
    assert unit_checks_of(PAPER, 0.25)[0].startswith(
        "The step, 0.25 s, is longer than the dwell time"
    )


@pytest.mark.parametrize("step", [10.0, 3.0])
def test_growth_without_switching_is_one_figure_and_a_run_that_differs_is_named(step):
    result = compare(dataclasses.replace(PAPER, step=step))
    law = PAPER.laws["averaged"]
    assert result.growth == tuple(dt.growth_rate(PAPER.plant, law, i, step) for i in (0, 1))
    apart = [
        abs(a - b) > 0.1 * max(abs(a), abs(b))
        for a, b in zip(result.growth, result.measured, strict=True)
    ]
    assert bool(disagreement_of(result)) == any(apart)
    text = " ".join(verdict(result))
    assert ("the loop at" in text) == any(apart)
    assert "is longer than the dwell time" in text


def test_figures_that_agree_are_not_remarked_on():
    result = compare(PAPER)
    assert result.growth == pytest.approx(result.measured, rel=0.05)
    assert disagreement_of(result) == []


@pytest.mark.few(1)
@pytest.mark.parametrize("delay", [250.0, 2500.0])
def test_a_delay_in_milliseconds_is_answered_within_seconds(delay):
    plant = plants.scalar([-0.2, -0.3], delay=delay)
    gains = dt.place(plant, [-0.5])
    law = dt.MeanPredictor(plant, gains.mean(axis=0), gains)
    problem = dataclasses.replace(
        PAPER, plant=plant, gains=gains, laws={"mean": law}, x0=np.ones(1), states=(), modes=(),
        published=(), constants={}, horizon=10.0,
    )  # fmt: skip
    began = time.process_time()
    said = [*verdict(compare(problem)), *delay_sentence(problem)]
    assert time.process_time() - began < 60.0
    assert f"The delay, {delay:g} s, is not shorter than the horizon" in " ".join(said)
    assert said[-1].startswith(f"The delay margin was left out: the delay of {delay:g} s holds D/h")
    assert f"{delay / 0.01:,.0f} periods of 0.01 s" in said[-1]


def test_certificates_of_a_delay_beyond_reach_come_without_a_margin():
    plant = plants.scalar([-0.2, -0.3], delay=250.0)
    law = dt.MeanPredictor(plant, [[-0.1]], [[[-0.1]], [[-0.1]]])
    problem = dataclasses.replace(
        PAPER, plant=plant, gains=law.gains, laws={"mean": law}, x0=np.ones(1), states=(), modes=()
    )
    [judged] = judge(problem, dt.SignalClass(0.5), 0.01)
    assert judged.margin is None
    assert judged.reason.startswith("The delay margin was left out")


@pytest.mark.parametrize("asked", ["growth rate", "delay margin", "gain margin"])
def test_the_step_that_is_proposed_is_affordable(asked):
    for delay, modes in ((250.0, 2), (90.0, 5), (1e5, 1)):
        plant = plants.scalar([-0.2] * modes, delay=delay)
        law = dt.DelayedStateFeedback(plant, np.full((modes, 1, 1), -0.1))
        why = why_left_out(asked, plant, law, 0.01)
        step = float(why.split("longer step, ")[1].split(" s")[0])
        assert why_left_out(asked, plant, law, step) == ""
        assert seconds_of(asked, plant, law, 0.5 * step) > MOST
    assert why_left_out(asked, plant, law, None) == ""


@pytest.mark.parametrize(
    ("asked", "delay", "step"),
    [
        *(("delay margin", 250.0, 0.04), ("gain margin", 250.0, 0.2), ("gain margin", 25.0, 0.02)),
        *(("design", 250.0, 0.3), ("design", 25.0, 0.03)),
    ],
)
def test_margins_and_designs_that_would_take_long_are_refused_with_a_step_that_does(
    asked, delay, step
):
    plant = plants.scalar([-0.5], delay=delay)
    law = dt.SingleModePredictor(plant, [[[0.1]]], 0)
    ask = {
        "delay margin": lambda: dt.delay_margin(plant, law, step=0.01),
        "gain margin": lambda: dt.gain_margin(plant, law, step=0.01),
        "design": lambda: dt.design(plant, delay_margin=0.1, step=0.01),
    }[asked]
    began = time.process_time()
    with pytest.raises(dt.ArgumentError, match=f"a {asked}, got 0.01 s: .* longer step, {step} s"):
        ask()
    assert time.process_time() - began < 5.0


def test_a_delay_whose_work_is_beyond_floats_is_refused_with_a_step_too():
    plant = plants.scalar([-0.5], delay=1e200)
    law = dt.DelayedStateFeedback(plant, [[[0.1]]])
    with pytest.raises(dt.ArgumentError, match=r"takes about inf h; .* longer step, 5e\+196 s"):
        dt.gain_margin(plant, law, step=0.01)


def test_robustness_leaves_margins_out_where_they_would_take_long():
    plant = plants.scalar([-0.2, -0.3], delay=60.0)
    law = dt.MeanPredictor(plant, [[-0.05]], [[[-0.05]], [[-0.05]]])
    signal = dt.SwitchingSignal.periodic([20.0, 30.0], [0, 1], 200.0)
    result = dt.robustness(plant, law, signal, [1.0], 61.0, 0.01, scenarios=1)
    assert result.delay is result.gain is None
    assert sum("was left out" in sentence for sentence in result.sentences) == 2
    assert result.left_out == ("delay margin", "gain margin")


def test_a_delay_that_floats_cannot_tell_from_none_is_compared_like_any_short_one():
    plant = dt.SwitchedSystem(PAPER.plant.A, PAPER.plant.B, 5e-324)
    laws = {"averaged": dt.AveragedPredictor(plant, PAPER.gains)}
    result = compare(dataclasses.replace(PAPER, plant=plant, laws=laws, step=2.5))
    assert len(result.growth) == 2


@pytest.mark.parametrize("rate", [0.1, 0.5, 2.0])
def test_short_sojourns_of_a_drawn_signal_are_no_slip_but_short_ones_as_a_rule_are(rate):
    model = dt.Markov([[0.0, rate], [rate, 0.0]])
    signal = model.sample(400.0 / rate, seed=1)
    assert signal.dwell_time < 0.05 / rate < 5.0 / rate
    drawn = dataclasses.replace(
        PAPER, switching=model, signal=signal, signals=dt.SignalClass(), horizon=300.0 / rate
    )
    assert unit_checks_of(drawn, 0.05 / rate) == []
    (said,) = unit_checks_of(drawn, 5.0 / rate)
    assert said.startswith(f"The step, {5.0 / rate:g} s, is longer than half of the signal's soj")
