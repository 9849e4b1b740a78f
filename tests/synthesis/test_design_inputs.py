"""Designs that keep inputs within limits, ask for no margin, and hint at mixed units."""

import json

import numpy as np
import pytest

import deadtime as dt
from deadtime.cli.application import main
from deadtime.reports.design import HEADINGS, design_rows, plot_designs
from deadtime.synthesis import input_peak
from deadtime.synthesis.design import unit_hints

# A position and a speed; a fast plain design asks for large inputs.
PLANT = dt.SwitchedSystem([[[0.0, 1.0], [0.0, -0.5]]], [[[0.0], [1.0]]], 0.3)
GAINS = dt.place(PLANT, [-2.0, -2.5])
H = 0.05


def designed(**options):
    options = {"step": H, "gains": GAINS, "budget": 60, "filtered": False} | options
    return dt.design(PLANT, **options)


def largest(found, starts):
    """Of runs from the corners of a set."""
    signal = dt.SwitchingSignal.constant(0)
    runs = [dt.simulate(PLANT, found.law, signal, x0, 20.0, found.step) for x0 in starts]
    return max(float(np.abs(run.inputs).max()) for run in runs)


@pytest.fixture(scope="module")
def limited():
    return designed(input_limit=1.5, initial=dt.InitialStates.box([1.0, 0.5]), decay_rate=0.4)


def test_inputs_stay_below_the_limit_from_every_corner_of_the_box(limited):
    corners = [[1.0, 0.5], [1.0, -0.5]]
    assert limited.reached
    assert limited.input_peak[0] <= 1.5 < limited.plain.input_peak[0]
    assert largest(limited, corners) == pytest.approx(limited.input_peak[0], rel=1e-9)
    assert limited.decay_rate >= 0.4
    assert all(point.input_peak[0] <= 1.5 for point in limited.points)
    assert (
        f"|u| stays below 1.5 for every |x(0)| ≤ (1, 0.5): it reaches {limited.input_peak[0]:.3g}, "
        f"the plain design's reaches {limited.plain.input_peak[0]:.3g}."
    ) in limited.message


def test_rows_and_marks_say_who_exceeds_the_limit(limited):
    rows = [dict(zip(HEADINGS, row, strict=True)) for row in design_rows(limited)]
    assert rows[0]["unmet"] == "|u|"
    assert rows[0]["peak |u|"] == f"{limited.plain.input_peak[0]:.3g}"
    assert {row["unmet"] for row in rows[1:]} == {"–"}
    labels = {text.get_text() for text in plot_designs({"": limited}).legends[0].get_texts()}
    assert "hollow: slow, or |u| too large" in labels
    assert "margin asked for" not in labels


def test_the_chart_shows_the_inputs_of_every_design_and_rings_the_chosen_one(limited):
    costs, inputs = plot_designs({"": limited}).axes
    assert inputs.get_ylabel() == "peak |u|"
    assert inputs.get_xlim() == costs.get_xlim()
    (limit,) = [line for line in inputs.lines if line.get_linestyle() == "--"]
    assert limit.get_ydata() == [1.5, 1.5]
    marks = [line for line in inputs.lines if line.get_marker() not in ("None", ">")]
    (ring,) = [line for line in marks if line.get_markersize() == 10.0]
    assert ring.get_ydata() == pytest.approx(limited.input_peak)
    points = {point.law: point for point in (limited.plain, *limited.points)}.values()
    shown = sorted(float(np.ravel(line.get_ydata())[0]) for line in marks if line is not ring)
    assert shown == pytest.approx(sorted(float(point.input_peak[0]) for point in points))
    low, high = inputs.get_ylim()
    assert low < min(shown) < max(shown) < high


def test_the_chart_of_several_inputs_shows_the_largest_beside_its_limit():
    plant = dt.SwitchedSystem([[[-1.0]]], [[[1.0, 0.5]]], delay=[0.4, 0.2])
    found = dt.design(plant, step=0.1, budget=20, input_limit=[2.0, 0.1])
    _, inputs = plot_designs({"": found}).axes
    assert inputs.get_ylabel() == "peak |u| / limit"
    ring = next(line for line in inputs.lines if line.get_markersize() == 10.0)
    assert found.input_peak is not None
    assert ring.get_ydata() == pytest.approx([(found.input_peak / [2.0, 0.1]).max()])


