"""Tables of many runs: intervals beside medians, and LaTeX that says the same numbers."""

import re

import numpy as np
import pytest
import xarray as xr

import deadtime as dt
from deadtime.reports import summary, sweep_table

LAWS = ("mean", "averaged", "oracle")


def many(costs, lost=None, laws=LAWS):
    """A dataset as `monte_carlo` returns it."""
    dims = ("law", "scenario")
    lost = np.zeros_like(costs, dtype=bool) if lost is None else lost
    metrics = {"cost": (dims, costs), "ise": (dims, costs), "diverged": (dims, lost)}
    return xr.Dataset(metrics, {"law": list(laws)})


def sweep(values, lost=None, metric="ise", laws=LAWS, oracle="oracle", done=None):
    """A dataset as `open_sweep` returns it: two delays, one period."""
    dims = ("delay", "step", "law", "scenario")
    lost = np.zeros_like(values, dtype=bool) if lost is None else lost
    done = np.ones(values.shape[:2]) if done is None else done
    variables = {metric: (dims, values), "diverged": (dims, lost), "done": (dims[:2], done)}
    names = {"delay": [0.5, 1.0], "step": [0.01], "law": list(laws)}
    return xr.Dataset(variables, names, {"oracle": oracle})


def cells(latex):
    """The cells of a booktabs table, row by row, its heading first."""
    rows = [line for line in latex.splitlines() if line.endswith(r"\\")]
    return [[cell.strip() for cell in row.removesuffix(r"\\").split("&")] for row in rows]


def test_medians_stand_with_the_order_statistics_around_them():
    costs = np.tile(np.arange(1.0, 101.0), (3, 1)) * np.array([[4.0], [2.0], [1.0]])
    found = summary(many(costs))
    assert found.laws[0].interval == (160.0, 244.0)  # 40 and 61 of 100, times 4
    assert found.laws[0].relative_interval == (4.0, 4.0)
    assert found.interval_rows()[0] == ["mean", "202", "160 to 244", "4.00", "4.00 to 4.00"]
    assert found.laws[2].best_interval == pytest.approx((0.963, 1.0), abs=1e-3)


@pytest.mark.parametrize(("count", "text"), [(5, "–"), (6, "1.00 to 6.00"), (9, "2.00 to 8.00")])
def test_an_interval_of_too_few_scenarios_is_a_dash(count, text):
    costs = np.tile(np.arange(1.0, count + 1.0), (3, 1))
    assert {row[2] for row in summary(many(costs)).interval_rows()} == {text}


def test_an_interval_reaches_to_infinity_where_many_runs_diverged():
    costs = np.tile(np.arange(1.0, 21.0), (3, 1))
    lost = np.zeros((3, 20), dtype=bool)
    lost[0, 11:] = True
    assert summary(many(costs, lost)).interval_rows()[0][2] == "6.00 to ∞"


def test_the_latex_table_of_one_law_compares_nothing():
    costs = np.arange(1.0, 21.0)[None]
    found = summary(many(costs, laws=LAWS[:1]))
    (heading, row), latex = cells(found.to_latex()), found.to_latex()
    assert len(heading) == len(row) == 6
    assert heading[-2:] == [r"95 \%", "growing runs"]
    assert not any(word in latex for word in ("ratio", "Wilson", "all laws"))


def test_the_latex_table_says_what_the_printed_ones_say():
    rng = np.random.default_rng(0)
    found = summary(many(np.exp(rng.normal(size=(3, 50))) * 1e6))
    latex = found.to_latex()
    heading, *rows = cells(latex)
    assert heading == [
        *("law", r"5 \%", "median", r"95 \% interval", r"95 \%", "wins", r"95 \% interval"),
        *("/ oracle", r"95 \% interval", "growing runs"),
    ]
    assert r"\usepackage{booktabs}" in latex
    assert latex.count(r"\toprule") == latex.count(r"\bottomrule") == 1
    plain = [
        re.sub(r"\\ensuremath\{(.*?)\\cdot10\^\{(\d+)\}\}", r"\1e\2", "&".join(r)) for r in rows
    ]
    for row, printed, more in zip(plain, found.rows(), found.interval_rows(), strict=True):
        shown = row.replace("\\%", "%").split("&")
        assert [shown[i] for i in (0, 1, 2, 4, 5, 7, 9)] == printed
        assert [shown[i] for i in (0, 2, 3, 7, 8)] == more


