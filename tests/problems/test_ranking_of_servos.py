"""Laws that follow a reference are ranked by ∫|r − y|, and figures and tables show it."""

import csv
import io
from dataclasses import replace

import numpy as np
import pytest

import deadtime as dt
from deadtime.app.page_outcome import ProblemOutcome, csv_of, table_of
from deadtime.problems.comparison import compare
from deadtime.reports.figures.runs import all_laws, plot_tracking
from deadtime.reports.scenario_tables import summary
from deadtime.reports.verdict import headings_of, table, verdict

STEP, HORIZON = 0.05, 12.0


@pytest.fixture(scope="module")
def problem():
    """Three modes, two inputs of different delays, two outputs with references of their own."""
    A = np.array([np.diag([-0.4, 0.1]), np.diag([-0.2, -0.3]), [[-0.5, 0.2], [0.0, -0.1]]])
    B = np.array([np.eye(2), np.diag([0.8, 1.2]), [[1.1, 0.0], [0.1, 0.9]]])
    plant = dt.SwitchedSystem(A, B, [0.33, 0.12])
    servo = dt.Servo(plant, np.eye(2))
    reference = ([0.0, 6.02], [[20.0, -1.0], [20.0, 2.0]])
    observer = dt.estimation.Observer(servo.model, servo.C, np.eye(2), STEP)

    def follows(slow):
        gains = servo.lqr(np.diag([1.0, 1.0, 0.5, 0.5]), slow * np.eye(2), step=STEP)
        law = dt.AveragedPredictor(servo.plant, gains, allow_unstable=True)
        return dt.OutputFeedback(law, observer, servo=servo, reference=reference)

    laws = {"timid": follows(30.0), "quick": follows(1.0)}
    signal = dt.SwitchingSignal.random(3, 20.0, dwell_time=0.7, seed=4)
    gains = np.zeros((3, 2, 2))
    given = ("mine", "mine", "", plant, gains, laws, signal, np.zeros(2), HORIZON, STEP)
    return dt.problems.Problem(*given, tracked=("level (m)", "heat (K)"))


@pytest.fixture(scope="module")
def result(problem):
    return compare(problem)


def test_the_error_of_a_run_is_that_of_its_windows_and_of_a_fine_sum(result):
    for name, run in result.runs.items():
        parts = [
            run.step_info(i, since)["IAE"]
            for i in range(2)
            for since in run.followed.changes(HORIZON, i)
        ]
        assert result.metrics[name]["iae"] == pytest.approx(sum(parts), rel=1e-12)
        assert run.time.size == HORIZON / STEP + 1
        fine = np.linspace(0.0, HORIZON, 240_001)
        held = np.repeat(run.reference[:, :-1], 1000, axis=1)
        straight = np.array([np.interp(fine, run.time, y) for y in run.tracked])
        middle = 0.5 * (straight[:, 1:] + straight[:, :-1])
        total = np.abs(held - middle).sum() * fine[1]
        assert result.metrics[name]["iae"] == pytest.approx(total, rel=1e-5)


def test_the_reference_ranks_where_the_cost_prefers_the_law_that_stays_behind(result):
    """At r₁ = 20 the timid law costs less and follows worse."""
    timid, quick = (result.metrics[name] for name in ("timid", "quick"))
    assert timid["cost"] < quick["cost"]
    assert quick["iae"] < timid["iae"]
    assert result.measure == "iae"
    said = [sentence for sentence in verdict(result) if "follows best" in sentence]
    assert len(said) == 1
    assert "the law “quick” follows best" in said[0]
    assert headings_of(result)[1] == "∫|r − y|"
    assert len(headings_of(result)) == len(table(result)[0])
    assert float(table(result)[1][1].replace(",", "")) == pytest.approx(quick["iae"], rel=0.01)


@pytest.mark.long
def test_many_runs_rank_by_the_same_error(problem):
    signals = [dt.SwitchingSignal.random(3, 20.0, dwell_time=0.7, seed=i) for i in range(3)]
    data = dt.monte_carlo(
        problem.plant, problem.laws, signals, problem.x0, HORIZON, STEP, threads=1
    )
    for i, law in enumerate(problem.laws):
        for j, signal in enumerate(signals):
            alone = problem.simulate(law, signal).metrics()["iae"]
            assert data["iae"].values[i, j] == pytest.approx(alone, rel=1e-9)
    found = summary(data)
    assert found.measure == "iae"
    assert [one.best for one in found.laws] == [0.0, 1.0]
    assert found.records()[1]["iae"]["median"] == pytest.approx(np.median(data["iae"].values[1]))


def test_where_one_law_has_no_reference_the_cost_ranks(problem):
    plain = dt.place(problem.plant, [-1.0, -1.5], step=STEP)
    both = {**problem.laws, "bare": dt.AveragedPredictor(problem.plant, plain)}
    mixed = compare(replace(problem, laws=both))
    assert mixed.measure == "cost"
    assert len(headings_of(mixed)) == len(table(mixed)[0])


def test_the_explorer_ranks_by_the_error_and_hands_on_what_follows(problem, result):
    outcome = ProblemOutcome(problem, result.runs, {}, result.metrics["quick"]["iae"])
    error = {name: row["iae"] for name, row in result.metrics.items()}
    for name in error:
        assert outcome.ratio(name) == pytest.approx(error[name] / error["quick"])
    assert "∫|r − y|</th>" in table_of(outcome, list(problem.laws))
    row = next(csv.DictReader(io.StringIO(csv_of(result.runs))))
    assert (row["quick: y[0]"], row["quick: r[0]"]) == ("0.0", "20.0")


def test_the_figure_of_all_laws_shows_what_follows_beside_its_reference(result):
    caption, figure = all_laws(result)
    assert caption.startswith("What follows the reference")
    assert [axes.get_ylabel() for axes in figure.axes] == ["level (m)", "heat (K)"]
    reference, timid, quick = figure.axes[0].get_lines()
    assert np.array_equal(reference.get_ydata(), result.runs["quick"].reference[0])
    assert np.array_equal(timid.get_ydata(), result.runs["timid"].tracked[0])
    assert np.array_equal(quick.get_ydata(), result.runs["quick"].tracked[0])
    paper = compare(replace(dt.problems.paper(), horizon=2.0))
    assert all_laws(paper)[1].axes[0].get_ylabel() == "|x|"
    with pytest.raises(dt.ArgumentError, match="must all follow a reference"):
        plot_tracking(paper.runs)


def test_a_problem_runs_a_law_or_its_name(problem):
    by_name, by_law = problem.simulate("quick"), problem.simulate(problem.laws["quick"])
    assert np.array_equal(by_name.states, by_law.states)
    with pytest.raises(dt.ArgumentError, match="law must be one of timid, quick, got 'slow'"):
        problem.simulate("slow")


def test_an_offset_is_called_so():
    from deadtime.imperfections import StepDisturbance

    rows = [[0.0, 0.0], [0.3, 0.0], [0.0, -1.5]]
    assert StepDisturbance(rows).in_words == "offset [0.3, 0] in mode 1 and [0, -1.5] in mode 2"
    for other in (StepDisturbance([0.3, 0.0]), StepDisturbance(rows, start=1.0)):
        assert other.in_words.startswith("step disturbance (force [")
