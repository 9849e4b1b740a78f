"""Linear matrix inequalities, solved by Clarabel, whose failures are told from its answers.

A solver's answer is a proposal. Whoever asks puts it back into its inequality and keeps it only
if it holds there; so an inaccurate answer does no harm, and other tolerances get their turn. That
there is no solution is concluded only from what a solver that works has said.

Symmetric matrices are packed: the upper half by columns, what is off the diagonal times √2 where
the solver sees it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from deadtime.base.errors import SolverError

TOLERANCES = (1e-10, None, 1e-6)  # of gap and feasibility; None: the solver's own
_WORDS = {
    "Solved": "optimal",
    "AlmostSolved": "optimal_inaccurate",
    "PrimalInfeasible": "infeasible",
    "AlmostPrimalInfeasible": "infeasible_inaccurate",
    "DualInfeasible": "unbounded",
    "AlmostDualInfeasible": "unbounded_inaccurate",
    "MaxIterations": "user_limit",
    "MaxTime": "user_limit",
}
# What a solver says that stopped before it knew.
_GAVE_UP = ("solver_error", "user_limit")


class Limit(NamedTuple):
    """Σ_i x_i M[i] + constant ⪰ 0."""

    M: np.ndarray
    constant: np.ndarray


class Program(NamedTuple):
    """Minimise cost·x subject to limits."""

    cost: np.ndarray
    limits: Sequence[Limit]


class Verdict(NamedTuple):
    """A solver's word on a program, why it failed, empty if it did not, and its answer."""

    said: str
    failure: str = ""
    x: np.ndarray | None = None

    @property
    def infeasible(self) -> bool:
        """Whether there is nothing to find."""
        return self.said.endswith(": infeasible")


def library(name: str) -> Any:
    """A library that solves, such as clarabel; a SolverError if it does not import.

    Examples
    --------
    >>> library("clarabel").__name__
    'clarabel'
    """
    try:
        return import_module(name)
    except Exception as error:  # broken by another library's version it raises anything
        raise SolverError(
            f"{name} does not import ({_one_line(error)}), so there is no answer: install versions "
            "that fit each other, python -m pip install --upgrade clarabel numpy scipy."
        ) from error


def attempts(program: Program) -> Iterator[Verdict]:
    """Solve a program with one tolerance after the other; yield what the solver has to say.

    Whatever it throws becomes its verdict.
    """
    solver = library("clarabel")
    for tolerance in TOLERANCES:
        x = None
        try:
            said, x = solve(solver, program, tolerance)
            failure = said if said in _GAVE_UP else ""
        except (KeyboardInterrupt, SystemExit, GeneratorExit):
            raise
        except BaseException as error:  # a panic in compiled code is no Exception
            said, failure = f"failed ({type(error).__name__})", _one_line(error)
        yield Verdict(f"CLARABEL: {said}", failure, x)


def solve(solver: Any, program: Program, tolerance: float | None) -> tuple[str, Any]:
    """The solver's word, and its x where that is an answer."""
    from scipy.sparse import csc_matrix

    settings = settings_of(solver)
    if tolerance is not None:
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    A = csc_matrix(-np.concatenate([pack(limit.M) for limit in program.limits]))
    b = np.concatenate([pack(limit.constant[None])[:, 0] for limit in program.limits])
    cones = [solver.PSDTriangleConeT(len(limit.constant)) for limit in program.limits]
    nothing = csc_matrix((len(program.cost),) * 2)
    found = solver.DefaultSolver(nothing, program.cost, A, b, cones, settings).solve()
    said, x = _WORDS.get(str(found.status), "solver_error"), np.array(found.x)
    return said, x if said.startswith("optimal") and np.isfinite(x).all() else None


def settings_of(solver: Any) -> Any:
    """Clarabel's settings for the small programs here: silent, in one thread."""
    settings = solver.DefaultSettings()
    settings.verbose = False
    if hasattr(settings, "max_threads"):  # laws share the processors
        settings.max_threads = 1
    return settings


def require_answer(verdicts: Collection[Verdict]) -> None:
    """Refuse to conclude anything where every attempt failed.

    Examples
    --------
    >>> require_answer([Verdict("CLARABEL: failed (X)", "X: broken"), Verdict("CLARABEL: optimal")])
    """
    if all(verdict.failure for verdict in verdicts):
        why = "; ".join(dict.fromkeys(verdict.failure for verdict in verdicts))
        raise SolverError(
            f"no solver answered ({answers_of(verdicts)}), so nothing is known: {why}. If a small "
            "problem fails, too, the installation is broken: python -m pip install --upgrade "
            "clarabel numpy scipy; or else rescale states whose units differ by many powers of ten."
        )


def answers_of(verdicts: Collection[Verdict]) -> str:
    """The solvers' words, each once."""
    return ", ".join(dict.fromkeys(verdict.said for verdict in verdicts))


def _one_line(error: BaseException) -> str:
    """An error in at most 200 characters."""
    return " ".join(f"{type(error).__name__}: {error}".split())[:200]


def packing(size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows, columns and factors of a symmetric matrix packed by columns of its upper half."""
    columns, rows = np.tril_indices(size)
    return rows, columns, np.where(rows == columns, 1.0, np.sqrt(2.0))


def pack(M: np.ndarray) -> np.ndarray:
    """(entries, unknowns) of a constraint Σ x_i M_i ⪰ 0."""
    rows, columns, factors = packing(M.shape[1])
    return (M[:, rows, columns] * factors).T


def unpack(entries: np.ndarray, size: int) -> np.ndarray:
    """The symmetric matrix of its packed entries."""
    rows, columns, _ = packing(size)
    result = np.zeros((size, size))
    result[rows, columns] = result[columns, rows] = entries
    return result


def symmetric_basis(size: int) -> np.ndarray:
    """The matrices (entries, size, size) that unknown packed entries multiply."""
    return np.array([unpack(entry, size) for entry in np.eye(size * (size + 1) // 2)])


def symmetric_value(x: np.ndarray | None, size: int) -> np.ndarray | None:
    """The symmetric matrix whose packed entries are the first unknowns; None without an answer."""
    return None if x is None else unpack(x[: size * (size + 1) // 2], size)


def balanced_units(matrices: np.ndarray) -> np.ndarray:
    """Units t of the states, powers of two, in which the matrices T⁻¹ M_i T are balanced.

    Solvers misjudge an inequality whose entries differ by many powers of ten.
    """
    from scipy.linalg import matrix_balance

    result: Any = matrix_balance(np.abs(matrices).sum(axis=0), permute=False, separate=True)
    return np.asarray(result[1][0])
