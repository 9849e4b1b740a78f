"""A design for margin, drawn, tabulated, and from the command line."""

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest

import deadtime as dt
import plants
from deadtime.cli.application import main
from deadtime.problems.file import load_problem
from deadtime.reports.design import (
    HEADINGS,
    design_record,
    design_rows,
    limit_rows,
    plot_designs,
    problem_sections,
)

PLANT = plants.scalar([1.0, 1.1], 1.0, 1.0)
GAINS = dt.place(PLANT, [-1.0])


@pytest.fixture(scope="module")
def found():
    return dt.design(PLANT, delay_margin=0.1, gains=GAINS, step=0.1, filtered=True, budget=40)


def test_the_chart_draws_the_trade_off_the_answer_and_the_limits(found, tmp_path):
    figure = plot_designs({"two modes": found, "$odd_name$": replace(found, points=())})
    panel = figure.axes[0]
    (line,) = [
        line for line in panel.lines if line.get_marker() == "None" and line.get_linestyle() == "-"
    ]
    assert line.get_xdata() == pytest.approx([100.0 * point.margin for point in found.points])
    costs = np.array([point.cost for point in found.points])
    assert line.get_ydata() == pytest.approx(costs / costs.min())
    (asked,) = [line for line in panel.lines if line.get_linestyle() == "--"]
    assert asked.get_xdata() == pytest.approx([10.0, 10.0])
    reached = panel.patches[0]
    right = panel.get_xlim()[1]
    least = 100.0 * min(limit.reached for limit in found.limits)
    assert reached.get_x() + reached.get_width() == pytest.approx(min(least, right))
    figure.savefig(tmp_path / "design.png")
    assert (tmp_path / "design.png").stat().st_size > 10_000
    figure.draw_without_rendering()
    (legend,) = figure.legends
    bottom = min(axes.get_tightbbox().y0 for axes in figure.axes if axes.axison)
    assert legend.get_window_extent().y1 <= bottom


def test_tables_name_the_chosen_design_and_the_limits(found):
    rows = design_rows(found)
    assert rows[0][0] == "plain"
    assert [row[0] for row in rows].count("chosen") == 1
    assert all(len(row) == len(HEADINGS) for row in rows)
    names = ("slow", "fast")
    (slow, fast) = limit_rows(found, names)
    assert slow[0] == "slow"
    assert slow[3] == "+1.00"
    assert float(fast[1].split()[0]) < float(slow[1].split()[0])
    record = json.loads(json.dumps(design_record(found)))
    assert record["reached"] is True
    assert record["gains"] == found.gains.tolist()
    assert record["message"] == found.message


FILE = """
[plant]
delay = 1.0
A = [[[1.0]], [[1.1]]]
B = [[[1.0]], [[1.0]]]
{sections}
[signal]
kind = "constant"
mode = 0
[run]
x0 = [1.0]
horizon = 5.0
step = 0.1
"""


@pytest.mark.parametrize("mode", [None, 1])
def test_what_is_written_is_the_law_when_pasted_into_a_problem_file(found, tmp_path, mode):
    if mode is not None:
        one = dt.SwitchedSystem(PLANT.A[[1]], PLANT.B[[1]], 1.0)
        found = dt.design(one, delay_margin=0.1, step=0.1, filtered=True, budget=20)
    text = problem_sections(found, "averaged", PLANT, GAINS, mode)
    path = tmp_path / "problem.toml"
    path.write_text(FILE.format(sections=text))
    (law,) = load_problem(str(path)).laws.values()
    table, own = law.digital(0.1), found.law.digital(0.1)
    assert np.array_equal(table.state_gain, own.state_gain)
    assert table.input_gain == pytest.approx(own.input_gain, rel=1e-12)
    assert f"step = {found.step!r}" in text
    if mode is not None:
        assert np.array_equal(law.gains[0], GAINS[0])


def test_gains_that_only_the_filter_stabilises_with_are_allowed_by_the_file(found):
    text = problem_sections(replace(found, gains=0.0 * found.gains), "averaged", PLANT, GAINS)
    assert "allow_unstable = true" in text
    assert tomllib.loads(text)["gains"]["K"] == np.zeros((2, 1, 1)).tolist()


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    captured = capsys.readouterr()
    return stopped.value.code, captured.out, captured.err


def test_design_prints_a_sentence_and_tables_and_writes_gains_and_chart(
    capsys, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    arguments = ("--delay-margin", "0.05", "--budget", "20")
    code, out, err = run(capsys, "design", "follower", *arguments, "--law", "mean")
    assert (code, err) == (0, "")
    text = " ".join(out.split())
    assert "Every constant mode stays stable" in text
    assert "throttle more than 100 % more than 100 % none" in text
    assert text.endswith("Gains and law: design.toml, chart: design.png")
    assert 'kind = "mean"' in (tmp_path / "design.toml").read_text()
    assert (tmp_path / "design.png").stat().st_size > 10_000


def test_a_margin_that_is_not_reached_is_exit_code_1(capsys, tmp_path):
    out = str(tmp_path / "m0")
    arguments = ("--delay-margin", "0.05", "--mode", "0", "--step", "0.1", "--budget", "20")
    code, text, err = run(capsys, "design", "paper", *arguments, "--out", out, "--json")
    assert (code, err) == (1, "")
    record = json.loads(text)
    assert record["reached"] is False
    assert len(record["limits"]) == 1
    assert "mode = 0" in (tmp_path / "m0.toml").read_text()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["design"], "requires an argument"),
        (["design", "paper", "--delay-margin", "2"], "delay_margin must be above 0 and below 1"),
        (["design", "paper", "--delay-margin", "0.1", "--mode", "2"], "mode must be in 0..1"),
        (["design", "paper", "--delay-margin", "0.1", "--mode", "up"], "number of a mode or one"),
        (["design", "paper", "--delay-margin", "0.1", "--law", "exact"], "law"),
        (
            ["design", "follower", "--delay-margin", "0.1", "--budget", "20", "-o", "none/x"],
            "cannot be written",
        ),
    ],
)
def test_bad_requests_get_one_line_and_code_2(capsys, arguments, message):
    code, _, err = run(capsys, *arguments)
    assert code == 2
    assert err.startswith("deadtime: error: ")
    assert err.count("\n") == 1
    assert message in err
