"""A study's findings, its report and its command say what its data say."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from deadtime.cli.application import main
from deadtime.reports.study.answers import answers
from deadtime.reports.study.findings import (
    against_best,
    best,
    duel,
    favourite,
    steadier,
    summary,
    typical_regret,
    unbeaten,
)
from deadtime.reports.study.phrases import region
from deadtime.reports.study.report import write_study
from deadtime.scenarios.paired_statistics import mean_interval, median_interval
from small_study import PLAIN


def made(ise, final=0.1, diverged=False):
    """Data of one row of cells, ∫|x|² (law, dwell time, scenario) under a, b, …, oracle."""
    ise = np.asarray(ise, dtype=float)[None, None, None].transpose(0, 1, 2, 4, 3, 5)
    names = [*("averaged", "mean", "expected")[: ise.shape[-2] - 1], "oracle"]
    dims = ("sojourn", "delay", "distance", "dwell_time", "law", "scenario")
    variables = {
        "ise": (dims, ise),
        "final_norm": (dims, np.broadcast_to(final, ise.shape).copy()),
        "diverged": (dims, np.broadcast_to(diverged, ise.shape).copy()),
    }
    coordinates = {
        "sojourn": ["uniform"], "delay": [1.0], "distance": [1.0],
        "dwell_time": 0.1 * 2.0 ** np.arange(ise.shape[3]), "law": names,
    }  # fmt: skip
    return xr.Dataset(variables, coordinates, {"start": 1.0})


def paired(*factors, scenarios=100):
    """∫|x|² of laws that are so many times the oracle's, whose own spreads over decades."""
    oracle = np.geomspace(1.0, 1e6, scenarios)
    rows = [[np.broadcast_to(factor, scenarios) * oracle] for factor in (*factors, 1.0)]
    return made(rows)


# What is found


def test_regret_is_the_paired_geometric_mean_and_beside_it_the_median():
    factor = np.random.default_rng(0).permutation(np.geomspace(1.0, 4.0, 100))
    found = summary(paired(factor)).sel(law="averaged").isel(dwell_time=0).squeeze()
    assert found.regret == pytest.approx(2.0)
    half = np.exp(1.984217 * np.log(factor).std(ddof=1) / 10.0)  # Student's, 99 degrees
    assert (found.regret_low, found.regret_high) == (
        pytest.approx(2.0 / half), pytest.approx(2.0 * half),
    )  # fmt: skip
    ordered = np.sort(factor)
    assert (found.median_regret_low, found.median_regret_high) == (
        pytest.approx(ordered[39]), pytest.approx(ordered[60]),
    )  # fmt: skip


@pytest.mark.parametrize("interval", [mean_interval, median_interval])
def test_intervals_cover_as_often_as_they_say(interval):
    draws = np.random.default_rng(3).lognormal(sigma=2.0, size=(4000, 60))
    _, low, high = interval(draws)
    # Order statistics come in steps: with 60 of them the interval holds at 97.3 %.
    assert 0.94 < np.mean((low <= 1.0) & (high >= 1.0)) < 0.98


def test_few_draws_bound_nothing():
    assert [float(part) for part in median_interval(np.arange(5.0))] == [2.0, -np.inf, np.inf]
    assert [float(part) for part in median_interval(np.arange(6.0))] == [2.5, 0.0, 5.0]
    assert [float(part) for part in mean_interval(np.array([2.0]))] == [2.0, 0.0, np.inf]


def test_the_better_law_wins_although_signals_differ_more_than_laws():
    factor = np.where(np.arange(100) < 80, 0.9, 1.1)  # better on 80 % of the signals
    data = paired(factor * 1.2, 1.2)
    fight = duel(data, "averaged", "mean").squeeze()
    assert fight.ratio == pytest.approx(0.9**0.8 * 1.1**0.2)
    assert fight.ratio_low < fight.ratio < fight.ratio_high < 1.0
    assert (fight.median_ratio, fight.share, fight.verdict) == (pytest.approx(0.9), 0.8, 1.0)
    assert 0.70 < fight.share_low < 0.8 < fight.share_high < 0.88
    reverse = duel(data, "mean", "averaged").squeeze()
    assert (float(reverse.share), float(reverse.verdict)) == (pytest.approx(0.2), -1.0)
    found = best(data, ["mean", "averaged"]).squeeze()
    assert (found.winner.item(), found.runner_up.item(), found.verdict.item()) == (
        "averaged", "mean", 1.0,
    )  # fmt: skip


