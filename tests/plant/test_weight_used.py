"""Designs, problem files, studies and labels use the weight that they are given."""

import numpy as np
import pytest
import xarray as xr

import deadtime as dt
import plants
from deadtime.problems.comparison import compare
from deadtime.problems.file import load_problem
from deadtime.reports.design import plot_designs
from deadtime.reports.figures.monte_carlo import plot_monte_carlo
from deadtime.reports.verdict import verdict
from deadtime.scenarios.sweeps import load_study
from deadtime.synthesis.design_measures import cost_and_growth
from weighted import GAINS, LAWS, MODEL, SIGNAL, TRUTH, WEIGHT, X0, Q, R


def loop_cost(plant, feedback, mode, weight=None):
    return cost_and_growth(plant, feedback, mode, weight=weight)[0]


def stable_law():
    plant = dt.SwitchedSystem(MODEL.A[:1], MODEL.B[:1], MODEL.delay)
    return plant, dt.SingleModePredictor(plant, GAINS[:1], 0)


# --- design and the optimal law


@pytest.mark.long
def test_the_cost_of_a_constant_mode_is_the_mean_of_runs_from_the_unit_vectors():
    plant, law = stable_law()
    signal = dt.SwitchingSignal.constant(0)
    runs = [dt.simulate(plant, law, signal, x0, 40.0, 0.1) for x0 in np.eye(3)]
    mean = np.mean([run.metrics(WEIGHT)["cost"] for run in runs])
    found = loop_cost(plant, law.digital(0.1), 0, WEIGHT)
    assert found == pytest.approx(mean, rel=1e-9)
    assert found != pytest.approx(loop_cost(plant, law.digital(0.1), 0), rel=1e-2)


def test_the_optimal_law_s_least_cost_is_the_cost_of_its_run_where_modes_are_alike():
    plant = plants.identical(modes=2)
    law = dt.OptimalPredictor(plant, dt.Markov([[0, 1], [1, 0]]), Q + 0.1 * np.eye(3), R)
    run = dt.simulate(plant, law, dt.SwitchingSignal.constant(0), X0, 40.0, 0.1)
    least = law.least_cost(X0, 0, 0.1)
    assert run.metrics(law.weight)["cost"] == pytest.approx(least, rel=1e-8)


def test_design_starts_from_the_weight_s_own_gains_and_prices_by_it():
    plant = dt.SwitchedSystem([[[0.5]]], [[[1.0]]], delay=0.5)
    weight = dt.Weight(4.0, 0.2)
    found = dt.design(plant, delay_margin=0.1, step=0.05, budget=30, weight=weight)
    plain = dt.SingleModePredictor(plant, dt.lqr(plant, [[4.0]], [[0.2]]), 0).digital(0.05)
    assert found.plain.cost == pytest.approx(loop_cost(plant, plain, 0, weight.of(plant)))
    assert found.weight is not None
    assert dt.design(plant, delay_margin=0.1, step=0.05, budget=30).weight is None


def test_design_refuses_a_weight_that_does_not_see_a_loop_grow():
    plant = dt.SwitchedSystem([np.diag([0.5, 0.3])], [np.eye(2)], delay=0.5)
    for weight, message in (
        (
            dt.Weight([1.0, 0.0], 1.0),
            "weight.Q must weigh what does not decay, but of mode 0 it does not see",
        ),
        (dt.Weight(1.0, [1.0, 0.0]), "weight.R must be positive definite"),
    ):
        with pytest.raises(dt.ArgumentError, match=message):
            dt.design(plant, delay_margin=0.1, gains=[-2.0 * np.eye(2)], weight=weight)


def test_robustness_measures_the_cost_that_it_is_given():
    plant = dt.SwitchedSystem([[[0.5]]], [[[1.0]]], 0.3)
    law = dt.SingleModePredictor(plant, dt.place(plant, [-2.0]), 0)
    signal = dt.SwitchingSignal.constant(0)
    results = [
        dt.robustness(plant, law, signal, [1.0], 5.0, 0.1, scenarios=2, weight=weight)
        for weight in (None, dt.Weight(3.0, 3.0))
    ]
    assert results[1].noise.base == pytest.approx(3.0 * results[0].noise.base)
    assert results[0].weight is None
    assert results[1].weight is not None