def test_the_tables_of_one_law_compare_it_with_nothing():
    dims = ("law", "scenario")
    values = dims, np.arange(1.0, 101.0)[None]
    metrics = {"cost": values, "ise": values, "diverged": (dims, np.zeros((1, 100), dtype=bool))}
    found = summary(xr.Dataset(metrics, {"law": ["mean"]}))
    assert dict(zip(found.headings, found.rows()[0], strict=True)) == {
        "law": "mean", "5 %": "5.95", "median": "50.5", "95 %": "95.0", "growing runs": "0",
    }  # fmt: skip
    assert found.interval_headings == ["law", "median", "95 % interval"]
    assert found.interval_rows() == [["mean", "50.5", "40.0 to 61.0"]]


def test_a_sweep_has_a_row_for_each_cell_and_law_with_both_intervals():
    rng = np.random.default_rng(1)
    values = np.exp(rng.normal(size=(2, 1, 3, 40))) * np.array([3.0, 2.0, 1.0])[:, None]
    lost = np.zeros_like(values, dtype=bool)
    lost[1, 0, 0, :3] = True
    found = sweep_table(sweep(values, lost))
    assert found.headings == [
        *("law", "delay", "median ∫|x|²", "95 % interval"),
        *("/ oracle", "95 % interval", "diverged runs"),
    ]
    assert [row[:2] for row in found.rows] == [[law, d] for d in ("0.5", "1") for law in LAWS]
    assert [row[-1] for row in found.rows] == ["0", "0", "0", "3", "0", "0"]
    for row, runs in zip(found.rows[:3], values[0, 0], strict=True):
        ordered, logs = np.sort(runs), np.log(runs / values[0, 0, 2])
        low, high = map(float, row[3].split(" to "))
        assert float(row[2]) == pytest.approx(np.median(runs), rel=5e-3)
        # k = 14 of 40: P(B < 14) = 0.0192, P(B < 15) = 0.0403.
        assert (low, high) == pytest.approx((ordered[13], ordered[26]), rel=5e-3)
        assert float(row[4]) == pytest.approx(np.exp(logs.mean()), rel=5e-3)
        half = 2.0227 * logs.std(ddof=1) / np.sqrt(40.0)
        ends = np.exp([logs.mean() - half, logs.mean() + half])
        assert list(map(float, row[5].split(" to "))) == pytest.approx(ends, rel=5e-3)
    assert cells(found.to_latex())[1][:2] == ["mean", "0.5"]


def test_a_sweep_that_lacks_an_oracle_or_cells_or_laws_has_dashes_and_no_ratio():
    values = np.ones((2, 1, 3, 8))
    values[0, 0, 1] = np.nan
    done = np.array([[1.0], [0.0]])
    found = sweep_table(sweep(values, oracle="", done=done))
    assert found.headings == ["law", "delay", "median ∫|x|²", "95 % interval", "diverged runs"]
    assert found.rows[1] == ["averaged", "0.5", "–", "–", "–"]
    assert [row[2] for row in found.rows] == ["1.00", "–", "1.00", "–", "–", "–"]


def test_rates_have_no_ratio_and_keep_their_sign():
    values = -np.tile(np.arange(1.0, 9.0), (2, 1, 3, 1))
    found = sweep_table(sweep(values, metric="decay_rate"))
    assert "/ oracle" not in found.headings
    assert found.rows[0][2:4] == ["-4.5", "-8 to -1"]


def test_a_metric_that_the_sweep_lacks_is_refused_by_name():
    with pytest.raises(dt.ArgumentError, match=r"metric must be .*ise"):
        sweep_table(sweep(np.ones((2, 1, 3, 8))), "cost")
