"""How long a sweep takes is found from runs of some of its cells, on a clock of the test's own."""

import numpy as np
import pytest

import deadtime as dt
from deadtime.scenarios import plan_of
from deadtime.scenarios.sweeps import plan
from own_sweep import make_loop

GRID = {"delay": [0.1, 0.2, 0.3, 0.4], "weight": np.linspace(0.2, 0.8, 25).tolist()}


def study_of(grid=GRID, scenarios=10_000):
    return dt.function_study(make_loop, grid, scenarios=scenarios)


class Clock:
    """Cells that take what they are said to, after compiling once; and the clock that sees it."""

    def __init__(self, monkeypatch, start, each, compiling=20.0):
        self.now, self.runs, self._compiled = 0.0, [], False
        self._start, self._each, self._compiling = start, each, compiling
        monkeypatch.setattr(plan.time, "process_time", lambda: self.now)
        monkeypatch.setattr(plan, "run_cell", self.run)

    def run(self, study, cell):
        self.runs.append((cell.index, study.scenarios))
        self.now += 0.0 if self._compiled else self._compiling
        self._compiled = True
        self.now += self._start[cell.index] + self._each[cell.index] * study.scenarios


def filled(value):
    return np.full((4, 25), value)


@pytest.mark.parametrize("each", [1e-7, 3e-5, 2e-3])
@pytest.mark.parametrize("start", [1e-3, 0.05, 2.0])
def test_cells_that_cost_what_they_are_said_to_but_for_a_factor_are_found_exactly(
    start, each, monkeypatch
):
    costs = np.linspace(1.0, 3.0, 100).reshape(4, 25)
    clock = Clock(monkeypatch, start * costs, each * costs)
    found = plan.time_cells(study_of(), costs, filled(True))
    wanted = (start + 10_000 * each) * costs.sum()
    assert found.seconds == pytest.approx(wanted, rel=1e-9)
    assert found.cells == len({index for index, _ in clock.runs})
    assert clock.now - 20.0 < max(20.0, 0.1 * wanted)


# Along the first axis, the last one, and both: thirty times what the others take.
DEAR = {"first": np.s_[2], "last": np.s_[:, 1::3], "both": np.s_[1:, ::2]}


@pytest.mark.parametrize("dear", DEAR)
def test_kinds_of_cells_that_are_said_to_cost_the_same_are_found_within_a_factor_of_two(
    dear, monkeypatch
):
    start, each = filled(2e-3), filled(1e-5)
    start[DEAR[dear]] *= 30.0
    each[DEAR[dear]] *= 30.0
    Clock(monkeypatch, start, each)
    found = plan.time_cells(study_of(), filled(0.3), filled(True)).seconds
    assert 0.5 < found / (start + 10_000 * each).sum() < 2.0


def test_a_cell_of_few_signals_is_run_whole_and_never_on_more(monkeypatch):
    clock = Clock(monkeypatch, filled(0.2), filled(0.01))
    found = plan.time_cells(study_of(scenarios=100), filled(1.0), filled(True))
    assert {signals for _, signals in clock.runs} == {100}
    assert found.seconds == pytest.approx(100 * 1.2)


def test_cells_that_are_done_are_neither_run_nor_counted(monkeypatch):
    missing = filled(False)
    missing[3, 5:9] = True
    clock = Clock(monkeypatch, filled(0.1), filled(1e-3))
    found = plan.time_cells(study_of(), filled(1.0), missing)
    assert {index for index, _ in clock.runs} == {(3, i) for i in range(5, 9)}
    assert (found.cells, found.seconds) == (4, pytest.approx(4 * 10.1))
    assert plan.time_cells(study_of(), filled(1.0), filled(False)) == (0.0, 0)


def test_a_study_without_axes_is_one_cell(monkeypatch):
    clock = Clock(monkeypatch, {(): 0.1}, {(): 1e-3})
    study = dt.function_study(lambda: make_loop(0.3, 0.5), {}, scenarios=10_000)
    found = plan.time_cells(study, np.array(5.0), np.array(True))
    assert (found.cells, found.seconds) == (1, pytest.approx(10.1))
    assert {index for index, _ in clock.runs} == {()}


def test_a_trial_changes_what_a_plan_says_of_time_alone(tmp_path):
    study = study_of({"delay": [0.1, 0.2], "weight": [0.5]}, scenarios=20)
    plain, tried = (plan_of(study, tmp_path / "no.zarr", trial=trial) for trial in (False, True))
    assert (plain.timed, tried.timed) == (0, 2)
    assert tried.seconds > 0.0
    known = ("cells", "done", "blocks", "missing", "runs", "size", "objects", "exists", "store")
    assert [getattr(tried, name) for name in known] == [getattr(plain, name) for name in known]
    assert not (tmp_path / "no.zarr").exists()
