"""`deadtime identify`: a table, sentences, files; and what it refuses."""

import json

import numpy as np
import pandas as pd
import pytest

from deadtime.cli import main
from deadtime.problems import load_problem


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


def test_what_cannot_be_done_is_one_line(folder, capsys):
    log = folder / "log.csv"
    assert said([log], capsys)[0] == 2
    assert "logs must be given" in said([], capsys)[2]
    assert "law needs beside" in said([log, "--one-mode", "--law", "mean"], capsys)[2]
    other = said([log, "--one-mode", "--delay", 0, 1, "--beside", "paper"], capsys)
    assert "must have the modes, states and inputs of the log, (1, 1, 1)" in other[2]
