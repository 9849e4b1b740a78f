"""On how many plants that an uncertain one may be a law is stable."""

import json

import numpy as np
import pytest

import deadtime as dt
from deadtime.cli.application import main
from deadtime.margins import drawn_stability

H = 0.1
MODES = dt.SwitchedSystem([[[0.5]], [[0.8]]], [[[1.0]], [[1.3]]], delay=0.237)
LAW = dt.AveragedPredictor(MODES, [[[-1.5]], [[-1.2]]])
WIDE = dt.UncertainPlant(MODES, np.diag([0.4, 0.4, 0.4, 0.4, 0.05]) ** 2)


def growth_by_hand(a, b, D, row):
    """ln ρ/h of x' = a x + b u(t − D), D in (h N − h, h N), the input as the law's row says."""
    N = int(np.ceil(D / H))
    fresh = N * H - D
    new, all_of_it = b * np.expm1(a * fresh) / a, b * np.expm1(a * H) / a
    gain, past = row
    order = 1 + max(N, len(past))
    M = np.zeros((order, order))
    M[0, 0] = np.exp(a * H)
    now = np.concatenate(([gain], past, np.zeros(order - 1 - len(past))))
    for lag, weight in ((N, all_of_it - new), (N - 1, new)):
        M[0] += weight * (now if lag == 0 else np.eye(order)[lag])
    M[1] = now
    M[2:, 1:-1] = np.eye(order - 2)
    return np.log(np.abs(np.linalg.eigvals(M)).max()) / H


def test_rates_are_those_of_the_loop_by_hand():
    found = drawn_stability(WIDE, LAW, H, count=30, seed=2)
    table = LAW.digital(H)
    expected = [
        [
            growth_by_hand(
                one.A[i, 0, 0],
                one.B[i, 0, 0],
                one.delays[0, 0],
                (table.state_gain[0, 0, 0], table.input_gain[0, :, 0, 0]),
            )
            for i in range(2)
        ]
        for one in WIDE.draw(30, seed=2)
    ]
    np.testing.assert_allclose(found.growth, expected, atol=1e-7)
    assert 0 < found.stable < 30
    assert "decay in every mode held, the fastest grows at +" in found.sentence


def test_a_law_that_is_no_table_is_refused():
    rule = dt.HalfSpace([1.0], 0.0)
    law = dt.StateDependentPredictor(MODES, [[[-1.5]], [[-1.2]]], rule)
    with pytest.raises(dt.ArgumentError, match=r"law must be a table.*StateDependentPredictor"):
        drawn_stability(WIDE, law, H)


FILE = """
[plant]
delay = 0.237
A = [[[0.5]], [[0.8]]]
B = [[[1.0]], [[1.3]]]
[uncertainty]
covariance = {covariance}
[gains]
K = [[[-1.5]], [[-1.2]]]
[[law]]
kind = "averaged"
[[law]]
kind = "exact"
[signal]
kind = "constant"
mode = 0
[run]
x0 = [1.0]
horizon = 3.0
step = 0.1
"""


def test_robustness_says_it_of_every_law_of_a_file(tmp_path, capsys):
    file = tmp_path / "p.toml"
    file.write_text(FILE.format(covariance=WIDE.covariance.tolist()), encoding="utf-8")
    picture = str(tmp_path / "p.png")
    with pytest.raises(SystemExit) as ended:
        main(["robustness", str(file), "--scenarios", "1", "--json", "--out", picture])
    assert ended.value.code == 0
    drawn = json.loads(capsys.readouterr().out)["drawn_plants"]
    assert list(drawn) == ["averaged", "oracle"]
    found = drawn_stability(WIDE, LAW, H)
    assert drawn["averaged"]["stable"] == found.stable
    assert drawn["averaged"]["slowest"] == pytest.approx(found.growth.max())


def test_a_covariance_of_another_size_is_refused_with_its_line(tmp_path):
    from deadtime.problems import load_problem

    file = tmp_path / "p.toml"
    file.write_text(FILE.format(covariance="[[1.0]]"), encoding="utf-8")
    with pytest.raises(dt.ProblemFileError, match=r"line 7, \[uncertainty\]: covariance must have"):
        load_problem(file)
