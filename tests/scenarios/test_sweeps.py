"""Sweeps: studies, their cells, the store, resuming, and the command."""

import functools
import importlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
import pytest
import xarray as xr
from scipy.stats import expon

import deadtime as dt
from deadtime.cli.entry import main
from deadtime.cli.sweep import Lines
from deadtime.scenarios.sweeps import Progress, load_study, store
from deadtime.scenarios.sweeps.axes import AXES
from deadtime.scenarios.sweeps.cell import run_cell
from deadtime.scenarios.sweeps.layout import Layout, layout_of
from deadtime.scenarios.sweeps.run import prepare, run_block
from deadtime.scenarios.sweeps.store import create, open_store

# Three modes, two inputs, a delay that is no multiple of the period; laws with gains of their own.
PROBLEM = """\
title = "Three modes"

[plant]
delay = 0.234
A = [
  [[0.2, 1.0, 0.0], [0.0, 0.4, 1.0], [0.3, 0.0, -0.5]],
  [[0.3, 1.1, 0.0], [0.1, 0.3, 0.9], [0.2, 0.0, -0.4]],
  [[0.1, 0.9, 0.1], [0.0, 0.5, 1.1], [0.4, 0.1, -0.6]],
]
B = [
  [[0.0, 1.0], [1.0, 0.0], [0.2, 1.0]],
  [[0.1, 1.0], [1.1, 0.0], [0.2, 0.9]],
  [[0.0, 0.9], [0.9, 0.1], [0.3, 1.1]],
]

[gains]
poles = [-1.5, -2.0, -2.5]

[[law]]
kind = "averaged"

[[law]]
kind = "averaged"
name = "told"
dwell_time = 0.1

[[law]]
kind = "expected"

[[law]]
kind = "exact"
name = "oracle"

[switching]
kind = "markov"
rates = [[0.0, 1.0, 2.0], [1.5, 0.0, 0.5], [1.0, 1.0, 0.0]]

[signal]
kind = "constant"
mode = 0

[run]
x0 = [1.0, -1.0, 0.5]
horizon = 2.0
step = 0.02
"""
STUDY = """\
title = "Own laws"
problem = "own.toml"
scenarios = 12
seed = 3

[grid]
plant.delay = [0.234, 0.3]
law.told.dwell_time = [0.1, 0.15]
delay_error = [-0.1, 0.0, 0.1]
"""


def load(folder, text=STUDY, problem=PROBLEM):
    (folder / "own.toml").write_text(problem, encoding="utf-8")
    (folder / "study.toml").write_text(text, encoding="utf-8")
    return load_study(folder / "study.toml")


def filled(study, store):
    """The store of a study, its blocks computed one by one without a cluster."""
    target = prepare(study, str(store))
    for number in target.missing():
        run_block(study, target.url, target.key, number)
    return dt.open_sweep(store)


def tree(store):
    """Every file of a store."""
    root = Path(store)
    return {str(p.relative_to(root)): p.read_bytes() for p in root.rglob("*") if p.is_file()}


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    folder = tmp_path_factory.mktemp("own")
    study = load(folder)
    return study, filled(study, folder / "own.zarr").load()


# What a study says


def test_values_go_where_their_names_and_paths_say(tmp_path):
    named = {
        "distance": 0.5, "delay": 0.3, "speed": 2.0, "step": 0.01, "horizon": 3.0, "start": 2.0,
        "delay_error": 0.1, "gain_error": -0.2, "sojourn": "uniform", "dwell_time": 0.4,
        "noise": 0.1, "measurement_delay": 0.03, "jitter": 0.005, "dropout": 0.2, "mode_delay": 2,
        "wrong_mode": 0.1, "saturation": 5.0, "rate_limit": 50.0, "disturbance": 0.01, "seed": 7,
    }  # fmt: skip
    assert set(named) == set(AXES)
    lines = "\n".join(f"{name} = {json.dumps(value)}" for name, value in named.items())
    study = load(tmp_path, STUDY.split("plant.delay")[0] + lines + "\nrun.x0.1 = 4.0\n")
    draft, loop = study.draft(next(study.cells())), study.loop(next(study.cells()))
    assert study.shape == (1,) * (len(named) + 1)
    # By hand: α = 0.5, D = 0.3; then errors of the true delay and of the true B.
    A = np.array([[0.2, 1.0, 0.0], [0.0, 0.4, 1.0], [0.3, 0.0, -0.5]])
    np.testing.assert_allclose(loop.plant.A[1], A + 0.5 * (np.array(
        [[0.3, 1.1, 0.0], [0.1, 0.3, 0.9], [0.2, 0.0, -0.4]]) - A), rtol=1e-15)  # fmt: skip
    assert loop.plant.delay == pytest.approx(0.33, rel=1e-15)
    assert loop.laws["averaged"].plant.delay == 0.3
    np.testing.assert_allclose(loop.plant.B, 0.8 * loop.laws["averaged"].plant.B, rtol=1e-15)
    assert draft["gains"]["poles"] == [-3.0, -4.0, -5.0]
    assert (loop.step, loop.horizon, loop.x0.tolist()) == (0.01, 3.0, [2.0, 8.0, 1.0])
    assert loop.laws["told"].dwell_time == 0.4
    assert loop.laws["averaged"].dwell_time is None
    assert loop.model.sample(50.0).dwell_time >= 0.4 * (1 - 1e-12)
    assert [type(one).__name__ for one in loop.imperfections] == [
        "Noise", "MeasurementDelay", "Jitter", "Dropout", "ModeDelay", "WrongMode", "Saturation",
        "RateLimit", "WhiteDisturbance",
    ]  # fmt: skip


