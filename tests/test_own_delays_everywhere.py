"""Delays per mode and input, read by what runs, searches, estimates, exports and sweeps."""

import itertools
import json

import numpy as np
import pytest
import xarray as xr
from scipy.linalg import expm

import deadtime as dt
from c_code import Library, needs_compiler
from deadtime.cli.application import main
from deadtime.problems import load_problem
from deadtime.reports import plot_heat
from deadtime.scenarios.sweeps.axes import axis_of
from deadtime.scenarios.sweeps.load import load_study
from shares import mostly_long

STEP, HORIZON = 0.05, 4.0
DELAYS = np.array([[0.31, 0.12], [0.2, 0.05], [0.26, 0.17]])
RNG = np.random.default_rng(3)
A, B = 0.6 * RNG.normal(size=(3, 3, 3)), RNG.normal(size=(3, 3, 2))
PLANT = dt.SwitchedSystem(A, B, DELAYS)
TRUTH = dt.SwitchedSystem(1.02 * A, 0.97 * B, DELAYS + np.array([0.013, -0.02]))
K = dt.place(PLANT, [-1.0, -1.5, -2.0])
MEAN = dt.place(PLANT.mean(), [-1.0, -1.5, -2.0])[0]
MODEL = dt.Markov(np.full((3, 3), 0.8) * (1.0 - np.eye(3)))
SIGNAL = dt.SwitchingSignal.random(3, 9.0, dwell_time=0.23, seed=1)
X0 = np.array([1.0, -0.5, 0.3])
LAWS = {
    "averaged": dt.AveragedPredictor(PLANT, K),
    "dwell-aware": dt.AveragedPredictor(PLANT, K, dwell_time=0.23),
    "expected": dt.ExpectedPredictor(PLANT, K, MODEL),
    "optimal": dt.OptimalPredictor(PLANT, MODEL, np.eye(3), np.eye(2)),
    "low-pass": dt.LowPassPredictor(
        dt.MeanPredictor(PLANT, dt.place(PLANT.mean(), [-1.0, -1.5, -2.0])[0]), 0.1
    ),
    "oracle": dt.ExactPredictor(PLANT, K),
    "delay ignored": dt.DelayedStateFeedback(PLANT, K),
}


# Each law compiles a loop: at every change rows that know a mode's age, and what has no batch.
FEW = ["dwell-aware", "oracle"]


@pytest.mark.parametrize("names", mostly_long([list(LAWS), FEW], FEW))
def test_batches_are_runs_one_by_one(names):
    laws = {name: LAWS[name] for name in names}
    signals = [dt.SwitchingSignal.random(3, 9.0, dwell_time=0.07, seed=i) for i in range(9)]
    data = dt.monte_carlo(TRUTH, laws, signals, X0, HORIZON, STEP)
    assert data.attrs["one_by_one"] == ["oracle"]
    assert data.attrs["delay"] == TRUTH.delays.ravel().tolist()
    for name, law in laws.items():
        for i in (0, 4, 8):
            run = dt.simulate(TRUTH, law, signals[i], X0, HORIZON, STEP)
            for metric, value in run.metrics().items():
                found = data[metric].sel(law=name)[i].item()
                assert found == pytest.approx(value, rel=1e-10), (name, metric)


@pytest.mark.long
def test_the_optimal_law_costs_the_least_it_says_and_less_than_the_others():
    """The mean over signals with switches at samples is the least cost, to Monte Carlo's error."""
    law = LAWS["optimal"]
    signals = [MODEL.sample(12.0, seed=i) for i in range(400)]
    grid = [
        dt.SwitchingSignal(np.ceil(s.times / STEP - 1e-9) * STEP, s.modes)
        for s in signals
        if (np.diff(np.ceil(s.times / STEP - 1e-9)) > 0).all() and s.modes[0] == 0
    ]
    data = dt.monte_carlo(
        PLANT, {"optimal": law, "expected": LAWS["expected"]}, grid, X0, 12.0, STEP
    )
    costs = data.cost.sel(law="optimal").values
    least = law.least_cost(X0, 0, STEP)
    assert abs(costs.mean() - least) <= 5.0 * costs.std() / np.sqrt(costs.size) + 0.02 * least
    assert costs.mean() < data.cost.sel(law="expected").values.mean()


