"""Problems by name or by file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from deadtime.errors import ArgumentError

if TYPE_CHECKING:
    from deadtime.problems import Problem


def problem_of(name: str) -> Problem:
    """A named problem, or one from a file."""
    from deadtime.problem_file import load_problem
    from deadtime.problems import NAMED

    if name in NAMED:
        return NAMED[name]()
    if not Path(name).suffix and not Path(name).exists():
        raise ArgumentError(
            f"problem must be one of {', '.join(NAMED)}, or a file that exists, got {name!r}."
        )
    return load_problem(name)