def test_nothing_is_imperfect_where_an_axis_is_zero(tmp_path):
    study = load(tmp_path, STUDY.replace("delay_error = [-0.1, 0.0, 0.1]", "noise = [0.0, 0.1]"))
    first, second = (study.loop(study.cell((0, 0, i))) for i in (0, 1))
    assert (len(first.imperfections), len(second.imperfections)) == (0, 1)


BAD = [
    ("plant.delay", "plant.dely", r"line 7, .*plant\.dely is not known: did you mean delay\?"),
    ("plant.delay", "delai", r"line 7, .*delai is not known: did you mean delay\?"),
    ("plant.delay", "low_pas", r"line 7, .*low_pas is not known"),
    ("law.told", "law.tolled", r"line 8, .*'tolled' is not there: .*averaged, told, expected"),
    ("law.told", "law.7", r"line 8, .*'7' is not there"),
    ("dwell_time = [0.1, 0.15]", 'dwell_time = ["a"]', r"line 8, .*dwell_time: .*got 'a'"),
    ("delay_error", "delay_eror", r"line 9, .*delay_eror is not known: did you mean delay_error"),
    ("[-0.1, 0.0, 0.1]", "[]", r"line 9: grid\.delay_error: must hold at least one value"),
    ("[-0.1, 0.0, 0.1]", "[-1.5]", r"line 9: grid\.delay_error\.0: .* greater than -1"),
    ("[0.234, 0.3]", "[0.3, 0.3]", r"line 7, .*plant\.delay: holds 0\.3 twice"),
    ("[0.234, 0.3]", "[]", r"line 7, .*plant\.delay: must hold at least one value"),
    ("scenarios = 12", 'laws = ["told", "orcle"]', r"laws: law 'orcle' is not known: .*'oracle'"),
    ("scenarios = 12", 'metrics = ["isse"]', r"line 3: .*'isse' is not known: did you mean 'ise'"),
    ("seed = 3", "horizn = 3.0", r"line 4: horizn is not known: did you mean horizon\?"),
    ("[grid]", "[grid]\nspeed = [2.0]\ntitel = 3", r"line 8, .*titel is not known: known are"),
    ("plant.delay = [0.234, 0.3]", "plant.delay = [0.3]\ndelay = [0.4]",
     r"line 7, .*plant\.delay is overwritten by delay: keep one"),
    ("plant.delay = [0.234, 0.3]", "dwell_time = [0.3, 0.4]",
     r"line 8, .*law\.told\.dwell_time is overwritten by dwell_time: keep one"),
    ("plant.delay = [0.234, 0.3]", '"plant.delay" = [0.3]\nplant.delay = [0.4]',
     r"line 7, .*plant\.delay is given twice: keep one of them"),
    ("plant.delay = [0.234, 0.3]", 'law.told.kind = ["mean"]', r"line 7, .*changes no result"),
    ("plant.delay = [0.234, 0.3]", "run.seed = [1, 2]", r"line 7, .*run\.seed changes no result"),
    ("plant.delay = [0.234, 0.3]", "signal.mode = [0, 1]", r"line 7, .*mode changes no result"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "message"), BAD, ids=range(len(BAD)))
def test_a_bad_study_is_refused_by_line_and_nearest_name(tmp_path, old, new, message):
    assert old in STUDY
    with pytest.raises(dt.StudyFileError, match=message) as caught:
        load(tmp_path, STUDY.replace(old, new, 1))
    assert "\n" not in str(caught.value)


# What is run


