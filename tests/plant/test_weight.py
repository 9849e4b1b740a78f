"""The cost ∫ xᵀQx + uᵀRu: of runs, of batches, in designs, files, labels."""

import itertools
import re

import numpy as np
import pytest
import xarray as xr
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import deadtime as dt
import plants
from deadtime.imperfections import Noise, Saturation, WhiteDisturbance
from deadtime.numerics.exponential import energy_gramian
from deadtime.plant.weight import weight_of
from deadtime.problems.comparison import compare
from deadtime.problems.file import load_problem
from deadtime.reports.figures.design import plot_designs
from deadtime.reports.figures.monte_carlo import plot_monte_carlo
from deadtime.reports.verdict import verdict
from deadtime.scenarios.sweeps import load_study
from deadtime.switching import HalfSpace
from deadtime.synthesis.price import loop_cost

MODEL = plants.generic()
GAINS = plants.gains(MODEL)
TRUTH = dt.SwitchedSystem(1.02 * MODEL.A, 0.97 * MODEL.B, 0.251)
SIGNAL = dt.SwitchingSignal([0.0, 0.3718, 0.81, 1.3727, 1.8, 2.5234], [0, 2, 1, 0, 1, 2])
X0 = np.array([1.0, -0.5, 0.3])
Q = np.array([[2.0, 0.5, 0.0], [0.5, 1.0, -0.2], [0.0, -0.2, 0.1]])
R = np.array([[0.3, 0.1], [0.1, 0.2]])
WEIGHT = dt.Weight(Q, R)
LAWS = {
    "averaged": dt.AveragedPredictor(MODEL, GAINS),
    "dwell-aware": dt.AveragedPredictor(MODEL, GAINS, dwell_time=0.21),
    "expected": dt.ExpectedPredictor(MODEL, GAINS, dt.Markov(np.ones((3, 3)) - np.eye(3))),
    "oracle": dt.ExactPredictor(MODEL, GAINS),
}


