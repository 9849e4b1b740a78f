"""The explorer's numbers, scripts and signals are those of the library."""

import csv
import io
import math
import time
import tomllib
from dataclasses import replace

import numpy as np
import pytest

import deadtime as dt
from deadtime.app import jobs
from deadtime.app.controls import ranges_of, steps_of
from deadtime.app.documents import open_named
from deadtime.app.first_view import laws_on_offer
from deadtime.app.page import Page
from deadtime.app.page_outcome import csv_of, run_draft, table_of
from deadtime.app.script import script_of
from deadtime.app.settings import MOST, DrawnSignal, Settings, draft_of, switch_at
from deadtime.problems.file import load_problem
from deadtime.reports.figures.colours import looks_of
from deadtime.reports.figures.runs import plot_laws
from mixer import OWN
from shares import mostly_long


def shown(page, law):
    return float(page.costs.object.split(f"data-law='{law}' data-cost='")[1].split("'")[0])


# -- numbers -------------------------------------------------------------------------------


def test_the_costs_on_the_page_are_those_of_simulate(own):
    page = Page(own, None)
    page.controls.sliders["delay"].value = 0.41
    page.controls.sliders["noise"].value = 0.02
    page.controls.laws.value = ["averaged", "middle", "mode 2 only"]
    believed = dt.SwitchedSystem(
        tomllib.loads(OWN)["plant"]["A"], tomllib.loads(OWN)["plant"]["B"], 0.41
    )
    gains = dt.place(believed, [-1.0, -1.5])
    gain = dt.place(believed.mean(), [-1.0, -1.5])[0]
    truth = dt.SwitchedSystem(believed.A, believed.B, 0.37)
    signal = dt.SwitchingSignal([0.0, 0.613, 1.287, 2.004], [0, 2, 1, 0])
    laws = {
        "averaged": dt.AveragedPredictor(believed, gains),
        "middle": dt.MeanPredictor(believed, gain, gains),
        "mode 2 only": dt.SingleModePredictor(believed, gains, 2),
    }
    noise = [dt.imperfections.Noise(0.02)]
    for name, law in laws.items():
        run = dt.simulate(truth, law, signal, [1.0, -0.5], 4.0, step=0.05, imperfections=noise)
        assert shown(page, name) == pytest.approx(run.metrics()["cost"], rel=1e-12)


def test_the_oracle_is_compared_with_though_it_is_not_chosen(own):
    offer, _ = laws_on_offer(own)
    without = run_draft(draft_of(own, offer, Settings()), own.source)
    among = run_draft(draft_of(own, offer, Settings(laws=("averaged", "oracle"))), own.source)
    assert without.oracle == among.metrics["oracle"]["cost"]
    assert among.ratio("oracle") == 1.0
    assert without.ratio("averaged") == among.ratio("averaged")


OBSERVED = """
[observer]
kind = "luenberger"
C = [[1.0, 0.0]]
poles = [-6.0, -7.0]
"""


def observed(kinds, tmp_path):
    path = tmp_path / "observed.toml"
    laws = "".join(f'\n[[law]]\nkind = "{kind}"\n' for kind in kinds)
    path.write_text(
        OWN[: OWN.index("[[law]]")].replace("[truth]\ndelay = 0.37\n", "") + OBSERVED + laws
    )
    return open_named(str(path))


def test_the_oracle_of_a_problem_with_an_observer_measures_what_the_laws_do(tmp_path):
    shown = observed(["averaged", "exact"], tmp_path)
    outcome = run_draft(shown.draft, shown.source)
    names = list(outcome.runs)
    assert outcome.ratio(names[1]) == 1.0
    left_out = observed(["averaged"], tmp_path)
    alone = run_draft(left_out.draft, left_out.source)
    assert alone.oracle == outcome.oracle
    assert alone.ratio(names[0]) == outcome.ratio(names[0]) != 1.0
    assert "on estimates of the same observer" in table_of(alone, list(alone.runs))


