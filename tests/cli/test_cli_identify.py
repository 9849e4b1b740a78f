"""`deadtime identify`: a table, sentences, files; and what it refuses."""

import json
import os
import sys

import numpy as np
import pandas as pd
import pytest

from deadtime.cli import main
from deadtime.cli.identify import _modes
from deadtime.problems import load_problem
from terminal import on_a_terminal


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A log of dx/dt = 0.5 x + u(t − 0.27) in a loop, and a problem of that plant."""
    rng, h = np.random.default_rng(0), 0.1
    x, u = np.zeros(300), rng.standard_normal(300)
    half, late = np.exp(0.05), 2.0 * (np.exp(0.05) - np.exp(0.015))
    for k in range(300):
        u[k] -= 0.9 * x[k]
        if 3 <= k < 299:
            soon = 2.0 * (np.exp(0.015) - 1.0)
            x[k + 1] = half * x[k] + late * u[k - 3] + soon * u[k - 2]
            x[k + 1] += 0.01 * rng.standard_normal()
    place = tmp_path_factory.mktemp("identify")
    pd.DataFrame({"t": h * np.arange(300), "x": x, "u": u}).to_csv(place / "log.csv", index=False)
    return place


def said(arguments, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["identify", *map(str, arguments)])
    captured = capsys.readouterr()
    return stopped.value.code, captured.out, captured.err


def test_a_log_becomes_a_table_a_problem_and_a_verdict(folder, capsys):
    asked = [folder / "log.csv", "--one-mode", "--delay", 0, 1]
    code, out, _ = said([*asked, "--out", folder / "problem.toml"], capsys)
    assert code == 0
    assert "The delay is 0.2" in out
    low, high = (float(one) for one in out.partition("\ndelay")[2].split()[1:3])
    assert low < 0.27 < high
    delay = load_problem(folder / "problem.toml").plant.delay
    assert low < delay < high
    beside = [*asked, "--beside", folder / "problem.toml", "--json"]
    code, out, _ = said([*beside, "--figure", folder / "fit.svg"], capsys)
    record = json.loads(out)
    assert record["delays"] == [[delay]]
    assert "each mode held: Delay" in record["sentences"][-1]
    assert record["written"] == [str(folder / "fit.svg")]
    assert (folder / "fit.svg").read_text(encoding="utf-8").count("<svg") == 1


def test_a_file_of_another_program_is_read_by_the_options_that_its_refusal_names(folder, capsys):
    table = pd.read_csv(folder / "log.csv")
    stamps = pd.Timestamp("2026-03-02 08:15:00") + pd.to_timedelta(table["t"], unit="s")
    names = {"t": "Time", "x": "Level [cm]", "u": "Pump, main"}
    plant = table.assign(t=stamps.dt.strftime("%d.%m.%Y %H:%M:%S,%f")).rename(columns=names)
    path = folder / "plant.csv"
    plant.to_csv(path, index=False, sep=";", decimal=",")
    code, _, error = said([path], capsys)
    assert code == 2
    advice = '--time Time --states "Level [cm]" --inputs "Pump, main"'
    assert f"For this file perhaps: deadtime identify {path} {advice}" in error
    given = ["--time", "Time", "--states", "Level [cm]", "--inputs", "Pump, main"]
    code, out, _ = said([path, *given, "--delay", 0, 1, "--json"], capsys)
    record = json.loads(out)
    assert code == 0
    assert record["read_as"] == [
        "Read as: columns separated by semicolons, decimal commas; times dd.mm.yyyy hh:mm:ss from "
        "2026-03-02 08:15:00.",
        "No column mode: one mode.",
    ]
    assert record["sentences"][-2:] == record["read_as"]
    plain = said([folder / "log.csv", "--delay", 0, 1, "--json"], capsys)[1]
    np.testing.assert_allclose(record["delays"], json.loads(plain)["delays"], rtol=1e-9)


def test_switching_is_fitted_to_a_file_of_another_program(tmp_path, capsys):
    modes = np.resize(["open", "shut"], 60)
    time = np.cumsum(np.random.default_rng(1).uniform(1.0, 3.0, 60)).round(2)
    table = pd.DataFrame({"Time [s]": time, "Valve": modes})
    table.to_csv(tmp_path / "log.csv", index=False, sep=";", decimal=",")
    given = [tmp_path / "log.csv", "--time", "Time [s]", "--mode", "Valve", "--labels.open", 0]
    given += ["--labels.shut", 1, "--out", tmp_path / "fit.png", "--json"]
    with pytest.raises(SystemExit) as stopped:
        main(["fit", *map(str, given)])
    record = json.loads(capsys.readouterr().out)
    assert stopped.value.code == 0
    assert record["read_as"] == ["Read as: columns separated by semicolons, decimal commas."]


def test_a_delay_beyond_the_range_is_not_found_and_the_exit_code_says_so(folder, capsys):
    out = folder / "short.toml"
    code, text, _ = said(
        [folder / "log.csv", "--one-mode", "--delay", 0, 0.25, "--out", out], capsys
    )
    assert code == 1
    assert text.replace("\n", " ").startswith(
        "Delay not found: the best fit is at the longest delay of the range searched, 0 … 0.25 s. "
        "Repeat with --delay 0 3"
    )
    assert text.partition("\ndelay")[2].split()[:2] == ["0.25", "disturbance[0][0,0]"]
    kept = out.read_text(encoding="utf-8")
    assert kept.startswith("# Delay not found: the best fit is at the longest delay of the range")
    assert "delay = 0.25    # s; not found: see above" in kept
    assert "covariance" not in kept
    beside = [folder / "log.csv", "--one-mode", "--delay", 0, 0.25, "--beside", out, "--json"]
    record = json.loads(said(beside, capsys)[1])
    assert record["delay_interval"] == [[None]]
    assert record["intervals"]["delay"] is None
    assert len(record["intervals"]["A[0][0,0]"]) == 2
    assert "held: Nothing is known of the delay, not found" in record["sentences"][-1]


def test_a_terminal_is_told_what_is_being_done(folder):
    command = [sys.executable, "-m", "deadtime", "identify", "log.csv", "--one-mode"]
    able = os.environ | {"TERM": "xterm"}  # of a dumb one nothing can be taken back
    seen, out = on_a_terminal(command, pipe_stdout=True, cwd=folder, env=able)
    assert b"looking for the delay between 0 and 2 s" in seen
    assert b"looking for" not in out


def test_columns_have_commas_between_them_or_in_them(folder, capsys):
    log = pd.read_csv(folder / "log.csv")
    log["y"] = np.roll(log["x"], 1)
    log.rename(columns={"x": "speed", "u": "force, N"}).to_csv(folder / "named.csv", index=False)
    asked = [folder / "named.csv", "--one-mode", "--delay", 0, 1, "--json"]
    ends = []
    for columns in (
        ["--states", "speed, y", "--inputs", "force, N"],
        ["--states", "speed", "--states", "y", "--inputs", "force, N"],
    ):
        code, out, _ = said([*asked, *columns], capsys)
        assert code == 0
        ends.append(json.loads(out)["A"])
    assert ends[0] == ends[1]
    assert np.shape(ends[0]) == (1, 2, 2)
    _, _, error = said([*asked, "--states", "speed,current", "--inputs", "force, N"], capsys)
    assert "must have the column 'current'" in error


def test_what_cannot_be_done_is_one_line(folder, capsys):
    log = folder / "log.csv"
    assert said([log, "--modes", "gear"], capsys)[0] == 2
    assert "logs must be given" in said([], capsys)[2]
    assert "law needs beside" in said([log, "--one-mode", "--law", "mean"], capsys)[2]
    assert (
        "modes must be left out beside one-mode"
        in said([log, "--one-mode", "--modes", 2], capsys)[2]
    )


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["--beside", "no.toml"], "no.toml"),
        (["--beside", "paper", "--law", "no"], "law must be one of"),
        (["--out", "no/problem.toml"], "out 'no/problem.toml' cannot be written: there is no"),
        (
            ["--figure", "fit.docx"],
            "figure must end in .png or .svg or .pdf or .pgf, got 'fit.docx'",
        ),
        (["--report", "no/fit.html"], "report 'no/fit.html' cannot be written"),
        (["--out", "log.csv"], "log.csv is read, or written twice: choose another name"),
        (["--out", "a.html", "--report", "a.html"], "a.html is read, or written twice"),
    ],
)
def test_what_cannot_be_written_or_read_is_said_before_the_work(
    given, message, folder, monkeypatch, capsys
):
    monkeypatch.chdir(folder)
    monkeypatch.setattr("deadtime.identification.identify", None)  # not to be called
    code, out, err = said(["log.csv", "--one-mode", *given], capsys)
    assert (code, out) == (2, "")
    assert message in err


def test_a_law_of_another_plant_loses_nothing_of_what_the_log_tells(folder, capsys):
    file, asked = folder / "kept.toml", [folder / "log.csv", "--one-mode", "--delay", 0, 1]
    code, out, err = said([*asked, "--out", file, "--beside", "paper"], capsys)
    assert code == 2
    assert "beside must have the modes, states and inputs of the log, (1, 1, 1)" in err
    assert "The delay is 0.2" in out
    assert load_problem(file).plant.states == 1


@pytest.mark.parametrize(
    ("names", "end"),
    [
        (("rising", "falling"), "; modes 0 = falling, 1 = rising"),
        ((1, 2), "; modes 0 = 1, 1 = 2"),
        ((0, 1), ""),
    ],
)
def test_which_mode_is_which_is_said(names, end, tmp_path, capsys):
    named = two_modes(120).assign(mode=np.take(names, np.repeat(np.arange(6) % 2, 20)))
    named.to_csv(tmp_path / "log.csv", index=False)
    asked = [tmp_path / "log.csv", "--delay", 0, 1, "--no-noise"]
    assert said(asked, capsys)[1].splitlines()[1] == f"A plant from 120 samples, every 0.1 s{end}"
    assert len(json.loads(said([*asked, "--json"], capsys)[1])["modes"]) == 2


def two_modes(count=300):
    """A log of dx/dt = −x + u(t − 0.27) that turns into x + 2 u and back, without its modes."""
    rng, h = np.random.default_rng(1), 0.1
    mode = np.repeat(np.arange(count) % 2, rng.integers(10, 30, count))[:count]
    rate, push = np.where(mode, 0.5, -1.0), np.where(mode, 2.0, 1.0)
    x, u = np.zeros(count), rng.standard_normal(count)
    for k in range(count):
        u[k] -= 0.8 * x[k]
        if 3 <= k < count - 1:
            a, b = rate[k], push[k]
            whole, soon = np.expm1(a * h) / a, np.expm1(0.03 * a) / a
            x[k + 1] = np.exp(a * h) * x[k] + b * (whole - soon) * u[k - 3] + b * soon * u[k - 2]
            x[k + 1] += 0.01 * rng.standard_normal()
    return pd.DataFrame({"t": h * np.arange(count), "x": x, "u": u})


def test_digits_are_a_number_of_modes_and_all_else_a_column():
    assert [_modes(text) for text in ("2", "1..3", "gear", "2nd")] == [
        2,
        range(1, 4),
        "gear",
        "2nd",
    ]


@pytest.mark.long
def test_modes_that_were_not_logged_end_in_a_file_that_runs_alone(tmp_path, monkeypatch, capsys):
    """Without a mode sensor."""
    monkeypatch.chdir(tmp_path)
    log, out = tmp_path / "log.csv", tmp_path / "problem.toml"
    two_modes().to_csv(log, index=False)
    asked = [log, "--modes", "1..2", "--switches", "samples", "--delay", 0, 0.6]
    code, text, _ = said([*asked, "--out", out, "--json"], capsys)
    record = json.loads(text)
    assert code == 0
    assert record["hidden"]["numbers"] == [1, 2]
    assert record["hidden"]["bic"][0] > record["hidden"]["bic"][1]
    assert np.abs(np.array(record["delays"]) - 0.27).max() < 2e-3
    problem = load_problem(out)
    assert problem.plant.modes == 2
    assert "belief" in problem.laws
    with pytest.raises(SystemExit) as stopped:
        main(["simulate", str(out), "--law", "belief", "--json"])
    assert stopped.value.code == 0
    run = json.loads(capsys.readouterr().out)["laws"]["belief"]
    assert run["diverged"] is False
    plain = said([log, "--modes", 2, "--switches", "samples", "--delay", 0, 0.6], capsys)[1]
    assert "Modes were not logged" in " ".join(plain.split())


def test_a_run_that_simulate_writes_is_a_log_with_the_names_of_the_file(tmp_path, capsys):
    """Two modes, a delay of 6.8 periods, a force of noise: true values lie in the intervals."""
    problem = tmp_path / "mine.toml"
    problem.write_text(RUN, encoding="utf-8")
    out = ["--out", str(tmp_path / "run.png"), "--csv", str(tmp_path / "run")]
    with pytest.raises(SystemExit) as stopped:
        main(["simulate", str(problem), *out, "--json"])
    assert stopped.value.code == 0
    assert json.loads(capsys.readouterr().out)["written"][-1] == str(tmp_path / "run.csv")
    header = (tmp_path / "run.csv").read_text(encoding="utf-8").splitlines()[0]
    assert header == 'time,x[0]: "gap" (m),u[0]: force (N),mode,w[0]'.replace(
        'x[0]: "gap" (m)', '"x[0]: ""gap"" (m)"'
    )
    back = tmp_path / "back.toml"
    code, text, _ = said(
        [tmp_path / "run.csv", "--no-noise", "--delay", 0, 1, "--out", back, "--json"], capsys
    )
    assert code == 0
    intervals = json.loads(text)["intervals"]
    for name, value in {"A[0]": -0.6, "A[1]": 0.4, "B[0]": 1.0, "B[1]": 0.7}.items():
        low, high = intervals[f"{name}[0,0]"]
        assert low < value < high
    low, high = intervals["delay"]
    assert low < 0.34 < high < 0.5
    again = load_problem(back)
    assert (again.states, again.inputs) == (('"gap" (m)',), ("force (N)",))


def test_a_log_of_each_law_and_a_name_that_is_no_csv(tmp_path, capsys):
    problem = tmp_path / "mine.toml"
    laws = '[[law]]\nkind = "delayed"\n'
    problem.write_text(RUN + laws, encoding="utf-8")
    out = ["simulate", str(problem), "--out", str(tmp_path / "run.png"), "--csv"]
    with pytest.raises(SystemExit):
        main([*out, str(tmp_path / "run.csv")])
    assert {one.name for one in tmp_path.glob("*.csv")} == {
        "run-averaged.csv", "run-delay-ignored.csv"
    }  # fmt: skip
    (tmp_path / "run.png").unlink()
    with pytest.raises(SystemExit) as stopped:
        main([*out, str(tmp_path / "run.txt")])
    assert stopped.value.code == 2
    assert "csv must end in .csv" in capsys.readouterr().err
    assert not (tmp_path / "run.png").exists()  # before anything is run
    # Names of laws that are one name of a file.
    problem.write_text(RUN + laws + 'name = "Averaged!"\n', encoding="utf-8")
    with pytest.raises(SystemExit):
        main([*out, str(tmp_path / "both.csv")])
    assert {one.name for one in tmp_path.glob("both*.csv")} == {
        "both-averaged.csv", "both-averaged-2.csv"
    }  # fmt: skip


RUN = """\
[plant]
delay = 0.34
A = [[[-0.6]], [[0.4]]]
B = [[[1.0]], [[0.7]]]
states = ['"gap" (m)']
inputs = ["force (N)"]
[gains]
poles = [-2.0]
[[imperfection]]
kind = "white-disturbance"
intensity = 0.5
[signal]
kind = "random"
dwell_time = 0.6
mean_sojourn = 1.1
seed = 3
[run]
x0 = [0.2]
horizon = 40.0
step = 0.05
[[law]]
kind = "averaged"
"""