def lifted(mode, feedback):
    """The loop of one mode as one matrix, from the definition of a delay and SciPy."""
    n, m, row = 3, 2, feedback.row(mode, feedback.ages)
    W = max(feedback.taps, int(np.ceil(TRUTH.delays.max() / STEP)) + 1)
    L = np.zeros((n + W * m, n + W * m))
    L[n + m :, n:-m] = np.eye((W - 1) * m)
    L[n : n + m, :n] = feedback.state_gain[row]
    for j in range(feedback.taps):
        L[n : n + m, n + j * m : n + (j + 1) * m] = feedback.input_gain[row][j]
    arrivals = sorted({0.0, STEP, *(TRUTH.delays[mode] % STEP).tolist()})
    x = np.eye(n, n + W * m)
    for a, b in itertools.pairwise(arrivals):
        Z = np.zeros((n + m, n + m))
        Z[:n] = np.hstack((TRUTH.A[mode], TRUTH.B[mode]))
        E = expm(Z * (b - a))
        u = np.zeros((m, n + W * m))
        for j, delay in enumerate(TRUTH.delays[mode]):
            sample = int(np.floor((0.5 * (a + b) - delay) / STEP))
            u[j] = L[n + j] if sample == 0 else np.eye(n + W * m)[n + (-sample - 1) * m + j]
        x = E[:n, :n] @ x + E[:n, n:] @ u
    L[:n] = x
    return L


@pytest.mark.parametrize("name", ["averaged", "dwell-aware", "expected", "low-pass"])
def test_growth_rates_are_those_of_the_lifted_matrix_and_proved_bounds_hold_them(name):
    feedback = LAWS[name].digital(STEP)
    for mode in range(3):
        rate = np.log(np.abs(np.linalg.eigvals(lifted(mode, feedback))).max()) / STEP
        assert dt.growth_rate(TRUTH, LAWS[name], mode, STEP) == pytest.approx(rate, abs=1e-8)
        low, high = dt.growth_bounds(TRUTH, LAWS[name], mode, STEP)
        assert low - 1e-8 <= rate <= high + 1e-8


def test_a_worst_signal_grows_along_a_run_as_fast_as_it_says():
    worst = dt.falsify(TRUTH, LAWS["expected"], 0.23, STEP)
    run = worst.simulate(cycles=6)
    at = np.flatnonzero(np.abs(run.time / worst.length - np.rint(run.time / worst.length)) < 1e-9)
    size = np.log(np.linalg.norm(run.states[:, at], axis=0))
    np.testing.assert_allclose(np.diff(size), worst.growth_rate * worst.length, atol=1e-6)


@needs_compiler
def test_the_controller_in_python_and_in_c_gives_the_inputs_of_the_loop(tmp_path):
    law = LAWS["expected"]
    controller = dt.Controller(law, STEP)
    run = dt.simulate(TRUTH, law, SIGNAL, X0, HORIZON, STEP)
    pairs = zip(run.states.T, run.mode.tolist(), strict=True)
    answers = [controller.update(x, mode).copy() for x, mode in pairs]
    size = np.abs(run.inputs).max()
    np.testing.assert_allclose(np.transpose(answers), run.inputs, rtol=0.0, atol=1e-12 * size)
    controller.export_c(tmp_path)
    library = Library(tmp_path, PLANT)
    assert library.reset() == 0
    found = library.run(run.states.T, run.mode)[0]
    np.testing.assert_allclose(found.T, run.inputs, rtol=0.0, atol=1e-12 * size)


def test_an_observer_of_the_right_plant_forgets_its_first_error():
    C = np.eye(3)[:2]
    observer = dt.kalman(PLANT, C, np.eye(3), np.eye(2), step=STEP)
    law = dt.OutputFeedback(LAWS["expected"], observer)
    on_grid = dt.SwitchingSignal(np.round(SIGNAL.times / STEP) * STEP, SIGNAL.modes)
    run = dt.simulate(PLANT, law, on_grid, X0, 8.0, STEP)
    error = np.linalg.norm(run.estimates[:3] - run.states, axis=0)
    assert error[-1] <= 1e-6 * np.abs(run.states).max()


