"""Read a problem file; every error names the file, the line and the key.

A page or a study uses `build_what_can`, which leaves out laws that cannot be built.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from deadtime.base.errors import ArgumentError, ProblemFileError
from deadtime.problems.file import schema
from deadtime.problems.file.build import build_problem
from deadtime.problems.file.mode_names import with_mode_numbers
from deadtime.problems.file.schema import ProblemFile
from deadtime.problems.problem import Problem
from deadtime.problems.templates import is_named, template
from deadtime.problems.toml import SectionError, read_toml, require_valid

Prepare = Callable[[schema.ProblemFile], schema.ProblemFile]


def build_what_can(
    draft: Mapping[str, Any], source: Path, prepare: Prepare = lambda file: file
) -> tuple[schema.ProblemFile, Problem, dict[int, str]]:
    """The checked file, a problem with those of its laws that can be built, and why others cannot.

    `draft` is the content of the file, as nested dictionaries and lists; relative paths start at
    the folder of `source`; `prepare` changes the checked file before the problem is built. The
    reasons are listed by the numbers of the laws in the file.

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
            file = with_mode_numbers(file)
            return file, build_problem(prepare(file), source), reasons
        except SectionError as error:
            if error.path[:1] != ("law",) or len(left) == 1:
                raise
            reasons[left.pop(int(error.path[1]))] = str(error)


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
    """A problem by its name or its file, with entries of its [run] replaced by numbers and lists.

    Raises
    ------
    ArgumentError
        If an entry does not fit; other errors as in `load_problem`.

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
    # Copies are not validated; `build_problem` checks the numbers of [run].
    file = file.model_copy(update={"run": file.run.model_copy(update=dict(run))})
    try:
        return build_problem(file, source)
    except SectionError as error:
        if text is None or error.path == ("run",):  # no line of the file is wrong
            raise ArgumentError(str(error)) from None
        raise text.complaint(error) from None