def test_laws_have_the_colours_of_the_figure(own):
    page = Page(own, None)
    chosen = ["mean", "averaged", "oracle", "expected"]
    page.controls.laws.value = [law for law in page.offer if law in chosen]
    figure = plot_laws(page.outcome.runs, laws=list(page.offer))
    drawn = {str(line.get_label()): line.get_color() for line in figure.axes[0].get_lines()}
    looks = looks_of(list(page.offer))
    assert len(set(looks.values())) == len(looks)
    assert set(drawn) == set(page.outcome.runs) >= {"averaged", "oracle", "expected"}
    for law, colour in drawn.items():
        renderer = page.figures.panels["w"].select(name=law)[0]
        assert renderer.glyph.line_color == colour == looks[law].colour
        row = page.costs.object.partition(f"data-law='{law}'")[2].partition("</tr>")[0]
        assert f"border-top-color: {colour}" in row


def test_a_trial_of_an_upload_counts_no_time_that_others_took(monkeypatch):
    def slept(draft, source):
        time.sleep(0.2)

    monkeypatch.setattr(jobs, "run_draft", slept)
    _, seconds = jobs.try_upload("mixer.toml", OWN.encode())
    assert seconds < 0.1


def test_a_law_that_cannot_run_says_why_and_the_others_do(own, workers):
    page = Page(own, workers)
    page.controls.sliders["dwell_time"].value = 0.3
    page.controls.step.value = 0.002
    page.controls.laws.value = ["averaged", "optimal"]
    assert list(page.outcome.runs) == ["averaged"]
    assert "takes long" in page.outcome.reasons["optimal"]
    assert "takes long" in page.costs.object


def test_without_a_law_the_page_keeps_what_it_shows(own):
    page = Page(own, None)
    before = page.outcome
    page.controls.laws.value = []
    assert page.outcome is before
    assert "choose at least one" in page.message.object
    assert page.toml() == OWN


def test_what_is_saved_after_a_refused_move_is_still_what_is_shown(own):
    page = Page(own, None)
    page.controls.sliders["noise"].value = 0.01
    shown_now = page.toml()
    page.controls.step.value = "ideal"
    assert page.message.severity == "error"
    assert page.toml() == shown_now


@pytest.mark.long
def test_a_law_that_fails_while_it_runs_says_so_and_is_not_saved(own, tmp_path):
    page = Page(own, None)
    page.controls.step.value = "ideal"
    page.controls.laws.value = ["averaged", "optimal"]
    assert list(page.outcome.runs) == ["averaged"]
    assert "optimal" in page.outcome.reasons
    path = tmp_path / "saved.toml"
    path.write_text(page.toml(), encoding="utf-8")
    assert list(load_problem(path).laws) == ["averaged"]


REGIONS = """
[[signal.regions]]
H = [[1.0, 0.0]]
h = [0.2]
mode = 0

[[signal.regions]]
H = [[-1.0, 0.0]]
h = [-0.2]
mode = 1
"""
OBSERVER = """
[observer]
kind = "luenberger"
C = [[[1.0, 0.0]], [[1.0, 0.0]], [[1.0, 0.0]]]
poles = [-5.0, -6.0]
"""


BELIEF = """
[switching]
kind = "markov-chain"
P = [[0.8, 0.1, 0.1], [0.2, 0.7, 0.1], [0.0, 0.5, 0.5]]
step = 0.05

[mode_filter]
disturbance = 1e-4

[[law]]
kind = "belief"
"""


@pytest.mark.parametrize(
    "more", mostly_long(["regions", "observer", "belief"], "observer", "belief")
)
def test_scripts_of_rules_observers_and_beliefs_run(more, tmp_path, monkeypatch):
    head, tail = OWN.split("[signal]")
    text = OWN + (BELIEF if more == "belief" else OBSERVER)
    if more == "regions":
        text = f'{head}[signal]\nkind = "polyhedra"\n{REGIONS}\n[run]{tail.split("[run]")[1]}'
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    problem = load_problem(path)
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(compile(script_of(problem), "script.py", "exec"), names)
    for law, run in names["runs"].items():
        np.testing.assert_array_equal(run.states, problem.simulate(law).states)


def test_a_law_that_diverges_is_shown_as_growing():
    paper = open_named("paper")
    offer, chosen = laws_on_offer(paper)
    outcome = run_draft(draft_of(paper, offer, Settings()), paper.source)
    assert math.isinf(outcome.ratio("delay ignored"))
    assert ">grows<" in table_of(outcome, list(offer))
    assert len(chosen) == len(outcome.runs) == 6