def quadrature(run, plant, signal, step):
    """∫ xᵀQx + uᵀRu of a digital run's inputs, the plant integrated by SciPy between events."""
    end = run.end
    samples = np.arange(0.0, end, step)
    arrivals = np.concatenate((samples, samples + plant.delay, signal.times[1:], [end]))
    events = np.unique(np.round(arrivals[arrivals <= end], 12))
    u = run.inputs.T

    def held(t):
        return u[int(np.floor(t / step + 1e-9))] if t >= 0.0 else np.zeros(plant.inputs)

    z = np.append(run.states[:, 0], 0.0)
    for a, b in itertools.pairwise(events):
        middle = 0.5 * (a + b)
        mode, late, now = signal(middle), held(middle - plant.delay), held(middle)

        def field(t, z, mode=int(mode), late=late, now=now):
            x = z[:-1]
            return np.append(plant.A[mode] @ x + plant.B[mode] @ late, x @ Q @ x + now @ R @ now)

        z = solve_ivp(field, (a, b), z, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    return z[-1]


@pytest.mark.parametrize("name", LAWS)
def test_the_cost_of_a_run_is_that_of_an_integration_by_scipy(name):
    run = dt.simulate(TRUTH, LAWS[name], SIGNAL, X0, 3.03, 0.1)
    cost = run.metrics(WEIGHT)["cost"]
    assert cost == pytest.approx(quadrature(run, TRUTH, SIGNAL, 0.1), rel=1e-9)


def test_without_a_weight_or_with_the_identity_figures_are_the_same_to_the_last_bit():
    run = dt.simulate(TRUTH, LAWS["averaged"], SIGNAL, X0, 3.03, 0.1)
    plain = run.metrics()
    assert plain["cost"] == plain["ise"] + plain["energy"]
    assert run.metrics(dt.Weight()) == run.metrics(dt.Weight(np.eye(3), [1, 1])) == plain


def test_a_weight_changes_the_cost_and_nothing_else():
    run = dt.simulate(TRUTH, LAWS["averaged"], SIGNAL, X0, 3.03, 0.1)
    plain, weighed = run.metrics(), run.metrics(WEIGHT)
    assert weighed.pop("cost") != plain.pop("cost")
    assert weighed == plain


def sliding():
    """Two modes that push to x₁ = 0 from both sides, where the plant slides."""
    A = np.zeros((2, 3, 3))
    A[0, :2, 2], A[1, :2, 2] = [1.0, 1.0], [-1.0, 2.0]
    plant = dt.SwitchedSystem(A, np.zeros((2, 3, 1)), 0.25)
    law = dt.DelayedStateFeedback(plant, np.zeros((2, 1, 3)), allow_unstable=True)
    return dt.simulate(plant, law, HalfSpace([1.0, 0.0, 0.0]), [-0.5, 0.0, 1.0], 1.93, 0.1)


RUNS = {
    "ideal": lambda: dt.simulate(TRUTH, LAWS["averaged"], SIGNAL, X0, 3.03, None),
    "sliding": sliding,
    "disturbed": lambda: dt.simulate(
        TRUTH, LAWS["averaged"], SIGNAL, X0, 3.03, 0.1, imperfections=[WhiteDisturbance(0.1)]
    ),
    "noisy": lambda: dt.simulate(
        TRUTH, LAWS["averaged"], SIGNAL, X0, 3.03, 0.1, imperfections=[Noise(0.1)]
    ),
}


@pytest.mark.parametrize("name", RUNS)
def test_the_cost_of_every_kind_of_run_is_the_integral_of_its_states_and_inputs(name):
    run = RUNS[name]()
    R = 0.7 if run.plant.inputs == 1 else globals()["R"]
    weight = dt.Weight(Q, R)
    states = dt.Weight(Q, 0.0)
    edges = np.linspace(0.0, run.end, 6001)
    nodes, weights = np.polynomial.legendre.leggauss(3)
    width = np.diff(edges)[:, None] / 2.0
    time = (edges[:-1, None] + width * (1.0 + nodes)).ravel()
    x, u = run.record.states_at(time), run.record.inputs_at(time)
    density = np.einsum("ki,ij,kj->k", x, Q, x)
    parts = (width * weights).ravel()
    assert run.metrics(states)["cost"] == pytest.approx(parts @ density, rel=1e-4)
    density += np.einsum("ki,ij,kj->k", u, weight.of(run.plant).R, u)
    assert run.metrics(weight)["cost"] == pytest.approx(parts @ density, rel=1e-3)


@pytest.mark.parametrize("actuators", [(), (Saturation(-0.8, 0.8),)], ids=["free", "saturated"])
def test_a_batch_has_the_costs_of_runs_one_by_one(actuators):
    model = dt.Markov(2.0 * (np.ones((3, 3)) - np.eye(3)))
    signals = dt.draw_signals(model, 3.03 + TRUTH.delay, 7, 0, 11)
    data = dt.monte_carlo(
        TRUTH, LAWS, signals, X0, 3.03, 0.1, imperfections=actuators, weight=WEIGHT
    )
    assert data.attrs["one_by_one"] == []
    plain = dt.monte_carlo(TRUTH, LAWS, signals, X0, 3.03, 0.1, imperfections=actuators)
    for metric in set(plain) - {"cost"}:
        assert data[metric].equals(plain[metric])
    for name, law in LAWS.items():
        for i in (0, 4, 10):
            run = dt.simulate(TRUTH, law, signals[i], X0, 3.03, 0.1, imperfections=actuators)
            cost = data.cost.sel(law=name).values[i]
            assert cost == pytest.approx(run.metrics(WEIGHT)["cost"], rel=1e-11)


def test_a_batch_with_the_identity_is_one_without_a_weight():
    data = [
        dt.monte_carlo(TRUTH, LAWS, [SIGNAL], X0, 3.0, 0.1, weight=weight)
        for weight in (None, dt.Weight(1.0, 1.0))
    ]
    assert data[0].identical(data[1])


def test_trajectories_come_with_a_weight_as_without():
    data = dt.monte_carlo(TRUTH, LAWS, [SIGNAL], X0, 3.0, 0.1, trajectories=True, weight=WEIGHT)
    plain = dt.monte_carlo(TRUTH, LAWS, [SIGNAL], X0, 3.0, 0.1, trajectories=True)
    assert data.x.equals(plain.x)
    assert data.u.equals(plain.u)


@pytest.mark.parametrize("tau", [1e-3, 0.3, 4.0])
def test_the_gramian_with_q_is_van_loan_s_of_an_exponential(tau):
    A, B = MODEL.A[0], MODEL.B[0]
    Z, E = np.zeros((2, 5, 5))
    Z[:3, :3], Z[:3, 3:], E[:3, :3] = A, B, Q
    whole = expm(tau * np.block([[-Z.T, E], [np.zeros((5, 5)), Z]]))
    assert energy_gramian(A, B, tau, Q) == pytest.approx(whole[5:, 5:].T @ whole[:5, 5:], rel=1e-9)


def test_cost_does_not_depend_on_the_units_of_states_and_inputs():
    T, S = np.diag([10.0, 0.2, 3.0]), np.diag([4.0, 0.5])
    inverse, back = np.linalg.inv(T), np.linalg.inv(S)
    plant = dt.SwitchedSystem(T @ MODEL.A @ inverse, T @ MODEL.B @ back, MODEL.delay)
    law = dt.AveragedPredictor(plant, S @ GAINS @ inverse)
    weight = dt.Weight(inverse.T @ Q @ inverse, back.T @ R @ back)
    run = dt.simulate(plant, law, SIGNAL, T @ X0, 3.03, 0.1)
    other = dt.simulate(MODEL, LAWS["averaged"], SIGNAL, X0, 3.03, 0.1)
    assert run.metrics(weight)["cost"] == pytest.approx(other.metrics(WEIGHT)["cost"], rel=1e-10)


# --- design and the optimal law


def stable_law():
    plant = dt.SwitchedSystem(MODEL.A[:1], MODEL.B[:1], MODEL.delay)
    return plant, dt.SingleModePredictor(plant, GAINS[:1], 0)


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


# --- files

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


def test_a_study_measures_the_problem_s_cost_or_its_own(tmp_path):
    written(tmp_path)
    own = "[cost]\nQ = 2.0\nR = 3.0\n"
    paths = [written(tmp_path, STUDY + more, f"{len(more)}.toml") for more in ("", own)]
    problems, its = (dt.sweep(load_study(path), path.with_suffix(".zarr")) for path in paths)
    assert problems.cost.attrs["formula"] == "∫xᵀQx + uᵀRu, Q = diag(4, 1), R = 0.1"
    assert its.cost.attrs["formula"] == "∫xᵀQx + uᵀRu, Q = 2 I, R = 3"
    assert problems.ise.equals(its.ise)
    assert problems.energy.equals(its.energy)
    wanted = (2.0 * its.ise + 3.0 * its.energy).values
    assert its.cost.values == pytest.approx(wanted, rel=1e-9)
    assert not np.allclose(problems.cost.values, wanted, rtol=1e-3)


def test_a_study_sweeps_a_weight_by_its_path(tmp_path):
    written(tmp_path)
    path = written(tmp_path, STUDY.replace("delay = [0.2, 0.3]", "cost.R = [0.0, 2.0]"), "s.toml")
    data = dt.sweep(load_study(path), tmp_path / "s.zarr")
    assert data.cost.attrs["formula"] == "∫xᵀQx + uᵀRu, Q and R by cell"
    more = data.cost.sel({"cost.R": 2.0}) - data.cost.sel({"cost.R": 0.0})
    assert more.values == pytest.approx(2.0 * data.energy.isel({"cost.R": 0}).values, rel=1e-8)


def test_a_study_s_bad_cost_is_refused_with_its_line(tmp_path):
    written(tmp_path)
    path = written(tmp_path, STUDY + "[cost]\nQ = [1.0, 1.0, 1.0]\n", "s.toml")
    with pytest.raises(dt.StudyFileError, match=r"s.toml, line 8, \[cost\]: Q must have shape"):
        load_study(path)


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
    )
    wanted = (2.0 * data.ise + 0.5 * data.energy).values
    assert data.cost.values == pytest.approx(wanted, rel=1e-9)


