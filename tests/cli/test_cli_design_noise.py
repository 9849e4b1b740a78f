"""`deadtime design --noise`: inputs within their limit under the noise of a file."""

import json

import pytest

from deadtime.cli import main


def test_the_noise_of_a_file_limits_the_inputs_and_what_has_none_is_refused(tmp_path, capsys):
    problem = tmp_path / "mine.toml"
    problem.write_text(NOISY, encoding="utf-8")
    out = ["--out", str(tmp_path / "found"), "--budget", "20"]
    with pytest.raises(SystemExit):
        main(["design", str(problem), "--noise", "--probability", "0.9", *out, "--json"])
    found = json.loads(capsys.readouterr().out)
    kept = {"kind": "noise", "process": [[0.5]], "measurement": [[0.25]], "probability": 0.9}
    assert found["initial"] == kept
    for arguments, said in (
        (["follower", "--noise"], "--noise needs an imperfection of the kind white-disturbance"),
        ([str(problem), "--noise", "--initial", "2"], "exclude each other: give one"),
    ):
        with pytest.raises(SystemExit) as stopped:
            main(["design", *arguments, *out])
        assert stopped.value.code == 2
        assert said in " ".join(capsys.readouterr().err.split())


def test_one_limit_is_that_of_every_input(tmp_path, capsys):
    out = ["--out", str(tmp_path / "found"), "--budget", "20", "--step", "0.05", "--json"]
    problem = tmp_path / "two.toml"
    problem.write_text(TWO, encoding="utf-8")
    with pytest.raises(SystemExit):
        main(["design", str(problem), "--input-limit", "3", *out])
    assert json.loads(capsys.readouterr().out)["input_limit"] == [3.0, 3.0]


TWO = """\
[plant]
delay = [0.34, 0.13]
A = [[[0.2]], [[0.4]], [[-1.0]]]
B = [[[1.0, 0.5]], [[0.7, 0.5]], [[1.0, 1.0]]]
[gains]
lqr = { Q = [[1.0]], R = [[1.0, 0.0], [0.0, 1.0]] }
[signal]
kind = "constant"
mode = 0
[run]
x0 = [0.2]
horizon = 4.0
step = 0.1
"""

NOISY = """\
[plant]
delay = 0.34
A = [[[0.2]], [[0.4]]]
B = [[[1.0]], [[0.7]]]
[gains]
poles = [-2.0]
[[imperfection]]
kind = "white-disturbance"
intensity = 0.5
[[imperfection]]
kind = "noise"
std = 0.5
[signal]
kind = "constant"
mode = 0
[run]
x0 = [0.2]
horizon = 4.0
step = 0.1
"""
