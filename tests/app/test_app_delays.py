"""The explorer moves every delay of a plant that has several."""

import csv
import io
import tomllib

import numpy as np
import pytest

import deadtime as dt
from deadtime.app.documents import open_named
from deadtime.app.jobs import lifted_order, try_upload
from deadtime.app.page import Page
from deadtime.app.page_outcome import csv_of
from deadtime.problems.file import load_problem
from deadtime.reports.figures.runs import frame

A = [[[0.2, 1.0], [0.0, -0.2]], [[0.1, 1.0], [0.1, -0.3]]]
B = [[[0.1, 0.5], [1.0, 0.0]], [[0.1, 0.4], [1.1, 0.0]]]
X0, HORIZON, STEP = [1.0, -0.5], 4.0, 0.05
SIGNAL = dt.SwitchingSignal([0.0, 0.613, 1.287], [0, 1, 0])
FILE = f"""
[plant]
delay = DELAY  # measured
A = {A}
B = {B}
inputs = ["hot", "cold"]
modes = ["low", "high"]
[gains]
poles = [-1.0, -1.5]
[truth]
delay = TRUTH
[signal]
kind = "switches"
times = [0.0, 0.613, 1.287]
modes = [0, 1, 0]
[run]
x0 = {X0}
horizon = {HORIZON}
step = {STEP}
[[law]]
kind = "averaged"
"""


def page_of(tmp_path, delay, truth="[0.3, 0.1]"):
    path = tmp_path / "tank.toml"
    text = FILE.replace("DELAY", delay).replace("TRUTH", truth)
    path.write_text(text, encoding="utf-8")
    return Page(open_named(str(path)), None)


def cost_of(delays, truth):
    """The averaged law's cost by the library alone."""
    model = dt.SwitchedSystem(A, B, delays)
    law = dt.AveragedPredictor(model, dt.place(model, [-1.0, -1.5]))
    plant = dt.SwitchedSystem(A, B, truth)
    return dt.simulate(plant, law, SIGNAL, X0, HORIZON, STEP).metrics()["cost"]


FORMS = {
    "one": ("0.31", {"delay": ("Delay D (s)", 0.31)}),
    "an input": (
        "[0.31, 0.12]",
        {"delay.0": ("Delay of hot (s)", 0.31), "delay.1": ("Delay of cold (s)", 0.12)},
    ),
    "an input, said for every mode": (
        "[[0.31, 0.12], [0.31, 0.12]]",
        {"delay.0": ("Delay of hot (s)", 0.31), "delay.1": ("Delay of cold (s)", 0.12)},
    ),
    "a mode": (
        "[[0.31], [0.2]]",
        {
            "plant.delay.0.0": ("Delay in low (s)", 0.31),
            "plant.delay.1.0": ("Delay in high (s)", 0.2),
        },
    ),
    "a mode and input": (
        "[[0.31, 0.12], [0.2, 0.05]]",
        {
            "plant.delay.0.0": ("Delay of hot, low (s)", 0.31),
            "plant.delay.0.1": ("Delay of cold, low (s)", 0.12),
            "plant.delay.1.0": ("Delay of hot, high (s)", 0.2),
            "plant.delay.1.1": ("Delay of cold, high (s)", 0.05),
        },
    ),
}


@pytest.mark.few(2)
@pytest.mark.parametrize("form", list(FORMS))
def test_every_delay_moves_by_itself_and_the_costs_are_those_of_simulate(form, tmp_path):
    delay, sliders = FORMS[form]
    page = page_of(tmp_path, delay)
    found = {n: s for n, s in page.controls.sliders.items() if "delay" in n}
    error = found.pop("delay_error")
    assert {n: (s.label, s.value) for n, s in found.items()} == sliders
    delays, truth = np.broadcast_to(tomllib.loads(f"d = {delay}")["d"], (2, 2)).copy(), [0.3, 0.1]
    for name, slider in found.items():
        slider.value = moved = 0.17
        i, j = {"delay": ("", "")}.get(name, (name.split(".")[2:-1], name.rsplit(".", 1)[-1]))
        rows = [int(i[0])] if i else slice(None)
        columns = slice(None) if j == "" or form == "a mode" else int(j)
        delays[rows, columns] = moved
        shown = page.outcome.metrics["averaged"]["cost"]
        assert shown == pytest.approx(cost_of(delays, truth), rel=1e-12)
    error.value = 10.0
    shown = page.outcome.metrics["averaged"]["cost"]
    assert shown == pytest.approx(cost_of(delays, 1.1 * delays), rel=1e-12)


@pytest.mark.long
def test_a_moved_delay_is_saved_and_scripted_as_it_is_shown(tmp_path, monkeypatch):
    page = page_of(tmp_path, FORMS["a mode and input"][0])
    page.controls.sliders["plant.delay.1.0"].value = 0.25
    assert "delay = [[0.31, 0.12], [0.25, 0.05]]  # measured" in page.toml()
    path = tmp_path / "saved.toml"
    path.write_text(page.toml(), encoding="utf-8")
    run = page.outcome.runs["averaged"]
    np.testing.assert_array_equal(load_problem(path).simulate("averaged").states, run.states)
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(compile(page.actions.script(), "script.py", "exec"), names)
    np.testing.assert_array_equal(names["runs"]["averaged"].states, run.states)


def test_the_page_of_several_delays_says_growth_and_draws_the_mismatch(tmp_path):
    page = page_of(tmp_path, "[0.31, 0.12]")
    problem, run = page.outcome.problem, page.outcome.runs["averaged"]
    rates = [dt.growth_rate(problem.plant, problem.laws["averaged"], i, STEP) for i in (0, 1)]
    assert all(f"{rate:+.2f}".replace("-", "−") in page.actions.verdict.object for rate in rates)
    assert lifted_order(problem) == 2 + 6 + 2  # true delays of 0.3 s and 0.1 s
    drawn = page.figures.panels["w"].y_range
    known = np.linalg.norm(run.mismatch, axis=0)
    assert np.isnan(known[-1])
    assert drawn.start <= 0.0
    assert np.nanmax(known) <= drawn.end <= 1.2 * np.nanmax(known)
    rows = list(csv.DictReader(io.StringIO(csv_of(page.outcome.runs))))
    last = [row["averaged: w[0]"] for row in rows][-1]
    assert np.isnan(float(last))


def test_a_frame_is_that_of_what_can_be_drawn():
    row = np.array([0.0, 1.0, -2.0])
    assert frame([np.append(row, np.nan)]) == frame([row])
    assert frame([np.array([np.nan])]) == frame([np.array([])])


@pytest.mark.parametrize(
    ("delay", "said"),
    [
        ("[0.3, nan]", "plant.delay makes nan periods"),
        ("[[0.3, 0.1], [0.2]]", "delay must have shape .* got rows of different lengths"),
        ("[0.3, 0.1, 0.2]", r"delay must be a number or have shape .* got \(3,\)"),
        ("[0.3, 1e4]", "plant.delay makes 200,000 periods, the explorer takes at most"),
        ("[]", "delay"),
    ],
)
def test_uploaded_delays_that_do_not_hold_together_are_refused(delay, said):
    text = FILE.replace("DELAY", delay).replace("TRUTH", "0.3")
    with pytest.raises(dt.DeadtimeError, match=said):
        try_upload("tank.toml", text.encode())
