"""Problems from files of which a law may fail to be built: the others run without it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from deadtime.problems.file import schema
from deadtime.problems.file.build import build_problem
from deadtime.problems.problem import Problem
from deadtime.problems.toml import SectionError, require_valid

Prepare = Callable[[schema.ProblemFile], schema.ProblemFile]


def build_what_can(
    draft: Mapping[str, Any], source: Path, prepare: Prepare = lambda file: file
) -> tuple[schema.ProblemFile, Problem, dict[int, str]]:
    """A problem with those of its laws that can be built.

    Parameters
    ----------
    draft : mapping
        What the problem file says, as nested dictionaries and lists.
    source : Path
        Where it lies; relative paths start at its folder.
    prepare : callable
        Changes the checked file before the problem is built from it.

    Returns
    -------
    tuple
        The checked file and the problem without the laws that failed, and why each of these
        did, by its number among the file's laws.

    Raises
    ------
    SectionError
        If anything but a law is wrong, or every law is.
    """
    reasons: dict[int, str] = {}
    left = list(range(len(draft.get("law", []))))
    while True:
        laws = [draft["law"][i] for i in left]
        file = require_valid(
            schema.ProblemFile, {**draft, "law": laws} if "law" in draft else dict(draft)
        )
        try:
            return file, build_problem(prepare(file), source), reasons
        except SectionError as error:
            if error.path[:1] != ("law",) or len(left) == 1:
                raise
            reasons[left.pop(int(error.path[1]))] = str(error)
