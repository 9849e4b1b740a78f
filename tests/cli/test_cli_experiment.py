"""`deadtime experiment`: a table to replay, what it promises, and what it refuses."""

import json

import pandas as pd
import pytest

from deadtime.cli import main


def said(arguments, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["experiment", *map(str, arguments)])
    captured = capsys.readouterr()
    return stopped.value.code, captured.out, captured.err


ASKED = ["paper", "--input-limit", 5, "--law", "averaged", "--disturbance", 1e-5]
SHORT = ["--horizon", 8, "--step", 0.1, "--sojourn", 1, "--hold", 2]


def test_an_experiment_is_a_table_and_its_errors_stand_beside_those_of_a_prbs(tmp_path, capsys):
    out = tmp_path / "inputs.csv"
    code, text, _ = said([*ASKED, *SHORT, "--out", out], capsys)
    assert code == 0
    assert "Expected standard error of delay" in text
    assert "B[1][1,0]" in text
    table = pd.read_csv(out)
    assert list(table.columns) == ["t", "add_u1", "mode"]
    assert table["mode"].tolist()[:25:10] == [0, 1, 0]
    code, text, _ = said([*ASKED, *SHORT, "--out", out, "--json"], capsys)
    record = json.loads(text)
    errors = record["delay_errors"]
    assert errors["experiment"][0] < errors["prbs"][0]
    assert record["errors"]["delay"] == errors["experiment"][0]
    assert record["written"] == [str(out)]


NOISY = """
[plant]
A = [[[-1.0]]]
B = [[[1.0]]]
delay = 0.27
[gains]
K = [[[-0.5]]]
[signal]
kind = "constant"
mode = 0
[run]
x0 = [1.0]
horizon = 6
step = 0.1
[[imperfection]]
kind = "white-disturbance"
intensity = 1e-3
[[imperfection]]
kind = "noise"
std = 0.02
"""


def test_the_noise_of_the_file_s_sensors_is_counted_unless_another_is_given(tmp_path, capsys):
    problem = tmp_path / "noisy.toml"
    problem.write_text(NOISY)
    asked = [problem, "--input-limit", 1, "--out", tmp_path / "inputs.csv", "--json"]
    records = [
        json.loads(said([*asked, *more], capsys)[1])
        for more in ([], ["--noise", 0.02], ["--noise", 0])
    ]
    errors = [one["errors"]["delay"] for one in records]
    assert errors[0] == errors[1] > 1.5 * errors[2]
    assert "deviations of 0.02." in records[0]["sentences"][-1]
    assert "noise must be numbers" in said([*asked, "--noise", "much"], capsys)[2]
    problem.write_text(NOISY + '[observer]\nkind = "luenberger"\nC = [[1.0]]\npoles = [-3.0]\n')
    assert "noise must be given where the problem measures outputs" in said(asked, capsys)[2]


def test_the_disturbances_of_the_file_add_up(tmp_path, capsys):
    one, two = tmp_path / "one.toml", tmp_path / "two.toml"
    one.write_text(NOISY)
    half = '[[imperfection]]\nkind = "white-disturbance"\nintensity = 5e-4\n'
    two.write_text(NOISY.replace("1e-3", "5e-4") + half)
    limit = ["--input-limit", 1, "--out", tmp_path / "inputs.csv", "--json"]
    errors = [json.loads(said([file, *limit], capsys)[1])["errors"]["delay"] for file in (one, two)]
    assert errors[1] == pytest.approx(errors[0], rel=1e-9)


def test_what_cannot_be_done_is_one_line(capsys):
    limit = ["--input-limit", 1, "--horizon", 30]
    assert "disturbance must be given" in said(["paper", *limit], capsys)[2]
    noise = ["--disturbance", 1e-3]
    assert "law must be given" in said(["paper", *limit, *noise], capsys)[2]
    assert "input-limit must be numbers" in said(["paper", "--input-limit", "a", *noise], capsys)[2]