# --- labels


def test_labels_say_which_cost_they_show_where_it_is_not_the_usual_one(tmp_path):
    for weight, label in (
        (None, "cost, ∫|x|² + |u|²  (x² s + u² s)"),
        (dt.Weight([4, 1, 1], 0.1), "cost, ∫xᵀQx + uᵀRu, Q = diag(4, 1, 1), R = 0.1 I"),
    ):
        data = dt.monte_carlo(TRUTH, LAWS, [SIGNAL], X0, 3.0, 0.1, weight=weight)
        assert plot_monte_carlo(data).axes[0].get_xlabel() == label
    data.drop_attrs(deep=False).to_netcdf(tmp_path / "data.nc", engine="scipy")
    with xr.open_dataset(tmp_path / "data.nc", engine="scipy") as again:
        assert again.cost.attrs == data.cost.attrs


def test_the_legend_of_designs_says_which_cost_they_have():
    plant = dt.SwitchedSystem([[[0.5]]], [[[1.0]]], delay=0.5)
    for weight, title in ((None, ""), (dt.Weight(4, 0.2), "cost: ∫xᵀQx + uᵀRu, Q = 4, R = 0.2")):
        found = dt.design(plant, delay_margin=0.1, step=0.1, budget=20, weight=weight)
        assert plot_designs({"one": found}).legends[0].get_title().get_text() == title


