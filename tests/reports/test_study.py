"""Studies: their files, their runs, what is found in them, and the report."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from scipy.stats import expon

import deadtime as dt
from deadtime.cli.entry import main
from deadtime.problems.file.schema import SemiMarkovSwitching
from deadtime.problems.file.switching import build_model
from deadtime.problems.law_registry import LEVELS
from deadtime.reports.study import run_study
from deadtime.reports.study.answers import answers
from deadtime.reports.study.findings import (
    against_best,
    best,
    duel,
    favourite,
    steadier,
    summary,
    typical_regret,
    unbeaten,
)
from deadtime.reports.study.phrases import region
from deadtime.reports.study.report import write_study
from deadtime.reports.study.run import failures
from deadtime.scenarios.paired.statistics import mean_interval, median_interval
from deadtime.scenarios.sweeps import load_study
from deadtime.scenarios.sweeps.cell import run_cell
from deadtime.scenarios.sweeps.laws import kinds_of, within
from deadtime.scenarios.sweeps.sojourns import FAMILIES, sojourn_section

SHIPPED = Path(__file__).parents[2] / "studies" / "paper.toml"
PLAIN = """\
title = "A small study"
problem = "paper"
poles = [-1.0, -2.0]
horizon = 6.0
step = 0.05
scenarios = 8
laws = ["averaged", "mean", "mean, dwell-aware", "expected", "delay ignored"]

[grid]
dwell_time = [0.2, 0.8]
distance = [0.5, 1.0]
delay = [0.5]
sojourn = ["exponential", "fixed"]
"""


def load(tmp_path, text=PLAIN):
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return load_study(path)


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A small study, and its data."""
    folder = tmp_path_factory.mktemp("study")
    study = load(folder)
    return study, run_study(study, folder / "small.zarr", workers=1)


# What a file says


def test_the_shipped_study_covers_dwell_time_distance_delay_and_sojourns():
    study = load_study(SHIPPED)
    assert set(study.grid) == {"sojourn", "delay", "distance", "dwell_time"}
    assert study.grid["sojourn"] == tuple(FAMILIES)
    assert study.size == len(list(study.cells())) == np.prod(study.shape)
    assert study.laws[-1] == "oracle"
    np.testing.assert_array_equal(study.base.plant.A, dt.problems.paper().plant.A)


def test_what_a_file_leaves_out_is_the_problem_s(tmp_path):
    study = load(tmp_path, "poles = [-1, -2]\n[grid]\ndwell_time = 0.3")
    problem = dt.problems.paper()
    assert study.grid == {"dwell_time": (0.3,)}
    assert (study.base.horizon, study.base.step) == (problem.horizon, problem.step)
    assert study.laws == (
        "averaged", "mean", "averaged, dwell-aware", "mean, dwell-aware", "expected", "oracle",
    )  # fmt: skip


def test_a_problem_file_is_found_beside_the_study(tmp_path):
    with pytest.raises(SystemExit):
        main(["init", str(tmp_path / "car.toml"), "--example", "follower"])
    text = PLAIN.replace('"paper"', '"car.toml"').replace("[-1.0, -2.0]", '["-1+1j", "-1-1j", -2]')
    study = load(tmp_path, text)
    assert study.base.plant.states == 3
    assert study.poles == (-1 + 1j, -1 - 1j, -2)


