"""The dwell time and the mean sojourn of a problem have one source each, and it is said."""

import dataclasses
import json

import pytest

import deadtime as dt
from deadtime.cli.application import main
from deadtime.problems.comparison import compare
from deadtime.problems.file import load_problem
from deadtime.problems.switching_assumptions import dwell_time_of, mean_sojourn_of
from deadtime.reports.report import write_report

FILE = """
[plant]
A = [[[-0.5, 1.0], [0.0, -1.0]], [[-0.4, 1.0], [0.0, -1.0]]]
B = [[[0.0], [1.0]], [[0.0], [1.0]]]
delay = 0.2
[gains]
poles = [-1.0, -2.0]
[signal]
kind = "random"
seed = 3
{signal}
[[law]]
kind = "averaged"
[run]
x0 = [1.0, 0.0]
horizon = 4.0
step = 0.1
"""


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as stopped:
        main([str(one) for one in arguments])
    out = capsys.readouterr()
    return stopped.value.code, out.out, out.err


@pytest.fixture
def file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def write(signal):
        path = tmp_path / "p.toml"
        path.write_text(FILE.format(signal=signal), encoding="utf-8")
        return path

    return write


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("signal", "options", "expected"),
    [
        ("dwell_time = 0.6\nmean_sojourn = 1.1", (), (0.6, 1.1)),
        ("dwell_time = 0.6", (), (0.6, 1.2)),
        ("dwell_time = 0.6\nmean_sojourn = 1.1", ("--dwell-time", "0.3"), (0.3, 1.1)),
        ("dwell_time = 0.6\nmean_sojourn = 1.1", ("--mean-sojourn", "3"), (0.6, 3.0)),
    ],
)
def test_monte_carlo_draws_what_the_file_states(file, capsys, signal, options, expected):
    arguments = ("monte-carlo", file(signal), "--scenarios", 3, *options)
    code, out, _ = run(capsys, *arguments, "--json")
    record = json.loads(out)
    assert code == 0
    assert (record["dwell_time"], record["mean_sojourn"]) == pytest.approx(expected)
    _, out, _ = run(capsys, *arguments)
    text = " ".join(out.split())
    whole = "the problem's mean sojourn" if "mean_sojourn" in signal else "twice the dwell time"
    whole = "as given" if "--mean-sojourn" in options else whole
    dwell = "as given" if "--dwell-time" in options else "the problem's dwell time"
    assert f"Dwell time {expected[0]:g} s: {dwell}." in text
    assert f"Mean sojourn {expected[1]:g} s: {whole}." in text


def test_a_dwell_time_of_zero_goes_with_the_mean_that_the_file_states(file, capsys):
    path = file("dwell_time = 0.6\nmean_sojourn = 1.1")
    code, out, err = run(capsys, "monte-carlo", path, "--scenarios", 3, "--dwell-time", 0, "--json")
    assert (code, err) == (0, "")
    assert json.loads(out)["mean_sojourn"] == 1.1
    code, _, err = run(capsys, "monte-carlo", file("dwell_time = 0.6"), "--dwell-time", 0)
    assert (code, "or 0 with a --mean-sojourn" in err) == (2, True)


def test_the_bound_of_a_plant_that_a_rule_switches_takes_the_dwell_time_asked_for(file, capsys):
    path = file("")
    text = path.read_text(encoding="utf-8").replace('"random"\nseed = 3', '"half-space"')
    path.write_text(text.replace("[[law]]", "normal = [1.0, 0.0]\n[[law]]"), encoding="utf-8")
    code, out, err = run(capsys, "bound", path, "--dwell-time", 0.5)
    assert (code, err) == (0, "")
    assert "Dwell time 0.5 s (as given)." in " ".join(out.split())
    code, _, err = run(capsys, "bound", path)
    assert (code, "give --dwell-time" in err) == (2, True)


@pytest.mark.long
def test_report_bound_and_certificate_ask_about_the_file_s_dwell_time(file, capsys, tmp_path):
    path = file("dwell_time = 0.6\nmean_sojourn = 1.1")
    problem = load_problem(path)
    assert problem.signal.dwell_time > 0.6
    page = write_report(problem, tmp_path / "report").path.read_text(encoding="utf-8")
    assert page.count("0.6 s (the problem&#39;s dwell time)") == 2
    _, out, _ = run(capsys, "bound", path)
    assert "Dwell time 0.6 s (the problem's dwell time)." in " ".join(out.split())
    _, out, _ = run(capsys, "certify", path)
    assert "at least 0.6 s (the problem's dwell time)" in " ".join(out.split())


def test_what_a_problem_does_not_state_is_taken_from_its_signal_and_said():
    paper = dt.problems.paper()
    unsaid = dataclasses.replace(paper, signals=dt.SignalClass(), mean_sojourn=None)
    assert dwell_time_of(unsaid, unsaid.signal) == (0.2, "the shortest sojourn of its signal")
    model = dt.Markov([[-1.0, 1.0], [1.0, -1.0]])
    drawn = dataclasses.replace(unsaid, switching=model, signal=model.sample(9.0, seed=1))
    assert "of the one signal drawn; others may" in dwell_time_of(drawn, drawn.signal).source
    still = dt.SwitchingSignal.constant(0)
    assert dwell_time_of(unsaid, still).value == unsaid.horizon
    assert "never switches" in dwell_time_of(unsaid, still).source
    assert mean_sojourn_of(unsaid, 0.3) == (0.6, "twice the dwell time")
    assert mean_sojourn_of(paper, 0.3) == (0.4, "the problem's mean sojourn")
    assert mean_sojourn_of(paper, 0.5).value == 1.0
    assert "the problem's, 0.4 s, is too short" in mean_sojourn_of(paper, 0.5).source


def test_comparison_of_a_named_problem_is_about_its_own_dwell_time():
    result = compare(dt.problems.follower())
    assert dwell_time_of(result.problem, result.signal).value == 1.0
