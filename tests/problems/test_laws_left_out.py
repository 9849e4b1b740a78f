"""A law that has no ideal loop is left out of a comparison, and said to be."""

from dataclasses import replace

import pytest
from scipy import stats

import deadtime as dt
from deadtime.problems.comparison import compare
from deadtime.reports.verdict import verdict


def ideal_problem(**laws):
    return replace(dt.problems.paper(), step=None, horizon=2.0, laws=laws)


def semi_markov():
    problem = dt.problems.paper()
    model = dt.SemiMarkov(stats.expon(loc=0.2, scale=0.2))
    return dt.ExpectedPredictor(problem.plant, problem.gains, model)


def test_the_other_laws_run_and_a_sentence_says_which_does_not():
    averaged = dt.problems.paper().laws["averaged"]
    result = compare(ideal_problem(expected=semi_markov(), averaged=averaged))
    assert list(result.runs) == ["averaged"] == list(result.problem.laws)
    assert result.lead == "averaged"
    said = [line for line in verdict(result) if line.startswith("expected was left out")]
    assert len(said) == 1
    assert "no closed form" in said[0]


def test_where_no_law_is_left_the_refusal_is_the_answer():
    with pytest.raises(dt.ArgumentError, match="no closed form"):
        compare(ideal_problem(expected=semi_markov()))


def test_a_digital_comparison_leaves_nothing_out():
    problem = replace(ideal_problem(expected=semi_markov()), step=1.0)
    with pytest.raises(dt.ArgumentError, match="step"):
        compare(problem)