def test_the_csv_holds_every_sample_of_every_law(own):
    outcome = run_draft(own.draft, own.source)
    rows = list(csv.DictReader(io.StringIO(csv_of(outcome.runs))))
    assert len(rows) == 81
    for law, run in outcome.runs.items():
        for i in range(2):
            np.testing.assert_array_equal([float(r[f"{law}: x[{i}]"]) for r in rows], run.states[i])
            np.testing.assert_array_equal([float(r[f"{law}: u[{i}]"]) for r in rows], run.inputs[i])


@pytest.mark.long
@pytest.mark.parametrize("name", mostly_long(["own", "paper"], "paper"))
def test_the_script_makes_the_same_runs_and_a_figure(name, own, tmp_path, monkeypatch, capsys):
    document = own if name == "own" else open_named("paper")
    offer, _ = laws_on_offer(document)
    settings = Settings({"noise": 0.01, "saturation": 30.0}, tuple(offer), DrawnSignal(1))
    outcome = run_draft(draft_of(document, offer, settings), document.source)
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(compile(script_of(outcome.problem), "script.py", "exec"), names)
    assert list(names["runs"]) == list(outcome.runs)
    printed = capsys.readouterr().out
    for law, run in outcome.runs.items():
        np.testing.assert_array_equal(names["runs"][law].states, run.states)
        assert f"{law} {run.metrics()['cost']}" in printed
    assert (tmp_path / f"{outcome.problem.name}.png").stat().st_size > 20_000


# -- signals -------------------------------------------------------------------------------


def test_a_signal_drawn_by_hand_is_the_one_that_runs(own):
    page = Page(own, None)
    page.draw_by_hand(3.0004, 2)
    page.draw_by_hand(0.7, 2)  # in mode 2 already: its beginning goes
    np.testing.assert_array_equal(page.outcome.signal.times, [0.0, 1.287, 2.004, 3.0])
    np.testing.assert_array_equal(page.outcome.signal.modes, [0, 1, 0, 2])
    assert "drawn by hand" in page.about.object
    page.controls.choose(None)
    assert page.toml() == OWN


def test_drawing_refuses_what_is_no_switch():
    with pytest.raises(dt.ArgumentError, match=r"mode must be in 0\.\.1, got 2"):
        switch_at([0.0], [0], 1.0, 2, 2)
    with pytest.raises(dt.ArgumentError, match="time of a switch must be ≥ 0"):
        switch_at([0.0], [0], -1.0, 1, 2)
    with pytest.raises(dt.ArgumentError, match="time of a switch must be ≥ 0"):
        switch_at([0.0], [0], float("nan"), 1, 2)
    with pytest.raises(dt.ArgumentError, match=f"at most {MOST} sojourns"):
        switch_at(np.arange(MOST) * 1.0, np.arange(MOST) % 2, 5.5, 2, 3)


def test_the_worst_signal_of_the_page_is_that_of_falsify(own):
    offer, _ = laws_on_offer(own)
    draft = draft_of(own, offer, Settings({"distance": 1.5}))
    found = jobs.worst_signal(draft, own.source, "averaged", 0.6)
    problem = run_draft(draft, own.source).problem
    worst = dt.falsify(problem.plant, problem.laws["averaged"], 0.6, step=0.05, budget=20_000)
    assert found["growth_rate"] == worst.growth_rate
    assert found["message"] == worst.message
    signal = dt.SwitchingSignal(found["times"], found["modes"])
    inner = signal.times[1:]
    assert (np.diff(inner) > 0.6 * (1.0 - 1e-9)).all()


def test_a_page_keeps_to_samples_where_the_modes_of_its_file_change_there(tmp_path, monkeypatch):
    kind = '[signal]\nkind = "switches"\nat = "samples"\ntimes = [0.0, 0.6]\nmodes = [0, 1]\n\n'
    begin, end = OWN.index("[signal]"), OWN.index("[run]")
    (tmp_path / "own.toml").write_text(OWN[:begin] + kind + OWN[end:], encoding="utf-8")
    document = open_named(str(tmp_path / "own.toml"))
    page = Page(document, None)
    page.draw_by_hand(1.512, 2)
    np.testing.assert_array_equal(page.outcome.signal.times, [0.0, 0.6, 1.5])
    assert page.outcome.problem.signals.at == "samples"
    asked = []

    def stop(*given, **_):
        asked.append(next(one for one in given if isinstance(one, dt.SignalClass)))
        raise dt.ArgumentError("stopped")

    monkeypatch.setattr(jobs, "falsify", stop)
    monkeypatch.setattr(jobs, "stability_margin", stop)
    given = page.draft(), document.source, "averaged"
    with pytest.raises(dt.ArgumentError, match="stopped"):
        jobs.worst_signal(*given, 0.05)
    assert jobs.margin(*given, (0.02, 2.0), 0.05)[2] == "stopped"
    assert asked == [dt.SignalClass(0.05, at="samples")] * 2


