"""Problems by name or by file."""

from __future__ import annotations

from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING

from deadtime.errors import ArgumentError

if TYPE_CHECKING:
    from deadtime.problems import Problem


def problem_of(place: Path) -> Problem:
    """A named problem, or one from a file."""
    from deadtime.problem_file import load_problem
    from deadtime.problems import NAMED

    name = str(place)
    if name in NAMED:
        return NAMED[name]()
    if not place.suffix and not place.exists():
        near = get_close_matches(name, NAMED, n=1)
        hint = f" Did you mean {near[0]}?" if near else ""
        raise ArgumentError(
            f"problem must be one of {', '.join(NAMED)}, or a file that exists, got {name!r}.{hint}"
        )
    return load_problem(place)