def test_every_cell_is_monte_carlo_on_the_problem_with_its_values(own):
    study, data = own
    assert data.ise.dims == (
        "plant.delay", "law.told.dwell_time", "delay_error", "law", "scenario",
    )  # fmt: skip
    base = study.base
    plant = dt.SwitchedSystem(base.plant.A, base.plant.B, 0.3)
    gains = dt.place(plant, [-1.5, -2.0, -2.5])
    model = dt.Markov([[0.0, 1.0, 2.0], [1.5, 0.0, 0.5], [1.0, 1.0, 0.0]])
    laws = {
        "averaged": dt.AveragedPredictor(plant, gains),
        "told": dt.AveragedPredictor(plant, gains, dwell_time=0.15),
        "expected": dt.ExpectedPredictor(plant, gains, model),
        "oracle": dt.ExactPredictor(plant, gains),
    }
    truth = dt.SwitchedSystem(plant.A, plant.B, 0.3 * (1.0 - 0.1))
    direct = dt.monte_carlo(truth, laws, model, [1.0, -1.0, 0.5], 2.0, 0.02, scenarios=12, seed=3)
    here = data.isel({"plant.delay": 1, "law.told.dwell_time": 1, "delay_error": 0})
    for name in ("ise", "energy", "cost", "peak", "settling_time", "decay_rate", "final_norm"):
        np.testing.assert_array_equal(here[name].values, direct[name].values)
        assert here[name].attrs == direct[name].attrs
    assert data.attrs["oracle"] == "oracle"
    assert data.done.all()


def test_equal_signals_are_run_once_and_counted_as_often_as_they_come(tmp_path):
    text = STUDY.split("plant.delay")[0] + 'dwell_time = 0.3\nsojourn = "fixed"\n'
    study = load(tmp_path, text.replace("12", "40"))
    outcome = run_cell(study, next(study.cells()))
    loop = study.loop(next(study.cells()))
    direct = dt.monte_carlo(
        loop.plant, loop.laws, loop.model, loop.x0, 2.0, 0.02, scenarios=40, seed=3
    )
    np.testing.assert_array_equal(outcome.metrics["cost"], direct.cost.values)


def test_a_law_that_cannot_be_built_in_a_cell_leaves_its_reason_and_the_others_run(tmp_path):
    text = STUDY.split("plant.delay")[0] + "law.told.dwell_time = [-1.0, 0.1]\n"
    study = load(tmp_path, text)
    data = filled(study, tmp_path / "x.zarr").load()
    bad = data.isel({"law.told.dwell_time": 0})
    assert "dwell_time" in bad.reason.sel(law="told").item()
    assert bad.ise.sel(law="told").isnull().all()
    assert bad.ise.drop_sel(law="told").notnull().all()
    assert (data.isel({"law.told.dwell_time": 1}).reason == "").all()
    assert data.done.all()


def test_a_diverging_loop_is_counted_in_its_reason(tmp_path):
    text = STUDY.split("plant.delay")[0] + "gain_error = [0.0, 8.0]\n"
    study = load(tmp_path, text.replace("seed = 3", "horizon = 200.0"))
    data = filled(study, tmp_path / "x.zarr").load()
    assert (data.reason.isel(gain_error=0) == "").all()
    count = int(data.diverged.isel(gain_error=1).sel(law="averaged").sum())
    text = data.reason.isel(gain_error=1).sel(law="averaged").item()
    assert count > 0
    assert text == f"diverged on {count} of 12 scenarios"


def make_loop(delay, weight):
    plant = dt.problems.paper().plant
    plant = dt.SwitchedSystem(plant.A, plant.B, delay)
    laws = {"mine": dt.AveragedPredictor(plant, dt.place(plant, [-1, -2]), [weight, 1.0 - weight])}
    model = dt.SemiMarkov(expon(0.1, 0.2), modes=2)
    x0 = [1.0, 0.0]
    return {"plant": plant, "laws": laws, "model": model, "x0": x0, "horizon": 1.5, "step": 0.05}


