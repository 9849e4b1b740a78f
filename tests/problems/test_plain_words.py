"""Messages that name what was meant: another kind's key, ragged rows, variances, constants."""

import json
import re

import numpy as np
import pytest

import deadtime as dt
from deadtime.cli.application import main
from deadtime.problems.file import load_problem
from deadtime.scenarios import draw_signals

FILE = """\
[plant]
delay = 0.25
A = [[[0.0, 1.0], [0.0, -0.5]], [[0.0, 1.1], [0.0, 0.3]]]
B = [[[0.0], [1.0]], [[0.0], [0.8]]]
[gains]
poles = [-0.7, -1.0]
[switching]
kind = "markov"
rates = [[0.0, 0.5], [0.7, 0.0]]
[[law]]
kind = "averaged"
[observer]
kind = "luenberger"
C = [[1.0, 0.0]]
poles = [-3.0, -4.0]
[mode_filter]
covariance = 1.0
noise = 0.1
[signal]
kind = "model"
[run]
x0 = [1.0, 0.0]
horizon = 3.0
step = 0.1
"""
PLANT = dt.SwitchedSystem(
    [[[0.0, 1.0], [0.0, -0.5]], [[0.0, 1.1], [0.0, 0.3]]], [[[0.0], [1.0]], [[0.0], [0.8]]], 0.25
)
MODEL = dt.Markov([[0.0, 0.5], [0.7, 0.0]])
SERVO = dt.Servo(PLANT, [[1.0, 0.0]])
GAINS = SERVO.lqr(np.eye(3), [[1.0]], step=0.1)
LOOP = dt.OutputFeedback(
    dt.AveragedPredictor(SERVO.plant, GAINS, allow_unstable=True),
    dt.luenberger(SERVO.model, SERVO.C, [-3.0, -4.0], 0.1),
    servo=SERVO,
)


def write(tmp_path, old="", new=""):
    path = tmp_path / "mine.toml"
    path.write_text(FILE.replace(old, new) if old else FILE, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("poles = [-3.0, -4.0]", "poles = [-3.0, -4.0]\nprocess = [[1.0]]",
         'line 16: observer.process belongs to kind = "kalman" only: remove it, or'),
        ("covariance = 1.0", "covariance = -1.0", "covariance must be positive semidefinite, got"),
        ("[[0.0, 1.1], [0.0, 0.3]]", "[[0.0, 1.1], [0.0]]", "give every row, and every matrix, as"),
    ],
)  # fmt: skip
def test_a_file_is_told_what_is_wrong(tmp_path, old, new, message):
    with pytest.raises(dt.ProblemFileError, match=re.escape(message)):
        load_problem(write(tmp_path, old, new))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: dt.AveragedPredictor(SERVO.plant, GAINS), "x[3] never moves (its rows of A and B"),
        (lambda: dt.OutputModeFilter(PLANT, MODEL, 0.1, [[1.0, 0.0]]), "covariance must be given"),
        (lambda: dt.Controller(LOOP, 0.1).update([1.0, 2.0], mode=0), "y must have shape (1,)"),
        (
            lambda: dt.Controller(LOOP, 0.1).update([1.0]),
            "mode must be given: the observer depends on it. It is one of 0 to 1; where nothing "
            "measures it, a `BeliefPredictor` tells it from x or y; an observer designed with "
            'model="mean" reads none.',
        ),
        (lambda: SERVO.complete(-GAINS[:, :, :3]), "gains must make (x, q) decay in every mode"),
        (lambda: SERVO.steady_input(1.0, [1.0]), "force must have shape (n,) = (2,) or (modes, n)"),
    ],
)
def test_python_is_told_what_is_wrong(call, message):
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        call()


@pytest.mark.long
def test_monte_carlo_draws_from_the_model_of_the_file_unless_told_otherwise(tmp_path, capsys):
    path, data = write(tmp_path), tmp_path / "all.csv"
    options = ["--scenarios", "8", "--out", str(tmp_path / "a.png"), "--json"]
    with pytest.raises(SystemExit) as stopped:
        main(["monte-carlo", str(path), "--data", str(data), *options])
    assert stopped.value.code == 0
    told = json.loads(capsys.readouterr().out)
    assert told["dwell_time"] is None
    assert told["model"] == repr(MODEL)
    problem = load_problem(path)
    signals = draw_signals(MODEL, 3.25, count=8)
    law = problem.laws["averaged"]
    found = [dt.simulate(PLANT, law, one, [1.0, 0.0], 3.0, 0.1).metrics() for one in signals]
    costs = [float(line.split(",")[4]) for line in data.read_text("utf-8").splitlines()[1:]]
    assert costs == pytest.approx([one["cost"] for one in found], rel=1e-9)
    with pytest.raises(SystemExit):
        main(["monte-carlo", str(path), "--dwell-time", "0.2", *options])
    assert json.loads(capsys.readouterr().out)["dwell_time"] == 0.2


def test_certify_asks_for_a_dwell_time_where_a_model_promises_none(tmp_path, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["certify", str(write(tmp_path))])
    assert stopped.value.code == 2
    assert "give --dwell-time" in capsys.readouterr().err
