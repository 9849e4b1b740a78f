"""Linear matrix inequalities: solvers in turn, whose failures are told from their answers.

A solver's answer is a proposal. Whoever asks puts it back into its inequality and keeps it only
if it holds there; so an inaccurate answer does no harm, and the next solver gets its turn. That
there is no solution is concluded only from what a solver that works has said.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection, Iterator
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from deadtime.base.errors import SolverError

SOLVERS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("CLARABEL", {"tol_gap_abs": 1e-10, "tol_gap_rel": 1e-10, "tol_feas": 1e-10}),
    ("CLARABEL", {}),
    ("SCS", {"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iters": 10_000}),
)


# What a solver says that stopped before it knew.
_GAVE_UP = ("solver_error", "user_limit")


class Verdict(NamedTuple):
    """What a solver said of a problem, and why it failed, which is empty if it did not."""

    said: str
    failure: str = ""


def library(name: str) -> Any:
    """A library that solves, such as cvxpy; a SolverError if it does not import.

    Examples
    --------
    >>> library("cvxpy").__name__
    'cvxpy'
    """
    try:
        return import_module(name)
    except Exception as error:  # broken by another library's version it raises anything
        raise SolverError(
            f"{name} does not import ({_one_line(error)}), so there is no answer: install versions "
            "that fit each other, python -m pip install --upgrade cvxpy clarabel numpy scipy."
        ) from error


def attempts(problem: Any) -> Iterator[Verdict]:
    """Solve a cvxpy problem with one solver after the other; yield what each has to say.

    Whatever a solver throws becomes its verdict. The answer, if there is one, is in the
    variables of the problem when the verdict is yielded.
    """
    for name, options in SOLVERS:
        for variable in problem.variables():
            variable.value = None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                problem.solve(solver=name, **options)
                said = str(problem.status)
                failure = said if said in _GAVE_UP else ""
            except (KeyboardInterrupt, SystemExit, GeneratorExit):
                raise
            except BaseException as error:  # a panic in compiled code is no Exception
                said, failure = f"failed ({type(error).__name__})", _one_line(error)
        yield Verdict(f"{name}: {said}", failure)


def require_answer(verdicts: Collection[Verdict]) -> None:
    """Refuse to conclude anything where every solver failed.

    Examples
    --------
    >>> require_answer([Verdict("CLARABEL: infeasible"), Verdict("SCS: failed (X)", "X: broken")])
    """
    if all(verdict.failure for verdict in verdicts):
        why = "; ".join(dict.fromkeys(verdict.failure for verdict in verdicts))
        raise SolverError(
            f"no solver answered ({answers_of(verdicts)}), so nothing is known: {why}. If a small "
            "problem fails, too, the installation is broken: python -m pip install --upgrade cvxpy "
            "clarabel numpy scipy; or else rescale states whose units differ by many powers of ten."
        )


def answers_of(verdicts: Collection[Verdict]) -> str:
    """What was said, each once."""
    return ", ".join(dict.fromkeys(verdict.said for verdict in verdicts))


def _one_line(error: BaseException) -> str:
    """What was thrown, in at most 200 characters."""
    return " ".join(f"{type(error).__name__}: {error}".split())[:200]


def symmetric_value(variable: Any) -> np.ndarray | None:
    """The symmetrised value of a square variable, or None if the solver left no finite one."""
    value = variable.value
    if value is None or not np.isfinite(value).all():
        return None
    return (value + value.T) / 2.0


def balanced_units(matrices: np.ndarray) -> np.ndarray:
    """Units t of the states, powers of two, in which the matrices T⁻¹ M_i T are balanced.

    Solvers misjudge an inequality whose entries differ by many powers of ten.
    """
    from scipy.linalg import matrix_balance

    result: Any = matrix_balance(np.abs(matrices).sum(axis=0), permute=False, separate=True)
    return np.asarray(result[1][0])