def test_cells_can_be_made_in_python(tmp_path):
    grid = {"delay": [0.1, 0.17], "weight": np.array([0.2, 0.5]), "seed": [0, 1]}
    study = dt.function_study(make_loop, grid, scenarios=5)
    data = filled(study, tmp_path / "mine.zarr").load()
    loop = make_loop(0.17, 0.5)
    direct = dt.monte_carlo(**loop, scenarios=5, seed=1)
    np.testing.assert_array_equal(
        data.ise.sel(delay=0.17, weight=0.5, seed=1).values, direct.ise.values
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"grid": {"delay": []}}, r"grid\['delay'\] must hold at least one value and none twice"),
        ({"grid": {"delay": [0.1, 0.1]}}, r"none twice, got \[0\.1, 0\.1\]"),
        ({"grid": {"delay": "abc"}}, r"grid\['delay'\] must be a list of values, got 'abc'"),
        ({"grid": {"delay": [None]}}, r"grid\['delay'\] must hold numbers or texts, got None"),
        ({"metrics": ["isee"]}, r"metrics must be some of .*, got 'isee'"),
        ({"scenarios": 0}, r"scenarios must be an integer of at least 1"),
        ({"function": 3}, r"function must be a function, got int: write one by def"),
        ({"function": lambda delay: {"plant": 1}}, r"function must return a mapping with plant"),
        (
            {"function": functools.partial(make_loop, weight=0.5)},
            r"a function, got partial",
        ),
        ({"function": lambda delay: 1 / 0}, r"function failed: ZeroDivisionError: division"),
        (
            {"function": lambda delay: make_loop(delay, 0.5) | {"step": 0.0}},
            r"step must be positive",
        ),
        ({"function": lambda delay: make_loop(delay, 0.5) | {"x0": [1.0]}}, r"x0 must have shape"),
        (
            {"function": lambda delay: make_loop(delay, 0.5) | {"model": 3}},
            r"model must have",
        ),
        (
            {"function": lambda delay: make_loop(delay, 0.5) | {"plant": 3}},
            r"plant must be",
        ),
        ({"grid": {"law": [1]}}, r"'law' cannot be the name of an axis"),
        ({"grid": {"a/b": [1]}}, r"'a/b' cannot be the name of an axis"),
        ({"metrics": ["ise", "ise"]}, r"each once, got 'ise'"),
    ],
)
def test_a_bad_study_in_python_is_refused(change, message):
    function = change.pop("function", lambda delay: make_loop(delay, 0.5))
    with pytest.raises(dt.ArgumentError, match=message):
        dt.function_study(function, **{"grid": {"delay": [0.1]}, **change})


def failing(delay, weight):
    made = make_loop(delay, 0.5)
    if weight == 1:
        raise ValueError("no such weight")
    if weight == 2:
        made["laws"] = {"other": made["laws"]["mine"]}
    if weight == 3:
        made["laws"] = {}
    return made | ({"step": None} if weight == 4 else {})


def test_whatever_fails_in_a_cell_is_its_reason_and_the_others_run(tmp_path):
    study = dt.function_study(failing, {"delay": [0.1], "weight": [0, 1, 2, 3, 4]}, scenarios=3)
    data = filled(study, tmp_path / "x.zarr").load().squeeze()
    assert data.ise.notnull().all("scenario").values.tolist() == [True, *[False] * 4]
    for reason, start in zip(
        data.reason.values,
        ["", "function failed: ValueError: no such", "laws must be named alike", "laws must hold",
         "step must be a number"],
        strict=True,
    ):  # fmt: skip
        assert reason.startswith(start)
        assert bool(reason) == bool(start)


def weighted(weight):
    def loop(delay):
        return make_loop(delay, weight)

    return dt.function_study(loop, {"delay": [0.1]}, scenarios=3)


def test_values_around_a_function_tell_studies_apart(tmp_path):
    filled(weighted(0.3), tmp_path / "x.zarr")
    with pytest.raises(dt.ArgumentError, match=r"values\.weight was 0\.3, is 0\.4"):
        dt.sweep(weighted(0.4), tmp_path / "x.zarr")


def test_an_axis_of_one_s_own_keeps_its_name(tmp_path):
    study = dt.function_study(
        lambda speed: make_loop(0.1, speed), {"speed": [0.2, 0.4]}, scenarios=2
    )
    data = filled(study, tmp_path / "x.zarr")
    assert data.speed.attrs == {"long_name": "speed"}
    assert str(study.cell((1,))) == "speed 0.4"


# The store


def test_a_store_made_anew_under_the_same_name_is_not_taken_for_the_old_one(tmp_path):
    first = dt.function_study(lambda delay: make_loop(delay, 0.5), {"delay": [0.1]}, scenarios=2)
    second = dt.function_study(
        lambda delay: make_loop(delay, 0.5), {"delay": [0.1, 0.2, 0.3]}, scenarios=2
    )
    old = filled(first, tmp_path / "x.zarr")
    assert old.ise.load().notnull().all()
    old = dt.open_sweep(tmp_path / "x.zarr")
    shutil.rmtree(tmp_path / "x.zarr")
    assert filled(second, tmp_path / "x.zarr").ise.load().notnull().all()
    with pytest.raises(dt.StoreError):
        old.ise.load()