BAD = [
    ("horizon = 6.0", "horizn = 6.0", r"line 4: horizn is not known: did you mean horizon\?"),
    ("delay = [0.5]", "dealy = [0.5]", r"line 12, .*: dealy is not known: did you mean delay\?"),
    ("dwell_time = [0.2, 0.8]\n", "", r"line 12, \[grid\]: sojourn needs dwell_time beside it\."),
    ("poles = [-1.0, -2.0]\n", "", r"line 6: laws: law 'mean, dwell-aware' is not known"),
    ("[0.2, 0.8]", "[]", r"line 10: grid\.dwell_time: must hold at least one value"),
    ("[0.2, 0.8]", "[0.2, 0.2]", r"line 10: grid\.dwell_time: holds 0\.2 twice: list each"),
    ("[0.2, 0.8]", "[0.2, 0.0]", r"line 10: grid\.dwell_time\.1: .* greater than 0, got 0\.0\."),
    ("[0.5, 1.0]", "[0.5, -1.0]", r"line 11: grid\.distance\.1: .* greater than or equal to 0"),
    ("[0.5, 1.0]", "[0.5, inf]", r"line 11: grid\.distance\.1: .* finite number"),
    ('"fixed"', '"expnential"', r"line 13: .*'expnential' is not known: did you mean 'expon"),
    ('"fixed"', '"xyz"', r"line 13: .*'xyz' is not known: it must be one of exponential, uniform"),
    ('"mean",', '"meen",', r"line 7: laws: law 'meen' is not known: did you mean 'mean'\?"),
    ('"delay ignored"', '"mode 2 only"', r"line 7: laws: law 'mode 2 only' is not known"),
    ('"delay ignored"', '"mean"', r"line 7: laws: holds 'mean' twice"),
    ("scenarios = 8", "scenarios = 0", r"line 6: scenarios: .* greater than or equal to 1, got 0"),
    ("scenarios = 8", "scenarios = true", r"line 6: scenarios: .* valid integer, got True"),
    ("scenarios = 8", "seed = -1", r"line 6: seed: .* greater than or equal to 0, got -1"),
    ('"paper"', '"papr"', r"line 2: problem: problem 'papr' is not known: did you mean 'paper'\?"),
    ('"paper"', '"none.toml"', r"line 2: problem: .*none\.toml cannot be read"),
    ("[-1.0, -2.0]", "[]", r"line 3: poles: .* at least 1 item"),
    ("[-1.0, -2.0]", "[-1.0]", r"line 3: poles must have shape \(n,\) = \(2,\)"),
    ("[-1.0, -2.0]", "[1.0, -2.0]", r"line 3: poles must lie left of the imaginary axis"),
    ("[-1.0, -2.0]", '[-1.0, "x"]', r"line 3: poles must be numbers, or text such as"),
    ("[-1.0, -2.0]", "[-1.0, -1.0]", r"line 3: poles of mode 0: .* repeated 2 times"),
    ("delay = [0.5]", "step = [0.1, 0.2]", r"line 5: step is given twice, here and in \[grid\]"),
    ("scenarios = 8", "scenarios = ", r"not valid TOML"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "message"), BAD, ids=range(len(BAD)))
def test_bad_file_is_refused_by_line_and_key(tmp_path, old, new, message):
    assert old in PLAIN
    with pytest.raises(dt.StudyFileError, match=message) as caught:
        load(tmp_path, PLAIN.replace(old, new, 1))
    assert "\n" not in str(caught.value)


def test_problems_that_no_study_can_use_are_refused(tmp_path):
    with pytest.raises(SystemExit):
        main(["init", str(tmp_path / "own.toml")])
    text = (tmp_path / "own.toml").read_text(encoding="utf-8")
    own, study = tmp_path / "own.toml", PLAIN.replace('"paper"', '"own.toml"')
    own.write_text(text.replace("x0 = [-1.0, 1.0]", "x0 = [0.0, 0.0]"), encoding="utf-8")
    with pytest.raises(dt.StudyFileError, match="its x0 is 0"):
        load(tmp_path, study)
    own.write_text(text.replace("step = 0.01 ", 'step = "ideal" '), encoding="utf-8")
    with pytest.raises(dt.StudyFileError, match="step must be given"):
        load(tmp_path, study.replace("step = 0.05\n", ""))
    single = text.replace("  [[2.3, 1.1], [0.05, 1.2]],\n", "").replace("  [[0.0], [1.02]],\n", "")
    single = single.split("[signal]")[0] + '[signal]\nkind = "constant"\nmode = 0\n[run]\n'
    own.write_text(single + "x0 = [-1.0, 1.0]\nhorizon = 5.0\n", encoding="utf-8")
    with pytest.raises(dt.StudyFileError, match="its plant has one mode"):
        load(tmp_path, study)


