"""A solver that is broken is not a solver that found nothing: what a user is told of each."""

import sys

import numpy as np
import pytest

import deadtime as dt
from deadtime.certificates.dwell.solvers import maximise
from deadtime.cli.application import main
from deadtime.gains import common_lyapunov, stabilize
from deadtime.numerics import lmi

PROBLEM = dt.problems.paper()
SEARCHES = {
    "common_lyapunov": lambda: common_lyapunov(PROBLEM.plant, PROBLEM.gains),
    "stabilize": lambda: stabilize(PROBLEM.plant, 1.0),
    "theorem_bound": lambda: dt.theorem_bound(PROBLEM.plant, PROBLEM.gains, 0.2),
    "sharp": lambda: dt.theorem_bound(PROBLEM.plant, PROBLEM.gains, 0.2, form="sharp"),
}


def not_imported(monkeypatch):
    monkeypatch.setitem(sys.modules, "clarabel", None)
    return r"clarabel does not import \(ModuleNotFoundError: .*\), so there is no answer"


def broken_inside(monkeypatch):
    """It imports, and cannot solve a problem."""

    def solve(*_):
        raise ImportError("numpy.core.multiarray failed to import")

    monkeypatch.setattr(lmi, "solve", solve)
    return r"no solver answered .*failed \(ImportError\).*multiarray failed to import"


def out_of_patience(monkeypatch):
    monkeypatch.setattr(lmi, "solve", lambda *_: ("user_limit", None))
    return r"no solver answered \(CLARABEL: user_limit\)"


@pytest.mark.parametrize("search", SEARCHES)
@pytest.mark.parametrize("break_it", [not_imported, broken_inside, out_of_patience])
def test_nothing_is_called_infeasible_where_no_solver_works(monkeypatch, search, break_it):
    with pytest.raises(dt.SolverError, match=break_it(monkeypatch)) as caught:
        SEARCHES[search]()
    assert not isinstance(caught.value, (dt.InfeasibleError, ValueError))


def test_a_solver_keeps_to_one_thread():
    settings = lmi.settings_of(lmi.library("clarabel"))
    assert not settings.verbose
    assert getattr(settings, "max_threads", 1) == 1


def test_one_attempt_that_answers_is_enough_for_a_verdict(monkeypatch):
    """Modes without a common P: the first tolerance breaks, the second says so."""
    solve = lmi.solve

    def first_breaks(solver, program, tolerance):
        if tolerance == lmi.TOLERANCES[0]:
            raise RuntimeError("broken")
        return solve(solver, program, tolerance)

    monkeypatch.setattr(lmi, "solve", first_breaks)
    A = np.array([[[-1.0, -1.0], [1.0, -1.0]], [[-1.0, -40.0], [1 / 40.0, -1.0]]])
    plant = dt.SwitchedSystem(A, np.zeros((2, 2, 1)), 1.0)
    with pytest.raises(dt.InfeasibleError, match=r"failed \(RuntimeError\), CLARABEL: infeasible"):
        common_lyapunov(plant, np.zeros((2, 1, 2)))


def test_a_search_that_has_something_to_fall_back_on_needs_the_library_all_the_same(monkeypatch):
    monkeypatch.setitem(sys.modules, "clarabel", None)
    with pytest.raises(dt.SolverError, match="clarabel does not import"):
        maximise(np.eye(1), np.ones(1), [1])


def test_the_command_says_it_in_one_line(monkeypatch, capsys):
    not_imported(monkeypatch)
    with pytest.raises(SystemExit) as stopped:
        main(["bound", "paper", "--dwell-time", "0.5"])
    out, err = capsys.readouterr()
    assert (stopped.value.code, out, err.count("\n")) == (2, "", 1)
    assert "clarabel does not import" in err


def test_a_library_that_breaks_while_it_is_imported_is_named(tmp_path, monkeypatch):
    (tmp_path / "half_there.py").write_text("import numpy\nnumpy.no_longer_there\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(dt.SolverError, match=r"half_there does not import \(AttributeError: "):
        lmi.library("half_there")