def test_a_store_opens_with_plain_xarray_and_carries_the_study(own, tmp_path):
    study, data = own
    filled(study, tmp_path / "plain.zarr")
    with xr.open_zarr(tmp_path / "plain.zarr") as plain:
        np.testing.assert_array_equal(plain.ise, data.ise)
        assert plain.ise.attrs == {"units": "x^2 s", "long_name": "integral of |x|^2"}
        assert plain.delay_error.attrs["long_name"] == "delay error"
        assert plain.diverged.dtype == bool
        assert plain["plant.delay"].values.tolist() == [0.234, 0.3]
        assert plain.attrs["study"] == STUDY
        assert (plain.attrs["version"], plain.attrs["seed"]) == (dt.__version__, 3)


@pytest.mark.parametrize("shape", [(), (7,), (3, 5), (2, 3, 4), (4, 1, 9, 2)])
@pytest.mark.parametrize("cost", [1e-3, 0.07, 0.3, 5.0])
def test_blocks_cover_every_cell_once_and_take_about_a_second(tmp_path, shape, cost):
    study = load(tmp_path, STUDY.split("plant.delay")[0])
    axes = {f"seed{i}": tuple(range(size)) for i, size in enumerate(shape)}
    object.__setattr__(study, "grid", axes)
    layout = layout_of(study, np.full(shape, cost))
    seen = [index for number in range(layout.size) for index in layout.cells(number)]
    assert sorted(seen) == sorted(np.ndindex(shape))
    assert len(list(layout.cells(0))) * cost <= max(1.0 + 1e-9, cost)
    assert layout.size <= 2 * max(1.0, len(seen) * cost) or cost > 0.25


def test_a_cell_half_written_is_absent_and_is_written_again(own, tmp_path):
    study, data = own
    store = tmp_path / "x.zarr"
    target = prepare(study, str(store))
    target.array("ise")[target.layout.slices(0)] = 1.0  # killed before anything else was written
    opened = dt.open_sweep(store)
    assert opened.ise.isnull().all()
    assert not opened.done.any()
    assert target.missing() == list(range(target.layout.size))
    xr.testing.assert_identical(filled(study, store).load(), data)


def test_a_changed_study_does_not_mix_with_an_old_store(own, tmp_path):
    study, _ = own
    prepare(study, str(tmp_path / "x.zarr"))
    for old, new, message in (
        ("scenarios = 12", "scenarios = 13", r"scenarios was 12, is 13"),
        ("[0.234, 0.3]", "[0.234, 0.4]", r"grid\.plant\.delay was \[0\.234, 0\.3\], is \[0\.234, "),
        ("delay_error = [-0.1, 0.0, 0.1]\n", "", r"grid\.delay_error is gone"),
    ):
        other = load(tmp_path, STUDY.replace(old, new))
        with pytest.raises(dt.ArgumentError, match=rf"holds another study: {message}.*Choose"):
            dt.sweep(other, tmp_path / "x.zarr")
    changed = load(tmp_path, problem=PROBLEM.replace("1.5, 0.0, 0.5", "1.5, 0.0, 0.6"))
    with pytest.raises(dt.ArgumentError, match=r"problem\.switching\.rates was"):
        dt.sweep(changed, tmp_path / "x.zarr")
    assert load(tmp_path, "# a comment\n" + STUDY).definition() == study.definition()


def test_a_store_of_another_version_is_refused(own, tmp_path, monkeypatch):
    study, _ = own
    monkeypatch.setattr("deadtime.scenarios.sweeps.study.__version__", "0.0.1")
    prepare(study, str(tmp_path / "x.zarr"))
    monkeypatch.undo()
    with pytest.raises(dt.ArgumentError, match=r"version was .0\.0\.1., is .*Choose another store"):
        dt.sweep(study, tmp_path / "x.zarr")


def test_two_sweeps_that_make_one_store_at_once_do_not_mix(own, tmp_path, monkeypatch):
    study, _ = own
    fill, place = store._fill, str(tmp_path / "x.zarr")

    def slowly(*given):
        fill(*given)
        monkeypatch.undo()
        prepare(replace(study, seed=9), place)

    monkeypatch.setattr(store, "_fill", slowly)
    with pytest.raises(dt.ArgumentError, match="holds another study: seed was 9, is 3"):
        prepare(study, place)
    assert [path.name for path in tmp_path.iterdir()] == ["x.zarr"]