def test_two_groups_of_signals_are_decided_by_how_much_not_by_how_many():
    factor = np.where(np.arange(100) < 48, 0.8, 1.01)  # better by 20 % on 48, worse by 1 % on 52
    fight = duel(paired(factor, 1.0), "averaged", "mean").squeeze()
    assert fight.median_ratio == pytest.approx(1.01)
    assert fight.share_low < 0.5 < fight.share_high
    assert (fight.ratio, fight.verdict) == (pytest.approx(0.8**0.48 * 1.01**0.52), 1.0)


def test_a_tie_is_an_interval_that_contains_1():
    factor = np.where(np.arange(100) % 2, 0.8, 1.2)
    fight = duel(paired(factor, 1.0), "averaged", "mean").squeeze()
    assert fight.ratio_low < 1.0 < fight.ratio_high
    assert fight.verdict == 0.0
    assert best(paired(factor, 1.0), ["averaged", "mean"]).verdict.item() == 0.0


def test_equal_laws_are_tied_and_both_unbeaten():
    data = paired(1.5 * (1.0 + 1e-9), 1.5)
    fight = duel(data, "averaged", "mean").squeeze()
    assert (fight.share, fight.share_low, fight.share_high, fight.verdict) == (0.5, 0.0, 1.0, 0.0)
    assert unbeaten(data, ["averaged", "mean"]).all()


def test_the_law_to_use_has_the_least_regret_in_the_geometric_mean_and_lost_is_lost():
    one = np.ones(20)
    several = made([[1.0 * one] * 2 + [50.0 * one], [1.2 * one] * 3, [one] * 3])
    assert favourite(several, ["averaged", "mean"]) == "mean"  # 3.68 against 1.2
    lost = made([[1e9 * one, one, one], [101.0 * one, 1.1 * one, 1.1 * one], [one] * 3])
    assert favourite(lost, ["averaged", "mean"]) == "averaged"
    assert typical_regret(lost).sel(law="averaged").item() == pytest.approx(100.0 ** (1 / 3))


def test_the_expected_law_is_held_against_the_best_rival_of_each_cell():
    oracle = np.ones(50)
    ise = [[2.0 * oracle, 3.0 * oracle], [3.0 * oracle, 2.0 * oracle], [1.0 * oracle, 4.0 * oracle],
           [oracle, oracle]]  # fmt: skip
    fight = against_best(made(ise), "expected", ["averaged", "mean"]).squeeze()
    np.testing.assert_allclose(fight.ratio, [0.5, 2.0])
    np.testing.assert_array_equal(fight.verdict, [1.0, -1.0])


def test_a_diverged_run_is_worse_than_any_other():
    ise = np.ones((3, 1, 40))
    ise[0] = 0.5  # its run ended early: less had been summed up
    diverged = np.zeros((1, 1, 1, 1, 3, 40), dtype=bool)
    diverged[..., 0, :] = True
    data = made(ise, diverged=diverged)
    fight = duel(data, "averaged", "mean").squeeze()
    assert (fight.ratio, fight.verdict) == (pytest.approx(1e12), -1.0)
    found = summary(data).squeeze()
    assert found.regret.sel(law="averaged") == pytest.approx(1e12)
    assert found.stabilised.sel(law="averaged") == 0.0
    both = made(ise, diverged=np.ones((1, 1, 1, 1, 3, 40), dtype=bool))
    assert duel(both, "averaged", "mean").verdict.item() == 0.0


def test_stabilised_signals_are_counted_and_compared_in_pairs():
    final = np.full((1, 1, 1, 1, 3, 60), 0.5)
    final[..., 0, :30] = 2.0  # averaged loses half of the signals, the others none
    data = made(np.ones((3, 1, 60)), final=final)
    found = summary(data).squeeze()
    assert found.stabilised.sel(law="averaged") == 0.5
    assert (
        found.stabilised_low.sel(law="averaged") < 0.5 < found.stabilised_high.sel(law="averaged")
    )
    assert found.stabilised.sel(law="mean") == 1.0
    assert steadier(data, "mean", "averaged").item() == 1.0
    assert steadier(data, "averaged", "mean").item() == -1.0
    assert steadier(data, "oracle", "mean").item() == 0.0


