"""`deadtime monte-carlo`, its table and its picture."""

import csv
import json
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest
import xarray as xr

import deadtime as dt
from certified_loops import MILD_FILE
from deadtime.cli.application import main
from deadtime.reports.figures.monte_carlo import plot_monte_carlo
from deadtime.reports.figures.sweeps.reduction import quantiles
from deadtime.reports.scenario_tables import summary

COARSE = ("--step", "0.05", "--out", "run.png")
DIMS = ("law", "scenario")


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as stopped:
        main(("monte-carlo", *arguments))
    captured = capsys.readouterr()
    return stopped.value.code, captured.out, captured.err


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def data():
    """What the command runs by default, but for fewer scenarios of a coarser step."""
    from scipy.stats import expon

    problem = dt.problems.paper()
    model = dt.SemiMarkov(expon(loc=0.2, scale=0.2), modes=2)
    return dt.monte_carlo(
        problem.plant, problem.laws, model, problem.x0, problem.horizon, 0.05, scenarios=21, seed=4
    )


def made_up(cost, lost=None, laws=("averaged", "mean", "oracle")):
    """A dataset with these costs, and half of each as ∫|x|²."""
    cost = np.array(cost, dtype=float)
    lost = np.zeros(cost.shape, bool) if lost is None else np.array(lost, bool)
    metrics = {"cost": (DIMS, cost), "ise": (DIMS, cost / 2.0), "diverged": (DIMS, lost)}
    return xr.Dataset(metrics, {"law": list(laws[: len(cost)])})


def test_json_and_both_files_are_those_of_the_library(data, capsys):
    count = ("--scenarios", "21", "--seed", "4", "--json")
    code, out, err = run(capsys, "paper", *COARSE, *count, "--data", "all.nc")
    assert (code, err) == (0, "")
    printed = json.loads(out)
    assert (printed["dwell_time"], printed["mean_sojourn"]) == (0.2, 0.4)
    assert (printed["scenarios"], printed["interrupted"]) == (21, False)
    oracle = data.cost.sel(law="oracle").values
    for record in printed["laws"]:
        cost = data.cost.sel(law=record["law"]).values
        ise = data.ise.sel(law=record["law"]).values
        assert list(record["cost"].values()) == pytest.approx(np.quantile(cost, (0.05, 0.5, 0.95)))
        assert list(record["ise"].values()) == pytest.approx(np.quantile(ise, (0.05, 0.5, 0.95)))
        assert record["best"] == np.mean(cost == data.cost.values.min(axis=0))
        assert record["relative"] == pytest.approx(np.median(cost / oracle))
    with xr.open_dataset("all.nc", engine="scipy") as read:
        for name in data.data_vars:
            np.testing.assert_array_equal(read[name].values, data[name].values)
        assert list(read.law.values) == list(data.law.values)
        assert (read.attrs["step"], read.attrs["imperfections"]) == (0.05, "")