def test_what_is_no_store_is_refused(tmp_path):
    study = load(tmp_path)
    with pytest.raises(dt.ArgumentError, match="does not exist: run the sweep first"):
        dt.open_sweep(tmp_path / "none.zarr")
    (tmp_path / "folder.zarr").mkdir()
    (tmp_path / "folder.zarr" / "mine.txt").write_text("kept")
    for name in ("folder.zarr", "study.toml"):
        with pytest.raises(dt.ArgumentError, match=rf"{name}' is there, but is no Zarr store"):
            dt.sweep(study, tmp_path / name)
    with pytest.raises(dt.StoreError, match=r"s3://none.* cannot be opened: .*s3fs"):
        dt.sweep(study, "s3://none/x.zarr")
    with pytest.raises(dt.ArgumentError, match="workers are those of the scheduler"):
        dt.sweep(study, tmp_path / "x.zarr", "tcp://127.0.0.1:9", workers=2)
    with pytest.raises(dt.ArgumentError, match="scenarios must be at most 33,554,432 with 4 laws"):
        dt.sweep(replace(study, scenarios=10**9), tmp_path / "x.zarr", workers=1)
    assert (tmp_path / "folder.zarr" / "mine.txt").read_text() == "kept"
    xr.Dataset({"a": 1}).to_zarr(tmp_path / "other.zarr", consolidated=False)
    with pytest.raises(dt.ArgumentError, match="is Zarr, but not made by deadtime sweep"):
        dt.open_sweep(tmp_path / "other.zarr")


def test_a_damaged_chunk_is_named_and_computed_again_on_request(own, tmp_path, monkeypatch, capsys):
    study, data = own
    monkeypatch.chdir(tmp_path)
    load(tmp_path)
    whole = filled(study, tmp_path / "x.zarr").load()
    before = tree("x.zarr")
    chunk = next(p for p in Path("x.zarr/energy/c").rglob("0") if p.is_file())
    damaged = bytearray(chunk.read_bytes())
    damaged[len(damaged) // 2] ^= 1
    chunk.write_bytes(damaged)
    with pytest.raises(dt.StoreError, match=rf"damaged chunk, .*{chunk}.*--verify"):
        dt.open_sweep("x.zarr").energy.load()
    np.testing.assert_array_equal(dt.open_sweep("x.zarr").ise, data.ise)
    for name in ("peak", "diverged", "reason"):
        gone = next(p for p in Path(f"x.zarr/{name}/c").rglob("0") if p.is_file())
        kept = gone.read_bytes()
        gone.unlink()
        with pytest.raises(dt.StoreError, match=rf"lacks the chunk .*{gone}"):
            dt.open_sweep("x.zarr")[name].load()
        if name != "peak":
            gone.write_bytes(kept)
    shutil.rmtree("x.zarr/delay_error/c")
    assert dt.open_sweep("x.zarr").delay_error.values.tolist() == [-0.1, 0.0, 0.1]
    found = [fault for _, fault in open_store(str(Path("x.zarr").absolute())).faults()]
    assert len(found) == 1  # both belong to the one block that there is
    with pytest.raises(SystemExit) as stopped:
        main(["sweep", "study.toml", "--store", "x.zarr", "--workers", "1", "--verify", "--json"])
    assert stopped.value.code == 0
    said = capsys.readouterr().err
    assert str(chunk) in said
    assert "the values of delay_error were damaged" in said
    assert tree("x.zarr") == before
    xr.testing.assert_identical(dt.open_sweep("x.zarr").load(), whole)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_store_that_may_not_be_written_is_named(own, tmp_path):
    study, _ = own
    prepare(study, str(tmp_path / "x.zarr"))
    for folder in [tmp_path / "x.zarr", *(tmp_path / "x.zarr").rglob("*")]:
        folder.chmod(0o500 if folder.is_dir() else 0o400)
    with pytest.raises(dt.StoreError, match=r"x\.zarr' may not be written: what is stored is kept"):
        dt.sweep(study, tmp_path / "x.zarr", workers=1)


@pytest.mark.parametrize(
    ("options", "message"),
    [("size=200k", "is full: what is stored is kept; make room"), ("ro", "may not be written")],
)
def test_a_full_disk_and_a_read_only_one_are_named_and_what_is_stored_is_kept(
    tmp_path, options, message
):
    study = load(tmp_path, STUDY.split("law.told")[0])
    data = filled(study, tmp_path / "elsewhere.zarr").load()
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=200k", "tmpfs", str(disk)], capture_output=True
    )
    if mounted.returncode:
        pytest.skip("a disk cannot be mounted here")
    try:
        store = disk / "x.zarr"
        target = prepare(study, str(store))
        if options == "ro":
            subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
        else:
            (disk / "ballast").write_bytes(bytes(os.statvfs(disk).f_bavail * 4096 - 4096))
        with pytest.raises(dt.StoreError, match=message):
            dt.sweep(study, store, workers=1)
        assert not dt.open_sweep(store).done.any()
        subprocess.run(["mount", "-o", "remount,rw,size=20M", str(disk)], check=True)
        (disk / "ballast").unlink(missing_ok=True)
        assert target.missing()
        xr.testing.assert_identical(dt.sweep(study, store, workers=1).load(), data)
    finally:
        subprocess.run(["umount", str(disk)], check=True)


