"""The audit: its statistics, its measurements, and verdicts that follow from the numbers."""

import dataclasses
import re

import numpy as np
import pytest
from scipy.stats import binomtest

import deadtime as dt
import plants
from deadtime.base.wording import amount, as_rate
from deadtime.reports.audit import STEPS, Claim, audit, move_modes, stretch
from deadtime.reports.audit_evidence import (
    LEAD,
    MEAN,
    commands,
    exact_commands,
    gather,
    random_signals,
)
from deadtime.reports.figures.audit import plot_claims
from deadtime.scenarios.paired_statistics import Proportion

PROBLEM = dt.problems.paper()
SCENARIOS = 40


@pytest.fixture(scope="module")
def claims():
    heard = []
    found = audit(PROBLEM, SCENARIOS, seed=5, progress=heard.append)
    assert len(heard) == STEPS
    return {claim.key: claim for claim in found}


# -- statistics --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("count", "trials"), [(0, 1), (1, 1), (0, 40), (40, 40), (13, 40), (984, 1000), (999, 1000)]
)
def test_interval_is_wilson_s_as_scipy_computes_it(count, trials):
    expected = binomtest(count, trials).proportion_ci(0.95, method="wilson")
    assert Proportion(count, trials).interval == pytest.approx(
        (expected.low, expected.high), rel=1e-12, abs=1e-15
    )


def test_without_trials_nothing_is_known():
    nothing = Proportion(0, 0)
    assert (nothing.fraction, nothing.interval) == (0.0, (0.0, 1.0))


def test_a_proportion_reads_with_its_interval():
    assert str(Proportion(984, 1000)) == "98.4 % of 1,000 (97.4 to 99.0 %)"
    assert Proportion.of(np.array([True, False, True])) == Proportion(2, 3)


@pytest.mark.parametrize(
    ("count", "trials", "verdict"),
    [
        (1000, 1000, "holds"),
        (999, 1000, "holds on most signals"),
        (540, 1000, "holds on most signals"),
        (520, 1000, "not decided"),  # more than half, but not beyond doubt
        (10, 1000, "does not hold on most signals"),
        (2, 2, "not decided"),  # too few to say
        (0, 0, "not decided"),
    ],
)
def test_the_verdict_follows_from_the_numbers(count, trials, verdict):
    texts = ("key", "title", "where", "statement", "test", "one run")
    for holds_in_run in (True, False, None):
        claim = Claim(*texts, holds_in_run, "many", Proportion(count, trials))
        assert claim.verdict == verdict
    assert Claim(*texts, True, "many").verdict == "holds"
    assert Claim(*texts, False, "many").verdict == "does not hold"


# -- measurements ------------------------------------------------------------------------------


def test_signals_of_other_dwell_times_are_the_same_ones_stretched():
    short, long = (random_signals(PROBLEM, tau, 5, seed=2) for tau in (0.2, 0.8))
    for one, other in zip(short, long, strict=True):
        slower = stretch(one, 4.0)
        count = other.times.size
        assert slower.times[:count] == pytest.approx(other.times, rel=1e-12)
        assert np.array_equal(slower.modes[:count], other.modes)
        assert one.dwell_time >= 0.2
        assert one.end == other.end == PROBLEM.horizon + PROBLEM.plant.delay


def test_commands_along_a_law_s_own_run_are_its_inputs():
    for name in (LEAD, MEAN):
        run = PROBLEM.simulate(name)
        found = commands(run, PROBLEM.laws[name].digital(PROBLEM.step))
        plants.close(found.T, run.inputs, 1e-12)


def test_commands_of_several_inputs_are_those_of_the_law_too():
    plant = plants.generic()
    law = plants.LAWS["single"](plant)
    run = dt.simulate(plant, law, plants.off_grid(), [1.0, -0.5, 0.8], 3.0, step=0.1, u0=[1, -2])
    plants.close(commands(run, law.digital(0.1)).T, run.inputs, 1e-12)


def test_the_oracle_commands_exactly_what_the_future_asks_for():
    run = PROBLEM.simulate("oracle")
    plants.close(exact_commands(run).T, run.inputs, 1e-10)


def test_figures_are_those_of_plain_runs():
    signal = random_signals(PROBLEM, 0.2, 1, seed=9)[0]
    figures = gather(PROBLEM, [signal], lambda: None)
    assert list(figures) == ["averaged", "mode 0 only", "mode 1 only", "mean"]
    for name, row in figures.items():
        run = PROBLEM.simulate(name, signal)
        for key, value in run.metrics().items():
            assert row[key].tolist() == [value]
    start = dataclasses.replace(PROBLEM, horizon=5.0).simulate(LEAD, signal).metrics()
    assert figures[LEAD]["early_ise"][0] == pytest.approx(start["ise"], rel=1e-12)
    assert figures[LEAD]["early_peak"][0] == start["peak"]
    # Law (2)'s error along its own run is its mismatch.
    run = PROBLEM.simulate(LEAD, signal)
    assert run.mismatch is not None
    error = np.sqrt(np.mean(run.mismatch**2))
    assert figures[LEAD]["command_error"][0] == pytest.approx(error, rel=1e-10)