def test_text_has_a_row_for_each_law_and_csv_a_row_for_each_run(data, folder, capsys):
    arguments = ("--scenarios", "21", "--seed", "4", "--data", "all.csv")
    code, out, err = run(capsys, "paper", *COARSE, *arguments)
    assert (code, err) == (0, "")
    text = " ".join(out.split())
    assert "21 random signals, sojourns of 0.2 s + Exp(0.2 s), 15 s each" in text
    assert "law 5 % median 95 % wins / oracle growing runs" in text
    assert "law median 95 % interval / oracle 95 % interval" in text
    assert text.startswith("Least median cost, the oracle aside: ")
    tables = out.partition("\nCost")[2].partition("\n•")[0]
    assert all(tables.count(f"\n{law} ") == 3 for law in data.law.values)
    assert out.rstrip().endswith("Figure: run.png\nData: all.csv")
    assert (folder / "run.png").read_bytes().startswith(b"\x89PNG")
    with open("all.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == data.law.size * 21
    for row in rows:
        one = data.sel(law=row.pop("law"), scenario=int(row.pop("scenario")))
        assert row.pop("diverged") == str(one.diverged.item())
        assert {name: float(text) for name, text in row.items()} == {
            name: one[name].item() for name in row
        }


def test_sojourns_are_those_asked_for(capsys, monkeypatch):
    asked = []

    def stopped(plant, laws, model, *arguments, **options):
        asked.append(model)
        raise dt.ArgumentError("enough.")

    monkeypatch.setattr(import_module("deadtime.scenarios.batch_run"), "compare", stopped)
    run(capsys, "three-mode", "--dwell-time", "0.5", "--mean-sojourn", "2")
    run(capsys, "follower")
    for model, (dwell, mean) in zip(asked, ((0.5, 2.0), (1.0, 2.0)), strict=True):
        sojourn = model.sojourn[0]
        assert sojourn.cdf(dwell) == 0.0 < sojourn.cdf(1.001 * dwell)
        assert sojourn.mean() == pytest.approx(mean)
    assert [model.modes for model in asked] == [3, 2]
    np.testing.assert_allclose(asked[0].transition, (1.0 - np.eye(3)) / 2.0)


@pytest.mark.parametrize("at", ["anywhere", "samples"])
def test_signals_of_an_average_dwell_time_switch_no_more_often_than_it_says(
    capsys, monkeypatch, tmp_path, at
):
    asked = []

    def stopped(plant, laws, model, *arguments, **options):
        asked.append(model)
        raise dt.ArgumentError("enough.")

    monkeypatch.setattr(import_module("deadtime.scenarios.batch_run"), "compare", stopped)
    file, (before, after) = tmp_path / "p.toml", MILD_FILE.split("[signal]")
    run_section = after[after.index("[run]") :]
    averaged = f'kind = "random"\naverage_dwell_time = 0.6\nchatter = 3\nat = "{at}"\n'
    file.write_text(f"{before}[signal]\n{averaged}{run_section}", encoding="utf-8")
    run(capsys, str(file))
    signals = [asked[0].sample(600.0, seed=seed) for seed in range(3)]
    assert all(signal.average_dwell_time(chatter=3) >= 0.6 - 1e-9 for signal in signals)
    assert all(400 < signal.switches < 600 for signal in signals)  # of 1.2 s in the mean


def test_the_nominal_plant_is_named_and_laws_run_one_by_one_have_a_reason(capsys, folder, tmp_path):
    uncertain = f"[uncertainty]\ncovariance = {np.diag([1e-4] * 5).tolist()}\n[gains]"
    late = "delay = [[0.234], [0.2]]"
    pushed = '[[imperfection]]\nkind = "white-disturbance"\nintensity = 0.01\n'
    text = MILD_FILE.replace("[gains]", uncertain)
    (folder / "own.toml").write_text(text, encoding="utf-8")
    nominal = "The nominal plant was run, not those of [uncertainty]"
    for command in ("simulate", "monte-carlo"):
        more = ("--scenarios", "2") if command == "monte-carlo" else ()
        with pytest.raises(SystemExit):
            main((command, "own.toml", "--out", "run.png", *more))
        out = " ".join(capsys.readouterr().out.split())
        assert nominal in out
        assert "one by one" not in out
    text = MILD_FILE.replace("delay = 0.234", late) + pushed
    (folder / "pushed.toml").write_text(text, encoding="utf-8")
    _, out, _ = run(capsys, "pushed.toml", "--scenarios", "2", "--out", "run.png")
    out = " ".join(out.split())
    assert nominal not in out
    assert "one by one, which is slower: averaged, because the plant is disturbed and its" in out


def test_a_plant_with_a_delay_per_input_and_mode_and_a_chain_at_samples(capsys, folder):
    (folder / "own.toml").write_text("""
[plant]
A = [[[-0.1]], [[-0.2]], [[-0.3]]]
B = [[[1.0, -4.0]], [[0.8, -4.0]], [[0.7, -3.0]]]
delay = [[0.3, 0.1], [0.25, 0.1], [0.27, 0.12]]
[gains]
lqr = { Q = [[1.0]], R = [[1.0, 0.0], [0.0, 1.0]] }
[[law]]
kind = "averaged"
[switching]
kind = "markov-chain"
P = [[0.9, 0.1, 0.0], [0.0, 0.9, 0.1], [0.1, 0.0, 0.9]]
step = 0.05
[signal]
kind = "model"
seed = 1
[run]
x0 = [1.0]
horizon = 2.0
step = 0.05
""")
    arguments = ("--scenarios", "4", "--out", "run.png", "--data", "own.nc")
    code, out, err = run(capsys, "own.toml", *arguments)
    assert (code, err) == (0, "")
    assert "Every signal switches at samples only, but only so: from mode 0 to mode 1, " in out
    with xr.open_dataset("own.nc", engine="scipy") as read:
        assert read.attrs["delay"] == "0.3; 0.1; 0.25; 0.1; 0.27; 0.12"


@pytest.mark.few(1)
@pytest.mark.parametrize("ending", ["text", "json"])
def test_interrupted_it_prints_and_saves_what_is_done(capsys, monkeypatch, ending):
    @contextmanager
    def interrupting(progress, scenarios):
        def report(done, total):
            raise KeyboardInterrupt

        yield report

    module = import_module("deadtime.scenarios.batch_run")
    monkeypatch.setattr(module, "show_progress", interrupting)
    monkeypatch.setattr(module, "_BLOCK", 8)
    flags = ("--json",) if ending == "json" else ()
    arguments = ("--scenarios", "80", "--data", "part.nc", *flags)
    code, out, err = run(capsys, "paper", *COARSE, *arguments)
    assert code == 130
    with xr.open_dataset("part.nc", engine="scipy") as read:
        done = read.sizes["scenario"]
    assert 8 <= done < 80
    assert err == (f"deadtime: interrupted after {done} of 80 scenarios; the results cover these\n")
    if ending == "json":
        assert (json.loads(out)["scenarios"], json.loads(out)["interrupted"]) == (done, True)
    else:
        assert f"{done} random signals" in out


def test_interrupted_before_the_first_scenario_it_says_so(capsys, monkeypatch):
    place = import_module("deadtime.scenarios.batch_run")

    def interrupted(run, scenarios, *arguments):
        return 0, True

    monkeypatch.setattr(place, "run_blocks", interrupted)
    assert run(capsys, "paper") == (130, "", "deadtime: interrupted\n")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"step": None}, "is ideal, and Monte Carlo runs sampled loops: give a sampling period"),
        (
            {"signal": dt.HalfSpace([1.0, 0.0])},
            "is switched by its state, not by random signals: use deadtime",
        ),
        (
            {"plant": dt.SwitchedSystem([[[1.0]]], [[[1.0]]], 1.0), "modes": ("one",)},
            "has one mode, so no signal switches it: use deadtime simulate",
        ),
        (
            {"signal": dt.SwitchingSignal.constant(0), "signals": dt.SignalClass()},
            "so it has no dwell time",
        ),
        ({"u0": 1.0}, "must have u0 = 0"),
        ({"predict": "commanded"}, 'predict = "applied"'),
    ],
)
def test_problems_that_have_no_random_signals_are_refused(capsys, monkeypatch, changes, message):
    changed = replace(dt.problems.paper(), name="mine", **changes)
    monkeypatch.setitem(dt.problems.NAMED, "mine", lambda: changed)
    monkeypatch.setattr("deadtime.problems.templates.NAMES", ("mine",))
    code, out, err = run(capsys, "mine")
    assert (code, out) == (2, "")
    assert message in err
    assert "'mine'" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--data", "all.parquet"], "data must end in .nc or .csv, got 'all.parquet'"),
        (["--data", "no/all.nc"], "data 'no/all.nc' cannot be written: there is no folder 'no'"),
        (["--data", "old.nc"], "data 'old.nc' cannot be written: it is a folder"),
        (["--out", "run.gif"], "out must end in .png or .svg or .pdf or .pgf, got 'run.gif'"),
        (["--out", "no/run"], "out 'no/run.png' cannot be written: there is no folder 'no'"),
        (["--step", "-1"], "step must be positive"),
        (["--dwell-time", "-1"], "dwell_time must be positive, in s, or 0 with a --mean-sojourn"),
        (["--mean-sojourn", "0.2"], "mean_sojourn must be above the dwell time, 0.2 s, got 0.2"),
        (["--scenarios", "0"], "scenarios must be an integer of at least 1, got 0"),
        (["--seed", "-1"], "seed must be an integer of at least 0, got -1"),
    ],
)
def test_requests_that_are_wrong_are_refused_before_the_run(folder, capsys, arguments, message):
    (folder / "old.nc").mkdir()
    code, out, err = run(capsys, "paper", *arguments)
    assert (code, out) == (2, "")
    assert message in err