# Clusters

# Cells take their time in processes that are told so, which are there to be killed.
CELLS = """\
import os
import time

import deadtime as dt


def cell(delay, weight):
    time.sleep(float(os.environ.get("CELL_SECONDS", "0")))
    plant = dt.problems.paper().plant
    plant = dt.SwitchedSystem(plant.A, plant.B, delay)
    laws = {"mine": dt.AveragedPredictor(plant, dt.place(plant, [-1, -2]), [weight, 1.0 - weight])}
    model = dt.Markov([[0, 2], [2, 0]])
    return dict(plant=plant, laws=laws, model=model, x0=[1.0, 0.0], horizon=1.5, step=0.05)


def study():
    grid = {"delay": [0.1, 0.17, 0.3], "weight": [0.1, 0.2, 0.3, 0.4, 0.5]}
    return dt.function_study(cell, grid, scenarios=5)


if __name__ == "__main__":
    import sys

    import cells

    dt.sweep(cells.study(), sys.argv[1], workers=2)
"""


@pytest.fixture(scope="module")
def slow(tmp_path_factory):
    """A study of 15 cells in as many blocks, and the store of an uninterrupted run."""
    folder = tmp_path_factory.mktemp("slow")
    (folder / "cells.py").write_text(CELLS, encoding="utf-8")
    sys.path.insert(0, str(folder))
    study = importlib.import_module("cells").study()
    sys.path.remove(str(folder))
    create(str(folder / "whole.zarr"), study, Layout(study.shape, (1, 1)), {})
    filled(study, folder / "whole.zarr")
    return study, folder


def started(slow, name):
    """The same sweep in a process of its own, some cells of which are done."""
    study, folder = slow
    store = folder / name
    create(str(store), study, Layout(study.shape, (1, 1)), {})
    command = [sys.executable, str(folder / "cells.py"), str(store)]
    client = subprocess.Popen(command, cwd=folder, env=os.environ | {"CELL_SECONDS": "0.25"})
    wait_for(lambda: done(store) >= 3)
    assert client.poll() is None
    return store, client


def done(store):
    return sum(path.is_file() for path in Path(store, "done", "c").rglob("*"))


def wait_for(condition, patience=60.0):
    end = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def kill_a_worker(client):
    """The workers are the processes with the most threads."""
    children = psutil.Process(client.pid).children(recursive=True)
    max(children, key=lambda process: process.num_threads()).kill()


def test_a_killed_worker_stops_nothing_and_after_a_killed_client_the_next_run_goes_on(slow):
    study, folder = slow
    store, client = started(slow, "client.zarr")
    kill_a_worker(client)
    wait_for(lambda: done(store) >= 7)
    workers = psutil.Process(client.pid).children(recursive=True)
    client.send_signal(signal.SIGKILL)
    client.wait()
    wait_for(lambda: not any(worker.is_running() for worker in workers))
    before = done(store)
    assert 7 <= before < study.size
    seen = []
    dt.sweep(study, store, workers=1, progress=seen.append)
    assert [state.done for state in seen] == list(range(before + 1, study.size + 1))
    assert tree(store) == tree(folder / "whole.zarr")


@pytest.mark.long
def test_a_killed_worker_is_made_up_for(slow):
    _, folder = slow
    store, client = started(slow, "worker.zarr")
    kill_a_worker(client)
    assert client.wait(60.0) == 0
    assert tree(store) == tree(folder / "whole.zarr")


def test_a_cluster_elsewhere_is_used_by_its_address(slow, tmp_path, monkeypatch):
    from distributed import LocalCluster

    study, folder = slow
    monkeypatch.setattr("deadtime.scenarios.sweeps.cluster._PATIENCE", 0.5)
    create(str(tmp_path / "x.zarr"), study, Layout(study.shape, (1, 1)), {})
    options = {"host": "127.0.0.1", "protocol": "tcp", "dashboard_address": "127.0.0.1:0"}
    with (
        LocalCluster(n_workers=0, processes=False, **options) as empty,
        pytest.raises(dt.ClusterError, match=r"has no workers: start some with .dask worker"),
    ):
        dt.sweep(study, tmp_path / "x.zarr", empty.scheduler_address)
    with LocalCluster(n_workers=1, threads_per_worker=4, processes=False, **options) as remote:
        dt.sweep(study, tmp_path / "x.zarr", remote.scheduler_address)
    assert tree(tmp_path / "x.zarr") == tree(folder / "whole.zarr")