FILE = """\
[plant]
delay = 0.3
A = [[[0.0, 1.0], [-1.0, 0.2]], [[0.0, 1.0], [-1.3, 0.3]]]
B = [[[0.0], [1.0]], [[0.0], [1.1]]]
[gains]
poles = [-1.0, -2.0]
[cost]
Q = [4.0, 1.0]
R = 0.1
[switching]
kind = "markov"
rates = [[0.0, 1.0], [1.0, 0.0]]
[[law]]
kind = "averaged"
[[law]]
kind = "optimal"
[[law]]
kind = "delayed"
[signal]
kind = "periodic"
sojourns = [0.52, 0.7]
modes = [0, 1]
[run]
x0 = [1.0, 0.0]
horizon = 6.0
step = 0.05
"""


def written(tmp_path, text=FILE, name="problem.toml"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


# --- files


def test_a_file_s_cost_is_what_laws_are_compared_by_and_what_the_optimal_law_minimises(tmp_path):
    problem = load_problem(written(tmp_path))
    assert np.array_equal(problem.weight.Q, np.diag([4.0, 1.0]))
    law = problem.laws["optimal"]
    assert np.array_equal(law.Q, np.diag([4.0, 1.0]))
    assert law.R.item() == 0.1
    result = compare(problem)
    run = result.runs["averaged"]
    assert result.metrics["averaged"] == run.metrics(dt.Weight([4, 1], 0.1))
    sentences = verdict(result)
    assert "The cost is ∫xᵀQx + uᵀRu, Q = diag(4, 1), R = 0.1." in sentences
    assert any("the cost (∫xᵀQx + uᵀRu, Q = diag(4, 1), R = 0.1) of" in one for one in sentences)


def test_a_file_without_a_cost_has_the_usual_one(tmp_path):
    text = FILE.replace("[cost]\nQ = [4.0, 1.0]\nR = 0.1\n", "")
    problem = load_problem(written(tmp_path, text))
    assert problem.weight is None
    assert "∫xᵀQx" not in " ".join(verdict(compare(problem)))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "Q = [4.0, 1.0]",
            "Q = [4.0, 1.0, 2.0]",
            r"problem.toml, line 8, \[cost\]: Q must have shape \(n, n\) = \(2, 2\), got \(3, 3\)",
        ),
        ("R = 0.1", "R = -0.1", r"problem.toml, line 9, \[cost\]: R must be positive semidefinite"),
        ("R = 0.1", "R = nan", r"problem.toml, line 9, \[cost\]: R must be finite"),
        ("R = 0.1", "S = 0.1", r"problem.toml, line 9: cost.S is not known"),
        (
            "Q = [4.0, 1.0]",
            "Q = [[4.0, 1.0], [0.0, 1.0]]",
            r"problem.toml, line 8, \[cost\]: Q must be symmetric",
        ),
    ],
)
def test_a_bad_cost_is_refused_with_its_line(tmp_path, old, new, message):
    with pytest.raises(dt.ProblemFileError, match=message):
        load_problem(written(tmp_path, FILE.replace(old, new)))


STUDY = """\
problem = "problem.toml"
horizon = 3.0
scenarios = 3
laws = ["averaged", "delay ignored"]
[grid]
delay = [0.2, 0.3]
"""


