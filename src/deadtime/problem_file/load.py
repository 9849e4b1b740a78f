"""Read a problem file; every error names the file, the line and the key."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from deadtime.errors import ProblemFileError
from deadtime.problem_file.build import build_problem
from deadtime.problem_file.schema import ProblemFile
from deadtime.problems import Problem
from deadtime.toml_file import SectionError, read_toml


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
    hint = "`deadtime init` writes one"
    file, text = read_toml(source, ProblemFile, ProblemFileError, hint)
    try:
        return build_problem(file, source)
    except SectionError as error:
        raise text.complaint(error) from None