# What is run


@pytest.mark.parametrize("family", FAMILIES)
def test_families_compare_no_sojourn_below_the_dwell_time_and_mean_twice_that(family):
    section = SemiMarkovSwitching(kind="semi-markov", sojourn=sojourn_section(family, 0.4))
    model = build_model(section, 2, Path())
    np.testing.assert_allclose(model.mean, 0.8, rtol=1e-9)
    assert model.sample(400.0, seed=1).dwell_time >= 0.4 * (1.0 - 1e-12)


def test_a_cell_is_monte_carlo_on_its_plant_gains_and_model(small):
    study, data = small
    plant = dt.SwitchedSystem(study.base.plant.A, study.base.plant.B, 0.5)
    gains = dt.place(plant, [-1, -2])
    model = dt.SemiMarkov(expon(0.8, 0.8), modes=2)
    gain = dt.place(plant.mean(), [-1, -2])[0]
    laws = {
        "mean, dwell-aware": dt.MeanPredictor(plant, gain, gains, 0.8),
        "expected": dt.ExpectedPredictor(plant, gains, model),
        "oracle": dt.ExactPredictor(plant, gains),
    }
    direct = dt.monte_carlo(plant, laws, model, study.base.x0, 6.0, 0.05, scenarios=8)
    here = data.sel(sojourn="exponential", delay=0.5, distance=1.0, dwell_time=0.8, law=list(laws))
    for name in ("ise", "final_norm"):
        np.testing.assert_array_equal(here[name].values, direct[name].values)
    assert str(study.cell((1, 1, 0, 0))) == (
        "dwell time 0.8 s, mode distance α 1, delay 0.5 s, exponential sojourns"
    )


def test_fixed_sojourns_are_a_known_future_expected_equals_oracle(small):
    _, data = small
    fixed = data.ise.sel(sojourn="fixed")
    np.testing.assert_allclose(fixed.sel(law="expected"), fixed.sel(law="oracle"), rtol=1e-9)


def test_every_law_that_a_study_can_name_runs_and_knows_what_its_name_says(small):
    study, _ = small
    laws = tuple(
        name for name in kinds_of(2) if "minimax" not in name
    )  # tests/laws/test_minimax.py
    run = study.problem["run"] | {"horizon": 2.0, "step": 0.1}
    study = replace(study, laws=laws, scenarios=2, problem=study.problem | {"run": run})
    outcome = run_cell(study, next(iter(study.cells())))
    assert set(outcome.reasons) == {""}
    assert np.isfinite(outcome.metrics["ise"]).all()
    known = {level: within(laws, level) for level in LEVELS}
    assert "mode 1 only" in known["nothing"]
    assert set(known["the dwell time"]) - set(known["nothing"]) == {
        "averaged, dwell-aware", "mean, dwell-aware",
    }  # fmt: skip
    assert set(known["the distribution"]) - set(known["the dwell time"]) == {"expected", "optimal"}
    assert set(laws) - set(known["the distribution"]) == {"oracle"}


def test_the_uncompensated_law_fails_where_the_predictors_succeed(small):
    study, _ = small
    run = study.problem["run"] | {"horizon": 15.0}
    study = replace(study, scenarios=3, problem=study.problem | {"run": run})
    outcome = run_cell(study, next(study.cells()))
    final = dict(zip(study.laws, outcome.metrics["final_norm"], strict=True))
    assert final["delay ignored"].min() > 1e3
    assert max(final[law].max() for law in study.laws if law != "delay ignored") < 0.1