def test_a_limit_that_nothing_tried_keeps_is_missed_and_said():
    found = designed(input_limit=1e-3, decay_rate=0.4, delay_margin=0.02, budget=20)
    assert not found.reached
    assert found.input_peak is not None
    assert "input limit" in found.missed(found.plain)
    load = found.input_peak[0] / 1e-3
    assert load > 1.0
    assert "|u| does not stay below 0.001 for every |x(0)| ≤ 1: it reaches" in found.message
    assert "not the margin" in found.message


def test_of_a_normal_start_the_limit_is_kept_with_the_probability_asked_for():
    initial = dt.InitialStates.normal([0.25, 0.04], 0.95)
    found = designed(input_limit=1.2, initial=initial, decay_rate=0.3, budget=30)
    assert found.reached
    signal = dt.SwitchingSignal.constant(0)
    runs = [dt.simulate(PLANT, found.law, signal, x0, 20.0, H).inputs[0] for x0 in np.eye(2)]
    draws = np.random.default_rng(0).normal(size=(5_000, 2)) * [0.5, 0.2]
    within = np.mean(np.abs(draws @ runs).max(axis=1) <= 1.2)
    assert within >= 0.95
    assert "for x(0) ~ N(0, X) with a probability of 0.95 at least: it may reach" in found.message


def test_without_a_request_the_cheapest_is_taken_and_its_margin_said():
    found = designed(budget=30)
    asked = designed(delay_margin=1e-3, budget=30)
    assert found.reached
    assert found.asked == 0.0
    assert found.cost <= asked.cost * (1.0 + 1e-3)
    assert "asked" not in found.message
    margin = dt.delay_margin(PLANT, found.law, H)
    assert found.margin.relative == margin.relative
    peak = input_peak(PLANT, found.law, H)
    assert (found.input_peak == peak.level[0]).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"input_limit": -1.0}, "input_limit must be positive, in the inputs' units"),
        ({"input_limit": [1.0, 2.0]}, "input_limit must have shape"),
        ({"input_limit": 1.0, "initial": dt.InitialStates.box([1.0])}, "initial must be of n = 2"),
    ],
)
def test_limits_that_make_no_sense_are_refused_by_name(change, message):
    with pytest.raises(dt.ArgumentError, match=message):
        designed(**change)


def test_the_command_takes_limits_and_asks_for_no_margin(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments = ["--input-limit", "6", "--initial", "0.5,1,1", "--budget", "20", "--mode", "0"]
    with pytest.raises(SystemExit) as stopped:
        main(["design", "follower", "--step", "0.1", *arguments, "--json"])
    record = json.loads(capsys.readouterr().out)
    assert stopped.value.code == (0 if record["reached"] else 1)
    assert record["input_limit"] == [6.0]
    assert record["initial"] == {"kind": "box", "size": [0.5, 1.0, 1.0], "probability": 1.0}
    assert record["reached"] == (record["input_peak"][0] <= 6.0)


def test_ratios_that_only_mixed_units_have_are_hinted_at_and_others_are_not():
    plants = [dt.problems.paper(), dt.problems.three_mode(), dt.problems.follower()]
    assert all(unit_hints(one.plant, one.gains, 0.05) == () for one in plants)
    late = dt.SwitchedSystem([[[1.0]]], [[[1.0]]], 300.0)  # meant: ms
    (hint,) = unit_hints(late, dt.place(late, [-1.0]), 0.01)
    assert hint.endswith("is the delay in seconds?")
    assert "grows 1.9 × 10¹³⁰ times within the delay of 300 s" in hint
    (hint,) = unit_hints(PLANT, GAINS, 20.0)  # meant: ms
    assert hint.startswith("The step of 20 s is longer than the loop's fastest motion, 1/|p| = 0.4")
    mixed = dt.SwitchedSystem([[[0.0, 1e14], [1e-14, -1.0]]], [[[0.0], [1.0]]], 0.1)
    hints = unit_hints(mixed, np.zeros((1, 1, 2)), 0.01)
    assert any("the states 1 and 0 are" in hint or "the states 0 and 1" in hint for hint in hints)


def test_a_hint_stands_at_the_end_of_the_message():
    slow = dt.design(PLANT, step=0.9, gains=GAINS, budget=20, filtered=False)
    assert slow.message.endswith("is the step in seconds, and are poles in 1/s?")