def test_modes_moved_by_1_are_the_example_and_by_0_all_the_same():
    same, epsilon = move_modes(PROBLEM, 1.0)
    assert epsilon == pytest.approx(0.7895, abs=5e-5)
    plants.close(same.plant.A, PROBLEM.plant.A, 1e-15)
    plants.close(same.gains, PROBLEM.gains, 1e-12)
    none, epsilon = move_modes(PROBLEM, 0.0)
    assert epsilon == 0.0
    runs = [none.simulate(name) for name in (LEAD, MEAN)]
    plants.close(runs[0].states, runs[1].states, 1e-9)


# -- the claims --------------------------------------------------------------------------------


def test_every_claim_of_the_paper_is_there_with_figures(claims):
    assert list(claims) == [
        "numbers",
        "averaged-stabilises",
        "mode-0-worse",
        "mode-1-worse",
        "predicts-better",
        "mean-stabilises",
        "faster",
        "transient",
        "shorter-dwell-better",
        "shorter-dwell-gains",
        "distance",
    ]
    for claim in claims.values():
        texts = (claim.title, claim.where, claim.statement, claim.test, claim.one_run, claim.many)
        assert all(texts)
        assert "nan" not in " ".join(texts)
        if claim.key != "numbers":
            assert claim.proportion is not None
            assert str(claim.proportion) in claim.many


def test_proportions_count_what_the_test_of_the_claim_says(claims):
    signals = random_signals(PROBLEM, 0.2, SCENARIOS, seed=5)
    averaged, mean, single = (
        [PROBLEM.simulate(name, signal).metrics() for signal in signals]
        for name in (LEAD, MEAN, "mode 0 only")
    )
    start = np.linalg.norm(PROBLEM.x0)
    counts = {
        "averaged-stabilises": [
            m["final_norm"] < start and m["decay_rate"] > 0.0 for m in averaged
        ],
        "mode-0-worse": [b["ise"] > a["ise"] for a, b in zip(averaged, single, strict=True)],
        "faster": [
            a["settling_time"] < b["settling_time"] for a, b in zip(averaged, mean, strict=True)
        ],
    }
    for key, outcomes in counts.items():
        assert claims[key].proportion == Proportion(int(sum(outcomes)), SCENARIOS)


def test_one_run_is_that_on_the_problem_s_signal(claims):
    averaged, mean = (PROBLEM.simulate(name).metrics() for name in (LEAD, MEAN))
    assert amount(averaged["final_norm"]) in claims["averaged-stabilises"].one_run
    assert f"{averaged['settling_time']:.2f} s under (2)" in claims["faster"].one_run
    assert claims["faster"].holds_in_run is (averaged["settling_time"] < mean["settling_time"])


def test_growth_with_a_mode_held_is_that_of_the_verdict(claims):
    growth = [dt.growth_rate(PROBLEM.plant, PROBLEM.laws[LEAD], i, PROBLEM.step) for i in (0, 1)]
    how = f"held in mode 0 it grows at {as_rate(growth[0])} /s, held in mode 1 at "
    assert f"{how}{as_rate(growth[1])} /s." in claims["averaged-stabilises"].many


def test_the_share_at_distance_1_is_that_of_the_example(claims):
    count = round(0.4 * SCENARIOS)
    start = np.linalg.norm(PROBLEM.x0)
    metrics = [
        PROBLEM.simulate(LEAD, signal).metrics()
        for signal in random_signals(PROBLEM, 0.2, count, seed=5)
    ]
    share = np.mean([m["final_norm"] < start and m["decay_rate"] > 0.0 for m in metrics])
    said = f"α = 1 (ε = 0.79): averaged law (2) {100.0 * share:.1f} %"
    assert said in claims["distance"].many


def test_the_text_and_the_computation_disagree_where_the_design_says_so(claims):
    assert claims["numbers"].verdict == "holds"
    assert claims["predicts-better"].verdict == "holds"
    for key in ("faster", "transient"):
        assert not claims[key].holds_in_run
        assert claims[key].verdict in ("does not hold on most signals", "not decided")
    assert not claims["shorter-dwell-gains"].verdict.startswith("holds")
    assert claims["shorter-dwell-better"].verdict.startswith("holds")


def test_a_wrong_printed_number_is_found():
    wrong = dataclasses.replace(PROBLEM.published[0], printed=np.array([-12.0, -6.001]))
    problem = dataclasses.replace(PROBLEM, published=(wrong, *PROBLEM.published[1:]))
    assert audit(problem, scenarios=1)[0].verdict == "does not hold"


def test_the_same_seed_gives_the_same_audit():
    one, other = (audit(PROBLEM, scenarios=3, seed=1) for _ in range(2))
    assert [claim.many for claim in one] == [claim.many for claim in other]


@pytest.mark.few(1)
def test_the_figure_is_drawn_within_its_frame(claims, tmp_path):
    figure = plot_claims(list(claims.values()))
    figure.savefig(tmp_path / "figure.png")
    box, page = figure.get_tightbbox(), figure.get_size_inches()
    assert min(box.x0, box.y0) >= -0.02
    assert box.x1 <= page[0] + 0.02
    assert box.y1 <= page[1] + 0.02


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: audit(dt.problems.follower()),
            "problem must be the paper's example, deadtime.problems.paper(), got 'follower'",
        ),
        (lambda: audit(PROBLEM, scenarios=0), "scenarios must be an integer ≥ 1, got 0."),
        (lambda: audit(PROBLEM, seed=-1), "seed must be an integer ≥ 0, got -1."),
        (lambda: audit(PROBLEM, dwell_time=0.0), "dwell_time must be positive, in s, got 0."),
    ],
)
def test_what_cannot_be_audited_is_refused_by_name(call, message):
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        call()