def test_a_law_that_cannot_be_built_is_recorded_and_the_study_goes_on(tmp_path):
    text = PLAIN.replace("[0.2, 0.8]", "[0.02, 0.8]")  # the step is too long for 0.02 s
    data = run_study(load(tmp_path, text), tmp_path / "x.zarr", workers=1)
    found = failures(data)
    assert {failure["law"] for failure in found} == {"expected"}
    assert all("0.02 s" in failure["cell"] for failure in found)
    assert all("step" in failure["reason"] for failure in found)
    missing = data.ise.isnull().all("scenario").sel(law="expected")
    np.testing.assert_array_equal(missing.sel(dwell_time=0.02), True)
    assert not missing.sel(dwell_time=0.8).any()
    assert not data.ise.drop_sel(law="expected").isnull().any()
    assert summary(data).regret.isnull().sum() == 4
    assert (best(data, ["expected", "mean"]).winner.sel(dwell_time=0.02) == "mean").all()
    assert answers(data)


def test_a_plant_without_gains_fails_every_law_of_its_cells(tmp_path):
    plant = """
[plant]
delay = 0.5
A = [[[1.0, 0.0], [0.0, 2.0]], [[1.0, 0.0], [0.0, 3.0]]]
B = [[[1.0], [1.0]], [[1.0], [0.0]]]
[gains]
K = [[[-1.0, -1.0]], [[-1.0, -1.0]]]
allow_unstable = true
[signal]
kind = "constant"
mode = 0
[run]
x0 = [1.0, 0.0]
horizon = 2.0
step = 0.1
"""
    near = plant.replace("[[1.0], [0.0]]]", "[[1.0], [0.5]]]")  # uncontrollable at α = 2
    (tmp_path / "own.toml").write_text(near, encoding="utf-8")
    text = PLAIN.replace('"paper"', '"own.toml"').replace("[0.5, 1.0]", "[1.0, 2.0]")
    study = load(tmp_path, text.replace("6.0", "2.0"))
    data = run_study(study, tmp_path / "x.zarr", workers=1)
    assert len(failures(data)) == 4 * len(study.laws)
    assert all("not controllable" in failure["reason"] for failure in failures(data))
    assert data.ise.sel(distance=2.0).isnull().all()
    assert not data.ise.sel(distance=1.0).isnull().any()
    assert answers(data)


# What is found


def made(ise, final=0.1, diverged=False):
    """Data of one row of cells, ∫|x|² (law, dwell time, scenario) under a, b, …, oracle."""
    ise = np.asarray(ise, dtype=float)[None, None, None].transpose(0, 1, 2, 4, 3, 5)
    names = [*("averaged", "mean", "expected")[: ise.shape[-2] - 1], "oracle"]
    dims = ("sojourn", "delay", "distance", "dwell_time", "law", "scenario")
    variables = {
        "ise": (dims, ise),
        "final_norm": (dims, np.broadcast_to(final, ise.shape).copy()),
        "diverged": (dims, np.broadcast_to(diverged, ise.shape).copy()),
    }
    coordinates = {
        "sojourn": ["uniform"], "delay": [1.0], "distance": [1.0],
        "dwell_time": 0.1 * 2.0 ** np.arange(ise.shape[3]), "law": names,
    }  # fmt: skip
    return xr.Dataset(variables, coordinates, {"start": 1.0})


def paired(*factors, scenarios=100):
    """∫|x|² of laws that are so many times the oracle's, whose own spreads over decades."""
    oracle = np.geomspace(1.0, 1e6, scenarios)
    rows = [[np.broadcast_to(factor, scenarios) * oracle] for factor in (*factors, 1.0)]
    return made(rows)