def test_a_scheduler_that_is_not_there_is_named(own, tmp_path, monkeypatch):
    monkeypatch.setattr("deadtime.scenarios.sweeps.cluster._PATIENCE", 0.3)
    with pytest.raises(dt.ClusterError, match=r"'tcp://127\.0\.0\.1:9' cannot be reached"):
        dt.sweep(own[0], tmp_path / "x.zarr", "tcp://127.0.0.1:9")
    with pytest.raises(dt.ClusterError, match=r"'nonsense' cannot be reached"):
        dt.sweep(own[0], tmp_path / "x.zarr", "nonsense")


# The command


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with the study, where commands run."""
    monkeypatch.chdir(tmp_path)
    load(tmp_path, STUDY.replace("12", "3"))


def ran(*arguments):
    with pytest.raises(SystemExit) as stopped:
        main(["sweep", *arguments])
    return stopped.value.code


@pytest.mark.usefixtures("here")
def test_the_command_says_what_there_is_to_do_and_does_it(capsys):
    assert ran("study.toml", "--dry-run") == 0
    said = capsys.readouterr().out
    assert "12 cells (2 plant.delay × 2 law.told.dwell_time × 3 delay_error), 3 signals" in said
    assert "not there yet" in said
    assert "To do: 144 runs in 1 block of cells, about 1 s of one core" in said
    assert not Path("study.zarr").exists()
    assert ran("study.toml", "--workers", "1") == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert captured.out.endswith("Store: study.zarr. Next: deadtime plot study.zarr\n")
    assert ran("study.toml", "--status", "--json") == 0
    plan = json.loads(capsys.readouterr().out)
    assert (plan["cells"], plan["done"], plan["missing"], plan["runs"]) == (12, 12, 0, 0)
    files = sum(path.is_file() for path in Path("study.zarr").rglob("*/c/**/*"))
    assert files <= plan["objects"] + 5  # and the coordinates


@pytest.mark.usefixtures("here")
def test_the_command_lists_what_went_wrong_law_by_law(capsys):
    text = Path("study.toml").read_text(encoding="utf-8").replace("[0.1, 0.15]", "[0.1, -1.0]")
    Path("study.toml").write_text(text, encoding="utf-8")
    assert ran("study.toml", "--store", "own name.zarr", "--workers", "1", "--scenarios", "2") == 0
    said = capsys.readouterr().out
    assert "• told: in 6 of 12 cells, such as: dwell_time" in said
    assert "averaged: in" not in said


@pytest.mark.usefixtures("here")
def test_interrupted_the_command_says_how_far_it_came_and_ends_with_130(monkeypatch, capsys):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("deadtime.cli.sweep.progress_of", lambda *_, **__: nullcontext(interrupt))
    assert ran("study.toml", "--workers", "1") == 130
    assert capsys.readouterr().err == (
        "deadtime: interrupted after 12 of 12 cells; the same command goes on\n"
    )


def test_progress_on_a_cluster_is_a_line_now_and_then(capsys):
    lines = Lines(10.0)
    for seconds in (1.0, 2.0, 11.5, 12.0):
        lines(Progress(5, 20, 4, seconds, 4.0 * seconds, 8, 2.0, 8.0))
    lines(Progress(20, 20, 19, 30.0, 120.0, 8, 8.0, 8.0))
    assert capsys.readouterr().err.splitlines() == [
        "5 of 20 cells, 4 cells/s on 8 threads, about 3 s left",
        "5 of 20 cells, 0.348 cells/s on 8 threads, about 34 s left",
        "20 of 20 cells, 0.633 cells/s on 8 threads, done in 30 s",
    ]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("none.toml",), "none.toml cannot be read"),
        (("study.toml", "--scenarios", "0"), "scenarios must be an integer of at least 1"),
        (("study.toml", "--workers", "0"), "workers must be an integer of at least 1"),
        (("study.toml", "--store", "study.toml"), "study.toml"),
        (("study.toml", "--store", "/proc/x.zarr"), "'/proc/x.zarr' cannot be written"),
    ],
)
@pytest.mark.usefixtures("here")
def test_bad_requests_get_one_line_and_code_2(capsys, arguments, message):
    assert ran(*arguments) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert message in error
