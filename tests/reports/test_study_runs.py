"""What a study says is what is run, law by law; what it cannot mean is refused by line and key."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import expon

import deadtime as dt
from deadtime.cli.application import main
from deadtime.problems.law_registry import LEVELS
from deadtime.problems.switching_registry.entries.switching_models import SemiMarkovSwitching
from deadtime.reports.study import run_study
from deadtime.reports.study.answers import answers
from deadtime.reports.study.findings import best, summary
from deadtime.reports.study.study_data import failures
from deadtime.scenarios.sweeps import load_study
from deadtime.scenarios.sweeps.axes import FAMILIES, kinds_of, sojourn_section, within
from deadtime.scenarios.sweeps.cell import run_cell
from small_study import PLAIN, load

SHIPPED = Path(__file__).parents[2] / "studies" / "paper.toml"


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


def test_a_plant_of_delays_of_its_own_stands_at_the_longest_as_the_axis_has_it(tmp_path):
    text = """[plant]
        A = [[[-1.0]], [[-2.0]]]
        B = [[[1.0]], [[1.0]]]
        delay = [[0.1], [0.2]]
        [gains]
        poles = [-3.0]
        [signal]
        kind = "random"
        dwell_time = 0.4
        [run]
        x0 = [1.0]
        horizon = 2.0
        step = 0.1"""
    (tmp_path / "own.toml").write_text(text, encoding="utf-8")
    given = 'problem = "own.toml"\npoles = [-3]\nlaws = ["mean"]\nscenarios = 2\n[grid]\n'
    study = load(tmp_path, f"{given}dwell_time = 0.4")
    data = run_study(study, tmp_path / "study.zarr", workers=1)
    assert data.delay.values.tolist() == [0.2]
    moved = load(tmp_path, f"{given}dwell_time = 0.4\ndelay = 0.2")
    same = run_study(moved, tmp_path / "moved.zarr", workers=1)
    np.testing.assert_array_equal(data.ise, same.ise)


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
    model = section.model(2, Path())
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
        name
        for name in kinds_of(2)
        if "minimax" not in name  # tests/laws/test_minimax.py
        and "belief" not in name  # which needs a [mode_filter]
    )
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


@pytest.mark.long
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


@pytest.mark.long
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