def test_regret_is_the_paired_geometric_mean_and_beside_it_the_median():
    factor = np.random.default_rng(0).permutation(np.geomspace(1.0, 4.0, 100))
    found = summary(paired(factor)).sel(law="averaged").isel(dwell_time=0).squeeze()
    assert found.regret == pytest.approx(2.0)
    half = np.exp(1.984217 * np.log(factor).std(ddof=1) / 10.0)  # Student's, 99 degrees
    assert (found.regret_low, found.regret_high) == (
        pytest.approx(2.0 / half), pytest.approx(2.0 * half),
    )  # fmt: skip
    ordered = np.sort(factor)
    assert (found.median_regret_low, found.median_regret_high) == (
        pytest.approx(ordered[39]), pytest.approx(ordered[60]),
    )  # fmt: skip


@pytest.mark.parametrize("interval", [mean_interval, median_interval])
def test_intervals_cover_as_often_as_they_say(interval):
    draws = np.random.default_rng(3).lognormal(sigma=2.0, size=(4000, 60))
    _, low, high = interval(draws)
    # Order statistics come in steps: with 60 of them the interval holds at 97.3 %.
    assert 0.94 < np.mean((low <= 1.0) & (high >= 1.0)) < 0.98


def test_few_draws_bound_nothing():
    assert [float(part) for part in median_interval(np.arange(5.0))] == [2.0, -np.inf, np.inf]
    assert [float(part) for part in median_interval(np.arange(6.0))] == [2.5, 0.0, 5.0]
    assert [float(part) for part in mean_interval(np.array([2.0]))] == [2.0, 0.0, np.inf]


def test_the_better_law_wins_although_signals_differ_more_than_laws():
    factor = np.where(np.arange(100) < 80, 0.9, 1.1)  # better on 80 % of the signals
    data = paired(factor * 1.2, 1.2)
    fight = duel(data, "averaged", "mean").squeeze()
    assert fight.ratio == pytest.approx(0.9**0.8 * 1.1**0.2)
    assert fight.ratio_low < fight.ratio < fight.ratio_high < 1.0
    assert (fight.median_ratio, fight.share, fight.verdict) == (pytest.approx(0.9), 0.8, 1.0)
    assert 0.70 < fight.share_low < 0.8 < fight.share_high < 0.88
    reverse = duel(data, "mean", "averaged").squeeze()
    assert (float(reverse.share), float(reverse.verdict)) == (pytest.approx(0.2), -1.0)
    found = best(data, ["mean", "averaged"]).squeeze()
    assert (found.winner.item(), found.runner_up.item(), found.verdict.item()) == (
        "averaged", "mean", 1.0,
    )  # fmt: skip


def test_two_groups_of_signals_are_decided_by_how_much_not_by_how_many():
    factor = np.where(np.arange(100) < 48, 0.8, 1.01)  # better by 20 % on 48, worse by 1 % on 52
    fight = duel(paired(factor, 1.0), "averaged", "mean").squeeze()
    assert fight.median_ratio == pytest.approx(1.01)
    assert fight.share_low < 0.5 < fight.share_high
    assert (fight.ratio, fight.verdict) == (pytest.approx(0.8**0.48 * 1.01**0.52), 1.0)


def test_a_tie_is_an_interval_that_contains_1():
    factor = np.where(np.arange(100) % 2, 0.8, 1.2)
    fight = duel(paired(factor, 1.0), "averaged", "mean").squeeze()
    assert fight.ratio_low < 1.0 < fight.ratio_high
    assert fight.verdict == 0.0
    assert best(paired(factor, 1.0), ["averaged", "mean"]).verdict.item() == 0.0


def test_equal_laws_are_tied_and_both_unbeaten():
    data = paired(1.5 * (1.0 + 1e-9), 1.5)
    fight = duel(data, "averaged", "mean").squeeze()
    assert (fight.share, fight.share_low, fight.share_high, fight.verdict) == (0.5, 0.0, 1.0, 0.0)
    assert unbeaten(data, ["averaged", "mean"]).all()