@pytest.mark.long
def test_a_disk_that_fails_is_told_by_name(capsys, monkeypatch):
    def full(*arguments, **options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(xr.Dataset, "to_netcdf", full)
    code, out, err = run(capsys, "paper", *COARSE, "--data", "all.nc")
    assert code == 2
    assert "data 'all.nc' cannot be written: No space left on device." in err
    assert "averaged" in out  # what was computed is not lost with the file


def test_a_diverged_run_is_infinitely_dear():
    cost = [[1.0, 1.0, 1.0, 4.0], [2.0, 1.0, 8.0, 0.5], [1.0, 2.0, 4.0, 9.0]]
    lost = [[0, 0, 1, 1], [0, 0, 0, 1], [0, 0, 0, 1]]
    result = summary(made_up(cost, lost))
    averaged, mean, oracle = result.laws
    assert (result.reference, averaged.diverged) == ("oracle", 2)
    # Scenario 0: averaged and oracle tie; 1: averaged and mean tie; 2: oracle; 3: nobody.
    assert [law.best for law in result.laws] == [0.5, 0.25, 0.5]
    assert averaged.cost[1:] == (np.inf, np.inf)
    assert averaged.ise[0] == 0.5
    assert (mean.relative, oracle.cost[1]) == (2.0, 3.0)
    assert averaged.relative == np.inf
    record = result.records()[0]
    assert (record["cost"]["median"], record["relative"]) == (None, None)
    assert result.rows()[0] == ["averaged", "1.00", "∞", "∞", "50.0 %", "∞", "2"]


def test_without_an_oracle_the_first_law_is_the_reference():
    result = summary(made_up([[1.0, 2.0], [3.0, 0.0]], laws=("mean", "averaged")))
    assert result.reference == "mean"
    assert [law.relative for law in result.laws] == [1.0, 1.5]


def test_quantiles_are_those_of_numpy_where_all_is_finite():
    values = np.random.default_rng(0).lognormal(size=40)
    levels = (0.05, 0.5, 0.95)
    np.testing.assert_array_equal(quantiles(values, levels), np.quantile(values, levels))


@pytest.mark.parametrize("draw", [summary, plot_monte_carlo])
def test_no_scenario_is_refused(draw):
    with pytest.raises(dt.ArgumentError, match="data must hold at least one scenario, got none"):
        draw(made_up(np.ones((2, 0))))


def test_curves_are_distribution_functions_and_axes_leave_out_what_is_far(data):
    figure = plot_monte_carlo(data, "Costs in $")
    left, right = figure.axes
    low, high = left.get_xlim()
    for line, law in zip(left.lines, data.law.values, strict=True):
        cost = data.cost.sel(law=law).values
        x, share = line.get_data()
        for at in np.quantile(cost[cost < high], (0.1, 0.9)) if (cost < high).any() else ():
            drawn = share[np.searchsorted(x, at, side="right") - 1]
            assert drawn == pytest.approx(100.0 * np.mean(cost <= at))
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert [label for label in labels if "off the axes" in label] == [
        "delay ignored (off the axes)"
    ]
    assert low < data.cost.sel(law="oracle").values.min() < high < 1e10
    assert right.get_xlim()[0] < 1.0 < right.get_xlim()[1]


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("cost", "lost"),
    [
        (np.ones((3, 4)), None),
        (np.zeros((3, 4)), None),
        (np.ones((3, 4)), np.ones((3, 4))),
        ([[1.0], [1e90], [3.0]], [[0], [0], [1]]),
    ],
    ids=["equal", "zero", "all diverged", "one scenario, reference diverged"],
)
def test_odd_costs_have_a_picture_too(folder, cost, lost):
    plot_monte_carlo(made_up(cost, lost)).savefig("odd.png")
    assert (folder / "odd.png").stat().st_size > 1000


def test_a_law_alone_is_compared_with_nothing(folder, capsys):
    code, out, err = run(capsys, "paper", *COARSE, "--law", "mean", "--scenarios", "21")
    assert (code, err) == (0, "")
    assert "/ mean" not in out
    assert "best on" not in out
    assert "law median 95 % interval" in " ".join(out.split())
