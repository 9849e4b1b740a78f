"""Read a problem file; every error names the file, the line and the key."""

from __future__ import annotations

import difflib
import re
import tomllib
from os import PathLike
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from deadtime.errors import ProblemFileError
from deadtime.problem_file.build import SectionError, build_problem
from deadtime.problem_file.lines import key_lines, line_of
from deadtime.problem_file.schema import ProblemFile
from deadtime.problems import Problem


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
    try:
        text = source.read_text(encoding="utf-8")
    except OSError as error:
        raise ProblemFileError(
            f"{source} cannot be read: {error.strerror}; `deadtime init` writes one."
        ) from None
    except UnicodeDecodeError:
        raise ProblemFileError(f"{source} is not UTF-8 text: save it as UTF-8.") from None
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ProblemFileError(f"{source} is not valid TOML: {error}.") from None
    try:
        file = ProblemFile.model_validate(data)
    except ValidationError as error:
        raise ProblemFileError(_first_complaint(source, text, error)) from None
    try:
        return build_problem(file, source)
    except SectionError as error:
        raise ProblemFileError(_in_section(source, text, error)) from None


def _in_section(source: Path, text: str, error: SectionError) -> str:
    """The message with its line: that of the key it starts with, or of the section."""
    lines = key_lines(text)
    key = re.split(r"[ \[:]", str(error), maxsplit=1)[0]
    path = (*error.path, key) if (*error.path, key) in lines else error.path
    section = ".".join(map(str, error.path))
    return f"{_place(source, line_of(lines, path))}, [{section}]: {error}"


def _place(source: Path, line: int | None) -> str:
    return str(source) if line is None else f"{source}, line {line}"


def _first_complaint(source: Path, text: str, error: ValidationError) -> str:
    """The first thing wrong, in one line, with the line of its key."""
    lines, found = key_lines(text), error.errors()

    def order(item: Any) -> tuple[bool, int]:
        # A misspelt key is also a missing one: name the misspelling.
        return item["type"] == "missing", line_of(lines, _plain(item["loc"])) or 10**9

    first = min(found, key=order)
    path = _plain(first["loc"])
    more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
    name = ".".join(map(str, path)) or "file"
    return f"{_place(source, line_of(lines, path))}: {_sentence(first, name)}{more}"


def _plain(location: tuple) -> tuple:
    """The path of keys, without the union tags that pydantic puts into it.

    >>> _plain(("law", 0, "averaged", "weights"))
    ('law', 0, 'weights')
    """
    types = {"float", "str", "int", "literal['ideal']"}
    location = tuple(
        p for p in location if not isinstance(p, str) or ("[" not in p and p not in types)
    )
    if location[:1] == ("law",) and len(location) > 2:
        return location[:2] + location[3:]
    if location[:1] == ("signal",) and len(location) > 1:
        return location[:1] + location[2:]
    return location


def _sentence(item: Any, name: str) -> str:
    kind = item["type"]
    if kind == "missing":
        return f"{name} is missing: add it."
    if kind == "extra_forbidden":
        near = difflib.get_close_matches(str(item["loc"][-1]), _known_keys(item["loc"]), 1)
        return f"{name} is not known" + (f": did you mean {near[0]}?" if near else ": remove it.")
    if kind == "union_tag_not_found":
        return f"{name}.kind is missing: add it."
    if kind == "union_tag_invalid":
        context = item["ctx"]
        return f"{name}.kind must be one of {context['expected_tags']}, got {context['tag']!r}."
    message = item["msg"].removeprefix("Value error, ")
    given = item["input"]
    shown = f", got {given!r}" if isinstance(given, (str, int, float, bool)) else ""
    return f"{name}: {message[0].lower()}{message[1:]}{shown}."


def _known_keys(location: tuple) -> list[str]:
    """Names that would be valid beside an unknown key."""
    models: list[type[BaseModel]] = [ProblemFile]
    for part in location[:-1]:
        if isinstance(part, str):
            models = [inner for model in models for inner in _models_in(model, part)] or models
    return [name for model in models for name in model.model_fields]


def _models_in(model: type[BaseModel], key: str) -> list[type[BaseModel]]:
    """The models that a field may hold; a union tag selects among the models themselves."""
    kind = model.model_fields.get("kind")
    if kind is not None and key in getattr(kind.annotation, "__args__", ()):
        return [model]
    field = model.model_fields.get(key)
    return [] if field is None else _nested(field.annotation)


def _nested(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [m for part in getattr(annotation, "__args__", ()) for m in _nested(part)]
