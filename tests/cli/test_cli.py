"""The command line, driven as a user would."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import deadtime as dt
from deadtime.cli.application import main
from deadtime.problems.imperfection_registry import ENTRIES
from deadtime.problems.toml.sections import kinds_of
from shares import mostly_long


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    captured = capsys.readouterr()
    return stopped.value.code, captured.out, captured.err


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("example", mostly_long(dt.problems.NAMED, "three-mode"))
def test_init_writes_a_file_that_simulate_runs(folder, capsys, example):
    code, out, err = run(capsys, "init", "mine.toml", "--example", example)
    assert (code, err) == (0, "")
    assert "deadtime simulate mine.toml" in out
    code, out, err = run(capsys, "simulate", "mine.toml")
    assert (code, err) == (0, "")
    assert out.startswith("The averaged law works")
    assert "delay ignored" in out
    for name in ("mine.png", "mine-all-laws.png"):
        assert (folder / name).read_bytes().startswith(b"\x89PNG")


def test_init_never_replaces_a_file_unasked(folder, capsys):
    (folder / "problem.toml").write_text("mine")
    code, _, err = run(capsys, "init")
    assert code == 2
    assert err == (
        "deadtime: error: problem.toml exists: choose another name, or replace it with --force.\n"
    )
    assert (folder / "problem.toml").read_text() == "mine"
    assert run(capsys, "init", "--force")[0] == 0
    assert (folder / "problem.toml").read_text().startswith("# A deadtime problem")


def test_a_file_to_start_from_has_a_line_for_every_imperfection_with_its_keys(folder, capsys):
    run(capsys, "init")
    lines = [line.split() for line in (folder / "problem.toml").read_text("utf-8").splitlines()]
    for entry in ENTRIES:
        keys = {key: one for key, one in entry.model_fields.items() if key != "kind"}
        told = [key if one.is_required() else f"({key})" for key, one in keys.items()]
        wanted = ["#", *kinds_of(entry), "#", *", ".join(told).split()]
        assert [*wanted[:-1], f"{wanted[-1]}:"] in [line[: len(wanted)] for line in lines]


def test_simulate_json_equals_the_library(folder, capsys):
    code, out, err = run(capsys, "simulate", "paper", "--json", "--out", "run.svg")
    assert (code, err) == (0, "")
    problem, printed = dt.problems.paper(), json.loads(out)
    for law in problem.laws:
        metrics = problem.simulate(law).metrics()
        assert printed["laws"][law]["ise"] == metrics["ise"]
    assert printed["laws"]["delay ignored"]["settling_time"] is None
    assert (folder / "run.svg").read_text().startswith("<?xml")


@pytest.mark.long
def test_reproduce_writes_the_whole_report(folder, capsys):
    code, out, err = run(capsys, "reproduce")
    assert (code, err) == (0, "")
    assert "unstable if it stops switching" in out
    assert out.rstrip().endswith("Report: report/index.html")
    names = [
        "window",
        "signal",
        "averaged",
        "mode-0-only",
        "mode-1-only",
        "mean",
        "oracle",
        "all-laws",
    ]
    for number, name in enumerate(names, 1):
        for kind in ("png", "svg"):
            assert (folder / "report" / "figures" / f"figure-{number}-{name}.{kind}").exists()
    page = (folder / "report" / "index.html").read_text(encoding="utf-8")
    assert page.count("<li>") >= 5
    assert page.index("unstable if it stops switching") < page.index("Every law on the same signal")
    assert page.count("data:image/png;base64,") == 14
    assert "Stable for every signal?" in page
    assert "averaged: Not stable for every admissible switching signal" in page
    assert "when mode 1 is constant" in page
    assert "not publish its switching signal" in page
    assert "[−12.6961, −6.3725]" in page


def test_reproduce_runs_a_problem_file_and_reports_json(folder, capsys):
    run(capsys, "init", "car.toml", "--example", "follower")
    code, out, _ = run(capsys, "reproduce", "car.toml", "-o", "car", "--no-certificates", "--json")
    assert code == 0
    metrics = json.loads((folder / "car" / "metrics.json").read_text())
    assert json.loads(out) == metrics | {"written": ["car/index.html"]}
    assert all(rate < 0 for rate in json.loads(out)["growth_without_switching"].values())


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["simulate", "none.toml"], "none.toml cannot be read: No such file or directory"),
        (["simulate", "papr"], "problem must be one of paper, three-mode, follower, or a file"),
        (
            ["simulate", "paper", "--out", "run.xyz"],
            "out must end in .png or .svg or .pdf or .pgf, got",
        ),
        (["simulate", "paper", "--out", "no/run.png"], "out 'no/run.png' cannot be written"),
        (["reproduce", "--out", "/proc/report"], " '/proc/report' cannot be written"),
        (["init", "no/problem.toml"], "path 'no/problem.toml' cannot be written"),
        (["simulat", "paper"], 'Unknown command "simulat"'),
        (["simulate"], "requires an argument"),
        (["simulate", "paper", "--fast"], "Unknown option: --fast"),
    ],
)
def test_bad_requests_get_one_line_and_code_2(folder, capsys, arguments, message):
    code, _, err = run(capsys, *arguments)
    assert code == 2
    assert err.startswith("deadtime: error: ")
    assert err.count("\n") == 1
    assert message in err


def test_diverging_loop_is_reported_not_raised(folder, capsys):
    run(capsys, "init")
    text = (folder / "problem.toml").read_text().replace("horizon = 15.0", "horizon = 200.0")
    text += '\n[[law]]\nkind = "delayed"\n'
    (folder / "problem.toml").write_text(text)
    code, out, err = run(capsys, "simulate", "problem.toml")
    assert (code, err) == (0, "")
    assert "loses the plant" in out
    assert "diverged: |x| left 1e100 after t =" in out.replace("\n", " ")


ODD_NAMES = "# states = ", 'states = ["$x", "$\\\\foo$"] # '


def test_names_that_are_no_mathematics_are_drawn_as_they_are(folder, capsys):
    run(capsys, "init")
    text = (folder / "problem.toml").read_text()
    assert ODD_NAMES[0] in text
    (folder / "problem.toml").write_text(text.replace(*ODD_NAMES, 1))
    code, _, err = run(capsys, "simulate", "problem.toml")
    assert (code, err) == (0, "")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("seed = 39", "seed = -1", "seed must be an integer of at least 0, got -1"),
        ("step = 0.01 ", "step = 1e-320 ", "step = 9.99989e-321 s is too short"),
        ("horizon = 15.0", "horizon = 1e18", "horizon = 1e+18 s would hold about"),
        pytest.param("x0 = [-1.0, 1.0]", "x0 = [0.0, 0.0]", None, marks=pytest.mark.long),
        pytest.param(*ODD_NAMES, None, marks=pytest.mark.long),
    ],
)
def test_odd_files_get_a_verdict_or_one_line(folder, capsys, old, new, message):
    run(capsys, "init")
    text = (folder / "problem.toml").read_text()
    assert old in text
    (folder / "problem.toml").write_text(text.replace(old, new, 1))
    code, _, err = run(capsys, "reproduce", "problem.toml", "--no-certificates")
    if message is None:
        assert (code, err) == (0, "")
    else:
        assert code == 2
        assert err.count("\n") == 1
        assert message in err


def test_bound_prints_three_forms_beside_the_published_figures(capsys):
    code, out, err = run(capsys, "bound", "paper", "--dwell-time", "0.2")
    assert (code, err) == (0, "")
    assert "as printed" in out
    assert "sharp" in out
    assert "1.8e-14" in out.replace("1.7e-14", "1.8e-14")
    assert "7e-05" in out
    assert "The theorem says nothing about this loop" in out


def test_bound_json_is_the_library_s(folder, capsys):
    run(capsys, "init", "car.toml", "--example", "follower")
    code, out, _ = run(capsys, "bound", "car.toml", "--json")
    problem = dt.problems.follower()
    assert code == 0
    for form, printed in json.loads(out).items():
        bound = dt.theorem_bound(problem.plant, problem.gains, problem.dwell_time, form=form)
        assert printed["epsilon_star"] == bound.epsilon_star
        assert printed["holds"] == bound.holds


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["bound", "paper", "--dwell-time", "0"], "dwell_time must be positive"),
        (["bound", "none.toml"], "none.toml cannot be read"),
    ],
)
def test_bad_bounds_get_one_line(capsys, arguments, message):
    code, _, err = run(capsys, *arguments)
    assert code == 2
    assert err.count("\n") == 1
    assert message in err


@pytest.mark.long
def test_reproduce_of_an_ideal_problem_says_so(folder, capsys):
    run(capsys, "init")
    text = (folder / "problem.toml").read_text().replace("step = 0.01 ", 'step = "ideal" ')
    (folder / "problem.toml").write_text(text.replace("horizon = 15.0", "horizon = 4.0"))
    code, out, err = run(capsys, "reproduce", "problem.toml", "--no-certificates")
    assert (code, err) == (0, "")
    assert "unstable if it stops switching" in out.replace("\n", " ")
    page = (folder / "report" / "index.html").read_text(encoding="utf-8")
    assert "The loop is ideal" in page
    assert "sampling period" not in page


def test_schema_is_printed_as_json(capsys):
    code, out, _ = run(capsys, "schema")
    assert code == 0
    assert json.loads(out)["properties"].keys() >= {"plant", "gains", "law", "signal", "run"}


def test_installed_command_runs_in_its_own_process():
    command = [sys.executable, "-c", "from deadtime.cli import main; main()", "--version"]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    assert result.stdout.strip() == dt.__version__
    assert result.stderr == ""


@pytest.mark.few(1)
@pytest.mark.parametrize("command", ["simulate", "certify --help", "--help"])
def test_commands_load_what_they_need_only(tmp_path, command):
    """A figure needs matplotlib, a run of some thousand periods no compiler, and help nothing."""
    heavy = {"numba", "scipy.signal", "xarray", "pandas", "cvxpy", "deadtime.scenarios"}
    heavy |= {"deadtime.reports.audit", "deadtime.reports.report", "jinja2", "distributed"}
    if "--help" in command:
        heavy |= {"numpy", "matplotlib", "pydantic"}
    arguments = command.split() if "--help" in command else [command, "follower"]
    code = (
        "import atexit, sys; from deadtime.cli.application import main; import deadtime.cli; "
        f"atexit.register(lambda: print(sorted({heavy!r} & set(sys.modules)), file=sys.stderr)); "
        f"main({arguments!r})"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")},
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stderr) == (0, "[]\n")
    assert not list(tmp_path.rglob("*.nbi"))


def test_a_chain_of_a_log_says_which_switches_lie_between_its_samples(tmp_path, capsys):
    log = tmp_path / "log.csv"
    log.write_text("t,mode\n0,0\n0.1,1\n0.25,0\n0.4,1\n0.62,0\n0.9,1\n1.2,0\n", encoding="utf-8")
    code, out, _ = run(capsys, "fit", str(log), "--step", "0.1")
    assert code == 0
    assert out.startswith("# Between samples of 0.1 s: 2 of 6 switches; the chain moves each to ")
    code, out, _ = run(capsys, "fit", str(log), "--step", "0.01")
    assert (code, out.splitlines()[0]) == (0, "[switching]")
    _, out, _ = run(capsys, "fit", str(log), "--step", "0.1", "--json")
    assert {"switches": 6, "off_grid": 2}.items() <= json.loads(out).items()


def test_a_chain_has_no_figure_to_write(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("log.csv").write_text("t,mode\n0,0\n0.1,1\n0.2,0\n", encoding="utf-8")
    code, _, err = run(capsys, "fit", "log.csv", "--step", "0.1", "--out", "chain.png")
    assert code == 2
    assert "no figure: leave out family, dwell-time, maximum-dwell and out, or the step" in err
    assert not Path("chain.png").exists()