FILE = """
[plant]
delay = [[0.31, 0.12], [0.2, 0.05]]
A = [[[0.2, 1.0], [0.0, -0.2]], [[0.1, 1.0], [0.1, -0.3]]]
B = [[[0.0, 0.5], [1.0, 0.0]], [[0.1, 0.4], [1.1, 0.0]]]
[gains]
poles = [-1.0, -1.5]
[truth]
delay = [0.3, 0.1]
[signal]
kind = "random"
dwell_time = 0.4
[run]
x0 = [1.0, 0.0]
horizon = 3.0
step = 0.05
"""


def test_a_file_says_them_and_commands_take_it(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "own.toml"
    path.write_text(FILE, encoding="utf-8")
    problem = load_problem(path)
    assert problem.model.delays.tolist() == [[0.31, 0.12], [0.2, 0.05]]
    assert problem.plant.delays.tolist() == [[0.3, 0.1], [0.3, 0.1]]
    with pytest.raises(SystemExit) as done:
        main(("simulate", str(path), "--json"))
    assert not done.value.code
    assert json.loads(capsys.readouterr().out)


STUDY = """
problem = "own.toml"
laws = ["averaged"]
scenarios = 2
[grid]
"delay.1" = [0.05, 0.15]
delay_error = [0.0, 0.1]
"""


def test_a_study_s_grid_moves_the_delay_of_an_input(tmp_path):
    text = FILE.replace("[truth]\ndelay = [0.3, 0.1]\n", "")
    (tmp_path / "own.toml").write_text(text, encoding="utf-8")
    path = tmp_path / "study.toml"
    path.write_text(STUDY, encoding="utf-8")
    study = load_study(path)
    for cell in study.cells():
        loop, own = study.loop(cell), cell.values["delay.1"]
        model = loop.laws["averaged"].plant.delays
        assert model.tolist() == [[0.31, own], [0.2, own]]
        true = (1.0 + cell.values["delay_error"]) * model
        np.testing.assert_allclose(loop.plant.delays, true, rtol=1e-14)
    for grid, said in (
        ('"delay.7" = [0.1]', r"'7' is not there: it must be one of 0, 1"),
        ('delay = [0.1]\n"delay.1" = [0.1]', "delay.1 is overwritten by delay"),
    ):
        path.write_text(STUDY.split('"delay.1"')[0] + grid, encoding="utf-8")
        with pytest.raises(dt.DeadtimeError, match=said):
            load_study(path)


def test_sweeps_move_all_of_them_or_one():
    draft = {"plant": {"delay": [[0.4, 0.1], [0.2, 0.1]]}}
    axis_of("delay").write(draft, 0.8)
    assert draft["plant"]["delay"] == [[0.8, 0.2], [0.4, 0.2]]
    axis_of("plant.delay.1.0").write(draft, 0.5)
    assert draft["plant"]["delay"] == [[0.8, 0.2], [0.5, 0.2]]
    draft = {"plant": {"delay": [0.4, 0.1]}}
    axis_of("delay.1").write(draft, 0.3)
    table, one = {"plant": {"delay": [[0.4, 0.1], [0.2, 0.1]]}}, {"plant": {"delay": 0.4, "B": B}}
    axis_of("delay.1").write(table, 0.3)
    assert table["plant"]["delay"] == [[0.4, 0.3], [0.2, 0.3]]
    axis_of("delay.1").write(one, 0.3)
    assert one["plant"]["delay"] == [0.4, 0.3]
    axis_of("delay_error").write(draft, 0.5)
    assert draft["truth"]["delay"] == pytest.approx([0.6, 0.45])


def test_maps_name_the_delay_of_an_input_in_full_beside_low_panels():
    axis = axis_of("delay.1")
    about = {"long_name": axis.label, "units": axis.unit}
    values = np.arange(8.0).reshape(2, 2, 1, 2)
    dims = ("delay.1", "dwell_time", "law", "scenario")
    data = xr.Dataset(
        {
            "ise": (dims, values, {"units": "x^2 s"}),
            "diverged": (dims, values < 0.0),
            "reason": (dims[:3], np.full((2, 2, 1), "", dtype=object)),
            "done": (dims[:2], np.ones((2, 2), dtype=bool)),
        },
        {"delay.1": ("delay.1", [0.2, 0.8], about), "dwell_time": [1.0, 2.0], "law": ["mean"]},
    )
    panel = plot_heat(data, "mean").axes[0]
    assert panel.get_ylabel().split() == ["delay", "of", "input", "1", "(s)"]
