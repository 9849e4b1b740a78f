"""Linear matrix inequalities, solved by Clarabel.

The answer of a solver is a candidate: callers check the inequality with it and reject it otherwise,
so that an inaccurate answer does no harm and other tolerances are tried. Infeasibility is concluded
only from an attempt that did not fail.

Symmetric matrices are packed: the upper triangle by columns, with off-diagonal entries times √2 for
the solver.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from deadtime.base.errors import SolverError

TOLERANCES = (1e-10, None, 1e-6)  # of gap and feasibility; None for the solver's default
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
    """A solver's status, the reason of a failure, empty for none, and its answer."""

    status: str
    failure: str = ""
    x: np.ndarray | None = None

    @property
    def infeasible(self) -> bool:
        """Whether the program has no solution."""
        return self.status.endswith(": infeasible")


def library(name: str) -> Any:
    """A solver's library, such as clarabel; a SolverError if it does not import.

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
    """Solve a program with one tolerance after the other; exceptions become verdicts, too."""
    solver = library("clarabel")
    for tolerance in TOLERANCES:
        x = None
        try:
            status, x = solve(solver, program, tolerance)
            failure = status if status in _GAVE_UP else ""
        except (KeyboardInterrupt, SystemExit, GeneratorExit):
            raise
        except BaseException as error:  # a panic in compiled code is no Exception
            status, failure = f"failed ({type(error).__name__})", _one_line(error)
        yield Verdict(f"CLARABEL: {status}", failure, x)


def solve(solver: Any, program: Program, tolerance: float | None) -> tuple[str, Any]:
    """The solver's status, and x if that is optimal."""
    from scipy.sparse import csc_matrix

    settings = settings_of(solver)
    if tolerance is not None:
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    # Clarabel: A x + s = b with s in the cones, here s the packed matrices.
    A = csc_matrix(-np.concatenate([pack(limit.M) for limit in program.limits]))
    b = np.concatenate([pack(limit.constant[None])[:, 0] for limit in program.limits])
    cones = [solver.PSDTriangleConeT(len(limit.constant)) for limit in program.limits]
    nothing = csc_matrix((len(program.cost),) * 2)
    found = solver.DefaultSolver(nothing, program.cost, A, b, cones, settings).solve()
    status, x = _WORDS.get(str(found.status), "solver_error"), np.array(found.x)
    return status, x if status.startswith("optimal") and np.isfinite(x).all() else None


def settings_of(solver: Any) -> Any:
    """Clarabel's settings for the small programs here: silent, in one thread."""
    settings = solver.DefaultSettings()
    settings.verbose = False
    if hasattr(settings, "max_threads"):  # laws share the processors
        settings.max_threads = 1
    return settings


def require_answer(verdicts: Collection[Verdict]) -> None:
    """Raise a SolverError if every attempt failed.

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
    """The different statuses of the solver."""
    return ", ".join(dict.fromkeys(verdict.status for verdict in verdicts))


def _one_line(error: BaseException) -> str:
    """An error in at most 200 characters."""
    return " ".join(f"{type(error).__name__}: {error}".split())[:200]


def packing(size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows, columns and factors of a symmetric matrix packed by columns of its upper triangle."""
    columns, rows = np.tril_indices(size)
    return rows, columns, np.where(rows == columns, 1.0, np.sqrt(2.0))


def pack(M: np.ndarray) -> np.ndarray:
    """The matrices M_i of a constraint Σ x_i M_i ⪰ 0, packed: (entries, unknowns)."""
    rows, columns, factors = packing(M.shape[1])
    return (M[:, rows, columns] * factors).T


def unpack(entries: np.ndarray, size: int) -> np.ndarray:
    """The symmetric matrix of its packed entries."""
    rows, columns, _ = packing(size)
    result = np.zeros((size, size))
    result[rows, columns] = result[columns, rows] = entries
    return result


def symmetric_basis(size: int) -> np.ndarray:
    """The basis matrices (entries, size, size) of the packed entries."""
    return np.array([unpack(entry, size) for entry in np.eye(size * (size + 1) // 2)])


def symmetric_value(x: np.ndarray | None, size: int) -> np.ndarray | None:
    """The symmetric matrix with the first unknowns as packed entries; None without an answer."""
    return None if x is None else unpack(x[: size * (size + 1) // 2], size)


def balanced_units(matrices: np.ndarray) -> np.ndarray:
    """Units t of the states, powers of two, in which the matrices T⁻¹ M_i T are balanced.

    Solvers are inaccurate for an inequality with entries of very different magnitude.
    """
    from scipy.linalg import matrix_balance

    result: Any = matrix_balance(np.abs(matrices).sum(axis=0), permute=False, separate=True)
    return np.asarray(result[1][0])
