"""Problems by name or by file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from deadtime.problems import Problem


def problem_of(place: Path) -> Problem:
    """A named problem, or one from a file."""
    from deadtime.problem_file import load_problem
    from deadtime.problem_file.named import is_named
    from deadtime.problems import NAMED

    return NAMED[str(place)]() if is_named(place) else load_problem(place)
