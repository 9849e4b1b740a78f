"""What pydantic found wrong with a file, in one line: file, line, key, what to do."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from deadtime.toml_file.lines import Path as Keys
from deadtime.toml_file.lines import at_line, key_lines, line_of

_TYPES = {"float", "str", "int", "literal['ideal']"}


def first_complaint(source: Path, text: str, error: ValidationError, model: type[BaseModel]) -> str:
    """The first thing wrong, with the line of its key."""
    lines = key_lines(text)
    path, sentence = first_fault(error, model, lines)
    return f"{at_line(source, line_of(lines, path))}: {sentence}"


def first_fault(
    error: ValidationError, model: type[BaseModel], lines: Mapping[Keys, int] | None = None
) -> tuple[Keys, str]:
    """The path of keys to the first thing wrong, and a sentence about it."""
    found = error.errors()

    def order(item: Any) -> tuple[bool, int]:
        # A misspelt key is also a missing one: name the misspelling.
        line = line_of(lines or {}, _plain(item["loc"], model))
        return item["type"] == "missing", line or 10**9

    first = min(found, key=order)
    path = _plain(first["loc"], model)
    more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
    name = ".".join(map(str, path)) or "file"
    return path, f"{_sentence(first, name, model)}{more}"


def _plain(location: tuple, model: type[BaseModel]) -> tuple:
    """The path of keys, without the types and union tags that pydantic puts into it."""
    path, models = [], [model]
    for part in location:
        if isinstance(part, str):
            if "[" in part or part in _TYPES:
                continue
            if tagged := _tagged(part, models):
                models = tagged
                continue
            models = [inner for outer in models for inner in _models_in(outer, part)]
        path.append(part)
    return tuple(path)


def _tagged(part: str, models: list[type[BaseModel]]) -> list[type[BaseModel]]:
    """The models of a union that a part of a location selects by their kind, if it does."""
    return [
        model
        for model in models
        if (kind := model.model_fields.get("kind")) is not None
        and part in getattr(kind.annotation, "__args__", ())
    ]


def _sentence(item: Any, name: str, model: type[BaseModel]) -> str:
    kind = item["type"]
    if kind == "missing":
        return f"{name} is missing: add it."
    if kind == "extra_forbidden":
        near = difflib.get_close_matches(str(item["loc"][-1]), _known_keys(item["loc"], model), 1)
        return f"{name} is not known" + (f": did you mean {near[0]}?" if near else ": remove it.")
    if kind == "union_tag_not_found":
        return f"{name}.kind is missing: add it."
    if kind == "union_tag_invalid":
        context = item["ctx"]
        return f"{name}.kind must be one of {context['expected_tags']}, got {context['tag']!r}."
    message = item["msg"].removeprefix("Value error, ")
    message, given = f"{message[0].lower()}{message[1:]}", item["input"]
    if isinstance(given, (str, int, float, bool)) and repr(given) not in message:
        message += f", got {given!r}"
    return f"{name}: {message}" + ("" if message.endswith("?") else ".")


def _known_keys(location: tuple, model: type[BaseModel]) -> list[str]:
    """Names that would be valid beside an unknown key."""
    models: list[type[BaseModel]] = [model]
    for part in location[:-1]:
        if isinstance(part, str):
            models = (
                _tagged(part, models)
                or [inner for outer in models for inner in _models_in(outer, part)]
                or models
            )
    return [name for model in models for name in model.model_fields]


def _models_in(model: type[BaseModel], key: str) -> list[type[BaseModel]]:
    """The models that a field may hold."""
    field = model.model_fields.get(key)
    return [] if field is None else _nested(field.annotation)


def _nested(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [m for part in getattr(annotation, "__args__", ()) for m in _nested(part)]
