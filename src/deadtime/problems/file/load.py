"""Read a problem file; every error names the file, the line and the key."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from deadtime.base.errors import ArgumentError, ProblemFileError
from deadtime.problems.file.build import build_problem
from deadtime.problems.file.named_problems import is_named, template
from deadtime.problems.file.schema import ProblemFile
from deadtime.problems.problem import Problem
from deadtime.problems.toml import SectionError, read_toml

_HINT = "`deadtime init` writes one"


def load_problem(path: str | PathLike[str]) -> Problem:
    """The problem that a TOML file describes.

    Parameters
    ----------
    path : path
        The file; `deadtime init` writes a commented one to start from.

    Raises
    ------
    ProblemFileError
        If the file is missing, is not TOML, has unknown or missing keys, or describes a
        problem that does not hold together. The message is one line.
    """
    source = Path(path)
    file, text = read_toml(source, ProblemFile, ProblemFileError, _HINT)
    try:
        return build_problem(file, source)
    except SectionError as error:
        raise text.complaint(error) from None


def problem_with_run(place: Path, run: Mapping[str, Any]) -> Problem:
    """A problem by its name or its file, with entries of its [run] replaced.

    Parameters
    ----------
    place : Path
        The name, or the file.
    run : mapping
        Entries of the section by their names, as numbers and lists.

    Raises
    ------
    ArgumentError
        If an entry does not fit; else what `load_problem` raises.

    Examples
    --------
    >>> problem_with_run(Path("paper"), {"horizon": 2.0}).horizon
    2.0
    """
    if is_named(place):
        file = ProblemFile.model_validate(tomllib.loads(template(str(place))))
        source, text = Path(f"{place}.toml"), None
    else:
        file, text = read_toml(place, ProblemFile, ProblemFileError, _HINT)
        source = place
    file = file.model_copy(update={"run": file.run.model_copy(update=dict(run))})
    try:
        return build_problem(file, source)
    except SectionError as error:
        if text is None or error.path == ("run",):  # not what a line of the file says
            raise ArgumentError(str(error)) from None
        raise text.complaint(error) from None