def test_the_law_to_use_has_the_least_regret_in_the_geometric_mean_and_lost_is_lost():
    one = np.ones(20)
    several = made([[1.0 * one] * 2 + [50.0 * one], [1.2 * one] * 3, [one] * 3])
    assert favourite(several, ["averaged", "mean"]) == "mean"  # 3.68 against 1.2
    lost = made([[1e9 * one, one, one], [101.0 * one, 1.1 * one, 1.1 * one], [one] * 3])
    assert favourite(lost, ["averaged", "mean"]) == "averaged"
    assert typical_regret(lost).sel(law="averaged").item() == pytest.approx(100.0 ** (1 / 3))


def test_the_expected_law_is_held_against_the_best_rival_of_each_cell():
    oracle = np.ones(50)
    ise = [[2.0 * oracle, 3.0 * oracle], [3.0 * oracle, 2.0 * oracle], [1.0 * oracle, 4.0 * oracle],
           [oracle, oracle]]  # fmt: skip
    fight = against_best(made(ise), "expected", ["averaged", "mean"]).squeeze()
    np.testing.assert_allclose(fight.ratio, [0.5, 2.0])
    np.testing.assert_array_equal(fight.verdict, [1.0, -1.0])


def test_a_diverged_run_is_worse_than_any_other():
    ise = np.ones((3, 1, 40))
    ise[0] = 0.5  # its run ended early: less had been summed up
    diverged = np.zeros((1, 1, 1, 1, 3, 40), dtype=bool)
    diverged[..., 0, :] = True
    data = made(ise, diverged=diverged)
    fight = duel(data, "averaged", "mean").squeeze()
    assert (fight.ratio, fight.verdict) == (pytest.approx(1e12), -1.0)
    found = summary(data).squeeze()
    assert found.regret.sel(law="averaged") == pytest.approx(1e12)
    assert found.stabilised.sel(law="averaged") == 0.0
    both = made(ise, diverged=np.ones((1, 1, 1, 1, 3, 40), dtype=bool))
    assert duel(both, "averaged", "mean").verdict.item() == 0.0


def test_stabilised_signals_are_counted_and_compared_in_pairs():
    final = np.full((1, 1, 1, 1, 3, 60), 0.5)
    final[..., 0, :30] = 2.0  # averaged loses half of the signals, the others none
    data = made(np.ones((3, 1, 60)), final=final)
    found = summary(data).squeeze()
    assert found.stabilised.sel(law="averaged") == 0.5
    assert (
        found.stabilised_low.sel(law="averaged") < 0.5 < found.stabilised_high.sel(law="averaged")
    )
    assert found.stabilised.sel(law="mean") == 1.0
    assert steadier(data, "mean", "averaged").item() == 1.0
    assert steadier(data, "averaged", "mean").item() == -1.0
    assert steadier(data, "oracle", "mean").item() == 0.0


def test_answers_say_what_the_data_say():
    # The averaged law is 20 % better at the short dwell time and twice as bad at the long one.
    one = np.ones(60)
    ise = [[0.8 * one, 2.0 * one], [one, one], [0.7 * one, 0.99 * one], [0.5 * one, 0.5 * one]]
    which, mean, distribution = answers(made(ise))
    assert which.sentences[0] == (
        "Use the expected law if the distribution of the sojourns is known, otherwise the mean law."
    )
    assert "∫|x|² is 2.00 times the oracle’s, the geometric mean" in which.sentences[1]
    assert mean.sentences[0].startswith(
        "The averaged law (2) is better in 1 of 2 cells, the mean law (80) in 1; in 0 the "
    )
    won = "Where the averaged law wins, at dwell time 0.1 s, its ∫|x|² is 20 % less; there"
    assert mean.sentences[1].startswith(won)
    lost = "Where the mean law wins, at dwell time 0.2 s, its ∫|x|² is 50 % less; there"
    assert mean.sentences[2].startswith(lost)
    assert mean.sentences[3].startswith("Shorter dwell times favour the averaged law")
    assert mean.tables[0].rows[0][3:6] == ("0.800", "0.800", "0.800")
    assert "does better in all 2 cells and worse in 0" in distribution.sentences[0]
    assert distribution.duels == (("expected", "mean"),)


