"""Linear matrix inequalities: solvers in turn, whose failures are verdicts.

A solver's answer is a proposal. Whoever asks puts it back into its inequality and keeps it only
if it holds there; so an inaccurate answer does no harm, and the next solver gets its turn.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np

SOLVERS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("CLARABEL", {"tol_gap_abs": 1e-10, "tol_gap_rel": 1e-10, "tol_feas": 1e-10}),
    ("CLARABEL", {}),
    ("SCS", {"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iters": 10_000}),
)


def attempts(problem: Any) -> Iterator[str]:
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
                verdict = str(problem.status)
            except (KeyboardInterrupt, SystemExit, GeneratorExit):
                raise
            except BaseException as error:  # a panic in compiled code is no Exception
                verdict = f"failed ({type(error).__name__})"
        yield f"{name}: {verdict}"


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