# --- bad weights


@pytest.mark.parametrize(
    ("Q", "R", "message"),
    [
        ([[1, 2], [3, 4]], 1, "Q must be symmetric"),
        ([[1, 0], [0, -1]], 1, "Q must be positive semidefinite, got an eigenvalue -1"),
        (1, -2, "R must be positive semidefinite, got an eigenvalue -2"),
        ([1, float("nan")], 1, "Q[1] must be finite, got nan"),
        (np.zeros((2, 3)), 1, "Q must have shape (n, n) = (2, 2), got (2, 3)"),
        (1, np.ones((1, 1, 1)), "R must have shape (m, m), (m,) or (), got 3 axes"),
        (1, [], "R must have shape (m, m), (m,) or (), got the empty shape (0,)"),
        ("much", 1, "Q must hold real numbers"),
        (0, 0, "Q and R must not both be 0"),
    ],
)
def test_a_weight_that_is_none_is_refused(Q, R, message):
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        dt.Weight(Q, R)


def test_a_weight_for_another_plant_is_refused_by_name():
    run = dt.simulate(TRUTH, LAWS["averaged"], SIGNAL, X0, 1.0, 0.1)
    with pytest.raises(
        dt.ArgumentError, match=re.escape("weight.Q must have shape (n, n) = (3, 3), got (2, 2)")
    ):
        run.metrics(dt.Weight(np.eye(2), 1.0))
    with pytest.raises(
        dt.ArgumentError, match=re.escape("weight.R must have shape (m, m) = (2, 2), got (1, 1)")
    ):
        dt.monte_carlo(TRUTH, LAWS, [SIGNAL], X0, 1.0, 0.1, weight=dt.Weight(1.0, [[1.0]]))


def test_what_is_no_weight_is_refused():
    with pytest.raises(
        dt.ArgumentError, match=r"weight must be a Weight\(Q, R\), got 3.0, a float"
    ):
        weight_of(3.0, TRUTH)