@pytest.mark.long
def test_a_study_measures_the_problem_s_cost_or_its_own(tmp_path):
    written(tmp_path)
    own = "[cost]\nQ = 2.0\nR = 3.0\n"
    paths = [written(tmp_path, STUDY + more, f"{len(more)}.toml") for more in ("", own)]
    problems, its = (
        dt.sweep(load_study(path), path.with_suffix(".zarr"), workers=1) for path in paths
    )
    assert problems.cost.attrs["formula"] == "∫xᵀQx + uᵀRu, Q = diag(4, 1), R = 0.1"
    assert its.cost.attrs["formula"] == "∫xᵀQx + uᵀRu, Q = 2 I, R = 3"
    assert problems.ise.equals(its.ise)
    assert problems.energy.equals(its.energy)
    wanted = (2.0 * its.ise + 3.0 * its.energy).values
    assert its.cost.values == pytest.approx(wanted, rel=1e-9)
    assert not np.allclose(problems.cost.values, wanted, rtol=1e-3)


def test_a_study_sweeps_a_weight_by_its_path(tmp_path):
    written(tmp_path)
    text = STUDY.replace("delay = [0.2, 0.3]", "cost.R = [0.0, 2.0]")
    path = written(tmp_path, text.replace(', "delay ignored"', ""), "s.toml")
    data = dt.sweep(load_study(path), tmp_path / "s.zarr", workers=1)
    assert data.cost.attrs["formula"] == "∫xᵀQx + uᵀRu, Q and R by cell"
    more = data.cost.sel({"cost.R": 2.0}) - data.cost.sel({"cost.R": 0.0})
    assert more.values == pytest.approx(2.0 * data.energy.isel({"cost.R": 0}).values, rel=1e-8)


def test_a_study_s_bad_cost_is_refused_with_its_line(tmp_path):
    written(tmp_path)
    path = written(tmp_path, STUDY + "[cost]\nQ = [1.0, 1.0, 1.0]\n", "s.toml")
    with pytest.raises(dt.StudyFileError, match=r"s.toml, line 8, \[cost\]: Q must have shape"):
        load_study(path)


@pytest.mark.long
def test_a_study_in_python_takes_a_weight(tmp_path):
    def loop(gain):
        plant = dt.SwitchedSystem([[[0.5]], [[0.3]]], [[[1.0]], [[1.0]]], 0.2)
        laws = {"mine": dt.AveragedPredictor(plant, dt.place(plant, [-gain]))}
        model = dt.Markov([[0, 2], [2, 0]])
        weight = dt.Weight(2.0, 0.5)
        return {
            "plant": plant,
            "laws": laws,
            "model": model,
            "x0": [1],
            "horizon": 3,
            "step": 0.1,
            "weight": weight,
        }

    data = dt.sweep(
        dt.function_study(loop, {"gain": [1.0, 2.0]}, scenarios=3),
        tmp_path / "python.zarr",
        workers=1,
    )
    wanted = (2.0 * data.ise + 0.5 * data.energy).values
    assert data.cost.values == pytest.approx(wanted, rel=1e-9)


# --- labels


def test_labels_say_which_cost_they_show_where_it_is_not_the_usual_one(tmp_path):
    for weight, label in (
        (None, "cost, ∫|x|² + |u|²  (x² s + u² s)"),
        (dt.Weight([4, 1, 1], 0.1), "cost, ∫xᵀQx + uᵀRu, Q = diag(4, 1, 1), R = 0.1 I"),
    ):
        laws = {"averaged": LAWS["averaged"]}
        data = dt.monte_carlo(TRUTH, laws, [SIGNAL], X0, 3.0, 0.1, weight=weight)
        assert plot_monte_carlo(data).axes[0].get_xlabel() == label
    data.drop_attrs(deep=False).to_netcdf(tmp_path / "data.nc", engine="scipy")
    with xr.open_dataset(tmp_path / "data.nc", engine="scipy") as again:
        assert again.cost.attrs == data.cost.attrs


def test_the_legend_of_designs_says_which_cost_they_have():
    plant = dt.SwitchedSystem([[[0.5]]], [[[1.0]]], delay=0.5)
    for weight, title in ((None, ""), (dt.Weight(4, 0.2), "cost: ∫xᵀQx + uᵀRu, Q = 4, R = 0.2")):
        found = dt.design(plant, delay_margin=0.1, step=0.1, budget=20, weight=weight)
        assert plot_designs({"one": found}).legends[0].get_title().get_text() == title
