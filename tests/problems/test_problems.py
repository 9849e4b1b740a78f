"""Named problems: their numbers, and the rule that chose their signals."""

import numpy as np
import pytest

import deadtime as dt
from shares import mostly_long

RULE = {"paper": (0.2, 0.4), "three-mode": (0.9, 1.8), "follower": (1.0, 2.0)}


@pytest.mark.long
@pytest.mark.parametrize("name", mostly_long(dt.problems.NAMED, "paper"))
def test_signal_is_the_median_of_201_under_the_averaged_law(name):
    problem = dt.problems.NAMED[name]()
    dwell, mean = RULE[name]
    costs = []
    for seed in range(201):
        signal = dt.SwitchingSignal.random(
            problem.plant.modes, problem.signal.end, dwell_time=dwell, mean_sojourn=mean, seed=seed
        )
        costs.append(problem.simulate("averaged", signal).metrics()["ise"])
    chosen = problem.simulate("averaged").metrics()["ise"]
    assert chosen == np.median(costs)


@pytest.mark.parametrize("name", dt.problems.NAMED)
def test_every_law_of_a_problem_runs_and_the_oracle_has_no_mismatch(name):
    problem = dt.problems.NAMED[name]()
    assert {"averaged", "mean", "oracle", "delay ignored"} < set(problem.laws)
    for law in problem.laws:
        run = problem.simulate(law)
        assert not run.diverged
    oracle = problem.simulate("oracle")
    size = np.abs(problem.gains).sum() * np.abs(oracle.states).max()
    assert np.abs(oracle.mismatch).max() <= 1e-12 * size


def test_paper_recomputes_the_printed_numbers():
    for row in dt.problems.paper().published:
        assert np.abs(row.printed - row.computed).max() <= 0.5e-4, row.name


def test_paper_loop_is_unstable_when_it_stops_switching():
    problem = dt.problems.paper()
    growth = [-problem.hold(mode, 60.0).metrics()["decay_rate"] for mode in (0, 1)]
    assert growth == pytest.approx([0.128, 0.282], abs=2e-3)


def test_three_mode_loop_needs_switching_too():
    problem = dt.problems.three_mode()
    assert -problem.hold(0, 60.0).metrics()["decay_rate"] == pytest.approx(0.222, abs=2e-3)


def test_unknown_law_is_refused():
    with pytest.raises(dt.ArgumentError, match=r"law must be one of .*averaged.*, got 'best'"):
        dt.problems.paper().simulate("best")
