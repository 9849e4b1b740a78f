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
    assert "Standard error of delay to be expected" in text
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


def test_what_cannot_be_done_is_one_line(capsys):
    limit = ["--input-limit", 1, "--horizon", 30]
    assert "disturbance must be given" in said(["paper", *limit], capsys)[2]
    noise = ["--disturbance", 1e-3]
    assert "law must be given" in said(["paper", *limit, *noise], capsys)[2]
    assert "input-limit must be numbers" in said(["paper", "--input-limit", "a", *noise], capsys)[2]
