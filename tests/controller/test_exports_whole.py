"""Exports appear whole or not at all, and the command line takes what the problem leaves open."""

import json
import os
import re
import subprocess
import sys
from importlib.resources import files

import numpy as np
import pytest

import deadtime as dt
import plants
from deadtime.base.files import Staging
from deadtime.cli.application import main
from deadtime.controller.export import compiler, export_c, export_fmu
from deadtime.problems.file import load_problem
from shares import mostly_long

TWO_INPUTS = """
[plant]
delay = 0.2
A = [[[0.5, 1.0], [0.0, -1.0]]]
B = [[[1.0, 0.0], [0.0, 1.0]]]
inputs = ["throttle", "brake (N)"]
[gains]
poles = [-1.0, -2.0]
[signal]
kind = "constant"
mode = 0
[run]
x0 = [1.0, 0.0]
horizon = 1.0
step = 0.05
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(compiler, "compiler", lambda: None)
    (tmp_path / "two.toml").write_text(TWO_INPUTS, encoding="utf-8")
    return tmp_path


def command(*arguments):
    with pytest.raises(SystemExit) as stopped:
        main([str(one) for one in arguments])
    return stopped.value.code


def test_inputs_before_the_start_need_not_be_given_for_an_fmu_of_two(folder):
    assert command("export", "two.toml", "--fmu", "m.fmu", "--plant-fmu", "p.fmu") == 0
    np.testing.assert_array_equal(load_problem("two.toml").u0, [0.0, 0.0])
    assert {path.name for path in folder.iterdir()} == {"two.toml", "m.fmu", "p.fmu"}


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (["--plant-fmu", "x.txt"], "path must end in .fmu"),
        (["--plant-fmu", "no/x.fmu"], "path 'no/x.fmu' cannot be written"),
        (["--plant-fmu", "m.fmu"], "path 'm.fmu' is given twice"),
        (["--plant-fmu", "there.fmu"], "path 'there.fmu' cannot be written: Is a directory"),
    ],
)
def test_if_one_export_fails_none_is_there(folder, capsys, wrong, message):
    (folder / "there.fmu").mkdir()
    before = sorted(folder.iterdir())
    assert command("export", "two.toml", "--c", "a/b/out", "--fmu", "m.fmu", *wrong) == 2
    assert message in capsys.readouterr().err
    assert sorted(folder.iterdir()) == before


def test_an_fmu_goes_into_the_folder_that_is_made_for_the_c(folder):
    assert command("export", "two.toml", "--c", "a/out", "--fmu", "a/out/m.fmu") == 0
    assert {"m.fmu", "controller.c"} <= {path.name for path in (folder / "a/out").iterdir()}
    assert {path.name for path in folder.iterdir()} == {"two.toml", "a"}


def test_a_folder_keeps_what_else_is_in_it_and_its_old_files_until_all_is_made(folder):
    run = dt.Controller(plants.LAWS["averaged"](plants.paper()), 0.1)
    run.export_c(folder / "out")
    (folder / "out" / "notes.txt").write_text("mine")
    old = (folder / "out" / "controller.h").read_bytes()
    again = dt.Controller(plants.LAWS["averaged"](plants.paper()), 0.05)
    with pytest.raises(dt.ArgumentError, match=r"must end in \.fmu"), Staging() as staging:
        fails_after_the_c(again, folder, staging)
    assert (folder / "out" / "controller.h").read_bytes() == old
    again.export_c(folder / "out")
    assert (folder / "out" / "controller.h").read_bytes() != old
    assert (folder / "out" / "notes.txt").read_text() == "mine"
    assert not [path for path in (folder / "out").iterdir() if path.name.startswith(".")]


def fails_after_the_c(run, folder, staging):
    export_c(run, folder / "out", staging=staging)
    export_fmu(run, folder / "x.txt", staging=staging)


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError(28, "No space left on device")])
def test_an_interrupt_and_a_full_disk_leave_nothing(folder, monkeypatch, error):
    def stop(*_):
        raise error

    monkeypatch.setattr("deadtime.controller.export.c_code.self_check", stop)
    run = dt.Controller(plants.LAWS["averaged"](plants.paper()), 0.1)
    with pytest.raises(BaseException) as caught:
        run.export_c(folder / "new" / "out")
    assert isinstance(caught.value, (KeyboardInterrupt, OSError))
    assert [path.name for path in folder.iterdir()] == ["two.toml"]


def test_names_of_inputs_reach_figures_headers_and_descriptions(folder):
    problem = load_problem("two.toml")
    assert problem.inputs == ("throttle", "brake (N)")
    assert dt.problems.paper().inputs == ("u",)
    assert command("export", "two.toml", "--c", "out") == 0
    assert "Inputs: u[0]: throttle, u[1]: brake (N)." in (folder / "out/controller.h").read_text()
    from deadtime.reports.figures.runs import plot_laws
    from deadtime.simulation.run_figure import plot_run

    run = problem.simulate("averaged")
    panels = plot_run(run, inputs=problem.inputs).axes[2:4]
    assert [panel.get_title(loc="left") for panel in panels] == ["throttle", "brake (N)"]
    labels = [axes.get_ylabel() for axes in plot_laws({"a": run}, inputs=problem.inputs).axes]
    assert labels[2:4] == ["throttle", "brake (N)"]
    (folder / "two.toml").write_text(
        (folder / "two.toml").read_text().replace('"throttle", ', ""), encoding="utf-8"
    )
    with pytest.raises(dt.ArgumentError, match="inputs must name all 2, got 1 names"):
        load_problem("two.toml")


@pytest.mark.parametrize("place", ["two.toml", "paper"])
def test_simulate_takes_a_law_a_step_a_horizon_and_a_start(folder, capsys, place):
    options = ("--law", "averaged", "--step", 0.1, "--horizon", 3, "--x0", "-1,0.5", "--json")
    assert command("simulate", place, *options) == 0
    record = json.loads(capsys.readouterr().out)
    problem = load_problem("two.toml") if place == "two.toml" else dt.problems.paper()
    signal = problem.signal
    run = dt.simulate(problem.plant, problem.laws["averaged"], signal, [-1.0, 0.5], 3.0, step=0.1)
    laws = record["laws"]
    assert list(laws) == ["averaged"]
    assert laws["averaged"]["ise"] == pytest.approx(run.metrics()["ise"], rel=1e-12)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--law", "best"], "law must be one of averaged"),
        (["--step", "-1"], "step must be positive, in s, got -1"),
        (["--horizon", "0"], "horizon must be positive"),
        (["--x0", "1,2,3"], "x0 must have shape (n,) = (2,), got (3,)"),
        (["--x0", "1;2"], "x0 must be numbers separated by commas, such as --x0 1,-0.5"),
    ],
)
def test_what_does_not_fit_a_run_is_refused_by_the_option_s_name(folder, capsys, options, message):
    for place in ("two.toml", "paper"):
        assert command("simulate", place, *options) == 2
        err = capsys.readouterr().err
        assert message in err
        assert "two.toml" not in err


def test_python_m_deadtime_is_the_command():
    done = subprocess.run(
        [sys.executable, "-m", "deadtime", "--version"],
        capture_output=True,
        text=True,
        env=os.environ | {"NO_COLOR": "1"},
    )
    assert (done.returncode, done.stdout.strip()) == (0, dt.__version__)


@pytest.mark.parametrize("source", mostly_long(["", "A handbook"], ""))
def test_a_report_ends_a_source_that_is_there_and_sends_nobody_to_the_repository(folder, source):
    text = (folder / "two.toml").read_text()
    (folder / "two.toml").write_text(f'source = "{source}"\n{text}', encoding="utf-8")
    assert command("reproduce", "two.toml", "--no-certificates", "--out", "report") == 0
    page = next((folder / "report").glob("*.html")).read_text(encoding="utf-8")
    assert ('<p class="source">A handbook.</p>' in page) == bool(source)
    assert '<p class="source">.' not in page
    for path in files("deadtime.problems").joinpath("files").iterdir():
        if path.name.endswith(".j2"):
            text = path.read_text(encoding="utf-8")
            assert not re.search(r"docs/|\w\.md\b", text), path.name