def test_answers_say_what_the_data_say():
    # The averaged law is 20 % better at the short dwell time and twice as bad at the long one.
    one = np.ones(60)
    ise = [[0.8 * one, 2.0 * one], [one, one], [0.7 * one, 0.99 * one], [0.5 * one, 0.5 * one]]
    which, mean, distribution = answers(made(ise))
    assert which.sentences[0] == (
        "Use the expected law if the distribution of the sojourns is known, otherwise the mean law."
    )
    assert "∫|x|² is 2.00 times the oracle’s, the geometric mean" in which.sentences[1]
    assert mean.sentences[0].startswith(
        "The averaged law (2) is better in 1 of 2 cells, the mean law (80) in 1; in 0 the "
    )
    won = "Where the averaged law wins, at dwell time 0.1 s, its ∫|x|² is 20 % less; there"
    assert mean.sentences[1].startswith(won)
    lost = "Where the mean law wins, at dwell time 0.2 s, its ∫|x|² is 50 % less; there"
    assert mean.sentences[2].startswith(lost)
    assert mean.sentences[3].startswith("Shorter dwell times favour the averaged law")
    assert mean.tables[0].rows[0][3:6] == ("0.800", "0.800", "0.800")
    assert "does better in all 2 cells and worse in 0" in distribution.sentences[0]
    assert distribution.duels == (("expected", "mean"),)


def test_regions_name_the_axes_that_cells_do_not_span():
    grid = {"sojourn": ["uniform", "fixed"], "delay": [0.5, 1.0, 2.0], "distance": [1.0]}
    mask = xr.DataArray(np.zeros((2, 3, 1), dtype=bool), grid, tuple(grid))
    mask[1, 0], mask[1, 2] = True, True
    assert region(mask) == "fixed sojourns, delay 0.5 or 2 s"
    assert region(~mask & False) == ""
    assert region(mask | True) == ""


# The report


@pytest.mark.long
def test_the_report_opens_with_the_answers_and_holds_every_map(small, tmp_path, monkeypatch):
    study, data = small
    monkeypatch.setattr("deadtime.reports.study.report.run_study", lambda *_: data)
    report = write_study(study, tmp_path / "out", command="deadtime study mine.toml")
    page = report.path.read_text(encoding="utf-8")
    assert page.index("Which law to use?") < page.index("When is the averaged law better")
    for answer in report.answers:
        for sentence in answer.sentences:
            assert sentence.replace(" %", "\u00a0%") in page
    figures = {path.stem for path in (tmp_path / "out" / "figures").glob("*.png")}
    assert figures == {path.stem for path in (tmp_path / "out" / "figures").glob("*.svg")}
    laws = [law.replace(", ", "-").replace(" ", "-") for law in study.laws]
    assert figures == {
        "lines", "averaged-over-mean", "mean-dwell-aware-over-mean", "winners-0", "winners-1",
        "winners-2", *(name for name in figures if name.startswith("expected-over-")),
        *(f"regret-{law}" for law in laws[:-1]), *(f"stabilised-{law}" for law in laws),
    }  # fmt: skip
    assert page.count("data:image/png;base64,") == len(figures)
    assert "deadtime study mine.toml" in page
    assert "Cells without a result" not in page
    record = json.loads((tmp_path / "out" / "metrics.json").read_text(encoding="utf-8"))
    assert len(record["cells"]) == study.size
    assert record["answers"][0]["sentences"] == list(report.answers[0].sentences)
    with (tmp_path / "out" / "data" / "cells.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == study.size * len(study.laws)
    first = record["cells"][0]
    assert float(rows[0]["regret"]) == pytest.approx(first["laws"]["averaged"]["regret"], rel=1e-5)


@pytest.mark.long
def test_the_command_runs_a_study_and_prints_its_answers(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    text = PLAIN.replace("[0.2, 0.8]", "0.8").replace("[0.5, 1.0]", "0.5")
    Path("mine.toml").write_text(
        text.replace(', "delay ignored"', "").replace(', "fixed"', ""), encoding="utf-8"
    )
    with pytest.raises(SystemExit) as stopped:
        main(["study", "mine.toml", "--scenarios", "6", "--workers", "1", "-o", "out"])
    captured = capsys.readouterr()
    assert (stopped.value.code, captured.err) == (0, "")
    assert "Which law to use?\n• Use the" in captured.out
    assert captured.out.endswith("Report: out/index.html\n")
    record = json.loads(Path("out/metrics.json").read_text(encoding="utf-8"))
    assert record["scenarios"] == 6


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["study", "none.toml"], "none.toml cannot be read"),
        (["study", "mine.toml", "--scenarios", "0"], "scenarios must be an integer of at least 1"),
        (["study", "mine.toml", "--workers", "0"], "workers must be an integer of at least 1"),
        (["study", "mine.toml", "--out", "/proc/x"], " '/proc/x' cannot be written"),
    ],
)
def test_bad_requests_get_one_line_and_code_2(tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    Path("mine.toml").write_text(PLAIN, encoding="utf-8")
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    error = capsys.readouterr().err
    assert stopped.value.code == 2
    assert error.count("\n") == 1
    assert message in error