def test_regions_name_the_axes_that_cells_do_not_span():
    grid = {"sojourn": ["uniform", "fixed"], "delay": [0.5, 1.0, 2.0], "distance": [1.0]}
    mask = xr.DataArray(np.zeros((2, 3, 1), dtype=bool), grid, tuple(grid))
    mask[1, 0], mask[1, 2] = True, True
    assert region(mask) == "fixed sojourns, delay 0.5 or 2 s"
    assert region(~mask & False) == ""
    assert region(mask | True) == ""


# The report


def test_the_report_opens_with_the_answers_and_holds_every_map(small, tmp_path, monkeypatch):
    study, data = small
    monkeypatch.setattr("deadtime.reports.study.report.run_study", lambda *_: data)
    report = write_study(study, tmp_path / "out", command="deadtime study mine.toml")
    page = report.path.read_text(encoding="utf-8")
    assert page.index("Which law to use?") < page.index("When is the averaged law better")
    for answer in report.answers:
        for sentence in answer.sentences:
            assert sentence.replace(" %", "\u00a0%") in page
    figures = {path.stem for path in (tmp_path / "out" / "figures").glob("*.png")}
    assert figures == {path.stem for path in (tmp_path / "out" / "figures").glob("*.svg")}
    laws = [law.replace(", ", "-").replace(" ", "-") for law in study.laws]
    assert figures == {
        "lines", "averaged-over-mean", "mean-dwell-aware-over-mean", "winners-0", "winners-1",
        "winners-2", *(name for name in figures if name.startswith("expected-over-")),
        *(f"regret-{law}" for law in laws[:-1]), *(f"stabilised-{law}" for law in laws),
    }  # fmt: skip
    assert page.count("data:image/png;base64,") == len(figures)
    assert "deadtime study mine.toml" in page
    assert "Cells without a result" not in page
    record = json.loads((tmp_path / "out" / "metrics.json").read_text(encoding="utf-8"))
    assert len(record["cells"]) == study.size
    assert record["answers"][0]["sentences"] == list(report.answers[0].sentences)
    with (tmp_path / "out" / "data" / "cells.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == study.size * len(study.laws)
    first = record["cells"][0]
    assert float(rows[0]["regret"]) == pytest.approx(first["laws"]["averaged"]["regret"], rel=1e-5)


def test_the_command_runs_a_study_and_prints_its_answers(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    text = PLAIN.replace("[0.2, 0.8]", "0.8").replace("[0.5, 1.0]", "0.5")
    Path("mine.toml").write_text(
        text.replace(', "delay ignored"', "").replace(', "fixed"', ""), encoding="utf-8"
    )
    with pytest.raises(SystemExit) as stopped:
        main(["study", "mine.toml", "--scenarios", "6", "--workers", "1", "-o", "out"])
    captured = capsys.readouterr()
    assert (stopped.value.code, captured.err) == (0, "")
    assert "Which law to use?\n• Use the" in captured.out
    assert captured.out.endswith("Report: out/index.html\n")
    record = json.loads(Path("out/metrics.json").read_text(encoding="utf-8"))
    assert record["scenarios"] == 6


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["study", "none.toml"], "none.toml cannot be read"),
        (["study", "mine.toml", "--scenarios", "0"], "scenarios must be an integer of at least 1"),
        (["study", "mine.toml", "--workers", "0"], "workers must be an integer of at least 1"),
        (["study", "mine.toml", "--out", "/proc/x"], "folder '/proc/x' cannot be written"),
    ],
)
def test_bad_requests_get_one_line_and_code_2(tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    Path("mine.toml").write_text(PLAIN, encoding="utf-8")
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    error = capsys.readouterr().err
    assert stopped.value.code == 2
    assert error.count("\n") == 1
    assert message in error