def test_a_law_on_outputs_has_a_verdict_and_one_that_is_no_table_has_none(tmp_path):
    shown = observed(["averaged"], tmp_path)
    problem = load_problem(tmp_path / "observed.toml")
    (name, law), plant = next(iter(problem.laws.items())), problem.plant
    rates = [dt.growth_rate(plant, law, i, problem.step) for i in range(plant.modes)]
    assert jobs.growth_rates(problem, name) == rates
    assert jobs.growth_elsewhere(shown.draft, shown.source, name) == rates
    ruled = dt.StateDependentPredictor(plant, law.law.gains, dt.HalfSpace([1.0, 0.0]))
    assert jobs.growth_rates(replace(problem, laws={"ruled": ruled}), "ruled") == []


@pytest.mark.long
def test_a_law_on_outputs_has_a_worst_signal_and_a_column_of_the_chart(tmp_path):
    shown = observed(["averaged"], tmp_path)
    problem = load_problem(tmp_path / "observed.toml")
    (name, law), plant = next(iter(problem.laws.items())), problem.plant
    rates = [dt.growth_rate(plant, law, i, problem.step) for i in range(plant.modes)]
    signal = jobs.worst_signal(shown.draft, shown.source, name, 0.6)
    assert signal["growth_rate"] >= max(rates) - 1e-9
    certified, refuted, reason = jobs.margin(shown.draft, shown.source, name, (0.02, 0.03), 0.6)
    assert (certified, reason) == (0.03, "")
    assert math.isnan(refuted)


def test_a_column_without_an_answer_says_why():
    paper = open_named("paper")
    draft = dict(paper.draft) | {"run": {**paper.draft["run"], "step": 0.2}}
    *margin, reason = jobs.margin(draft, paper.source, "averaged", (0.02, 2.0), 0.2)
    assert np.isnan(margin).all()
    assert "dwell_time = 0.2 s is not above one period of 0.2 s" in reason


@pytest.mark.long
def test_a_column_of_the_chart_is_a_stability_margin():
    paper = open_named("paper")
    draft = draft_of(paper, {}, Settings({"step": 0.05}))
    certified, refuted, reason = jobs.margin(draft, paper.source, "averaged", (0.02, 2.0), 0.2)
    assert reason == ""
    assert certified < refuted < certified * jobs.RATIO
    assert certified < 0.6565 < refuted * 1.02  # unstable from 0.6565 on at h = 0.1, 0.639 at 0.01


# -- what moves ----------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("name", mostly_long(["own", "follower"], "own"))
def test_every_slider_runs_at_both_ends(name, own):
    document = own if name == "own" else open_named(name)
    page = Page(document, None)
    for moved, slider in page.controls.sliders.items():
        before = slider.value
        for end in (slider.start, slider.end):
            slider.value = end
            assert page.message.severity != "error" or "horizon" in page.message.object, (
                moved, end, page.message.object,
            )  # fmt: skip
        slider.value = before
    page.controls.choose(None)
    assert page.toml() == document.text


def test_periods_on_offer_are_those_that_a_page_can_keep_up_with(own):
    assert steps_of(own) == [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, "ideal"]
    assert {one.group for one in ranges_of(own)} == {"Plant", "Switching", "Run", "Imperfections"}


def test_the_seed_draws_another_signal_and_the_file_is_a_click_away(own):
    page = Page(own, None)
    page.controls.redraw.clicks += 1
    first = page.outcome.signal.times
    page.controls.redraw.clicks += 1
    assert page.controls.seed.value == 1
    assert not np.array_equal(first, page.outcome.signal.times)
    page.controls.original.clicks += 1
    np.testing.assert_array_equal(page.outcome.signal.times, [0.0, 0.613, 1.287, 2.004])


def test_the_verdict_names_the_growth_of_every_mode_for_ever():
    page = Page(open_named("paper"), None)
    assert "mode 0 +0.128 /s, mode 1 +0.282 /s" in page.actions.verdict.object
    assert "<b>unstable</b>" in page.actions.verdict.object
