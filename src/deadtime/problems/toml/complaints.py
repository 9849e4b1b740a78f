"""What pydantic found wrong with a file, in one line: file, lines, keys, what to do."""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from deadtime.base.checks import real_array
from deadtime.base.errors import ArgumentError
from deadtime.problems.toml.lines import Path as Keys, at_line, key_lines, line_of
from deadtime.problems.toml.shape import Shape
from deadtime.problems.toml.walk import Place, place_of

MOST = 50  # faults that a line tells
_TABLE = ("model_type", "model_attributes_type", "dict_type")
_ASIDE = re.compile(r", (unable to parse string as|got a number with) .*")
_DICTIONARY = re.compile(r"a valid dictionary( or instance of \w+)?")
_WORDS = {dict: "a table", list: "a list", str: "a text", bool: "true or false"}


class Fault(NamedTuple):
    """What is wrong with one key: its path, and a sentence."""

    path: Keys
    sentence: str


def complaint(
    source: Path, text: str, error: ValidationError, model: type[BaseModel], data: Any
) -> str:
    """All that is wrong, each with the line of its key."""
    lines = key_lines(text)
    told = ""
    found, more = faults(error, model, data, lines)
    for fault in found:
        line = line_of(lines, fault.path)
        where = f"{at_line(source, line)}: " if not told else f" Line {line}: " if line else " "
        told += where + fault.sentence
    return told + more


def faults(
    error: ValidationError,
    model: type[BaseModel],
    data: Any,
    lines: Mapping[Keys, int] | None = None,
) -> tuple[list[Fault], str]:
    """One for each key with something wrong, in the order of the file; and what is left out."""
    groups: dict[Keys, list[tuple[Any, Place]]] = {}
    for item in error.errors(include_url=False):
        place = place_of(item["loc"], model, known=item["type"] != "extra_forbidden")
        groups.setdefault(place.path, []).append((item, place))
    # Of a value that may be one thing or another, the fault inside what it is says more.
    outer = {path[:end] for path in groups for end in range(1, len(path))}

    def order(path: Keys) -> tuple[bool, int]:
        # A misspelt key is also a missing one: name the misspelling first.
        missing = groups[path][0][0]["type"] == "missing"
        return missing, line_of(lines or {}, path) or 10**9

    paths = sorted(groups.keys() - outer, key=order)
    more = f" (and {len(paths) - MOST} more)" if len(paths) > MOST else ""
    return [Fault(path, _sentence(groups[path], data)) for path in paths[:MOST]], more


def _sentence(group: Sequence[tuple[Any, Place]], data: Any) -> str:
    """What is wrong with a key, and what to do about it."""
    (item, place), kind = group[0], group[0][0]["type"]
    name = ".".join(map(str, place.path)) or "file"
    if kind == "missing":
        return f"{name} is missing: add it."
    if kind == "extra_forbidden":
        if place.elsewhere:
            kinds = " or ".join(f'"{kind}"' for kind in place.elsewhere[:3])
            return f"{name} is not of this kind, but of kind = {kinds}: remove it, or change kind."
        return f"{name} is not known: {_advice(str(place.path[-1]), place.siblings)}"
    if kind == "union_tag_not_found":
        return f"{name}.kind is missing: add it."
    if kind == "union_tag_invalid":
        context = item["ctx"]
        return (
            f"{name}.kind must be one of {context['expected_tags']}, got {_short(context['tag'])}."
        )
    given = _at(data, place.path)
    shape = _shape(place.field)
    if shape is not None and (found := _misshapen(name, str(place.path[-1]), given, shape)):
        return found
    if place.tables and kind in (*_TABLE, "list_type"):
        return _no_table(name, given, place)
    whole = ".".join(map(str, (name, *place.item)))
    return _in_words_of_pydantic(whole, [item for item, _ in group])


def _advice(key: str, known: Sequence[str]) -> str:
    """The known key that is meant, if one is near, or all of them."""
    # A slip of the fingers seldom hits the first letter, and other words begin otherwise.
    near = difflib.get_close_matches(key, [name for name in known if name[:1] == key[:1]], 1)
    return f"did you mean {near[0]}?" if near else f"it can be one of {', '.join(known)}."


def _shape(field: FieldInfo | None) -> Shape | None:
    """The note on a field, or on what it holds where it may hold nothing, too."""
    if field is None:
        return None
    inner = [m for part in get_args(field.annotation) for m in getattr(part, "__metadata__", ())]
    return next((mark for mark in (*field.metadata, *inner) if isinstance(mark, Shape)), None)


def _misshapen(name: str, key: str, given: Any, shape: Shape) -> str:
    """The sentence that Python has for such an array, with an example of what it should be."""
    example = f"such as {key} = {json.dumps(shape.example, ensure_ascii=False)}"
    if not shape.is_array:
        return f"{name} must be {shape.form}, {example}, got {_short(given)}."
    try:
        real_array(name, given, shape.form, shape.axes)
    except ArgumentError as error:
        return f"{str(error).removesuffix('.')}; {example}."
    return ""


def _no_table(name: str, given: Any, place: Place) -> str:
    """Of something that stands where a table, or a list of tables, should."""
    kind = _WORDS.get(type(given), "a value")
    header = ".".join(part for part in place.path if isinstance(part, str))
    if place.listed:
        return f"{name} must be a list of tables, each begun by [[{header}]], got {kind}."
    if isinstance(place.path[-1], int):
        return f"{name} must be a table, begun by [[{header}]], got {kind}."
    return f"{name} must be one table, begun by [{header}], got {kind}."


def _in_words_of_pydantic(name: str, items: Sequence[Any]) -> str:
    """What pydantic says of a value, or of each kind that it could have had."""
    messages: list[str] = []
    for item in items:
        message = _ASIDE.sub("", item["msg"].removeprefix("Value error, "))
        message = _DICTIONARY.sub("a table", f"{message[0].lower()}{message[1:]}")
        if messages:
            message = message.removeprefix("input should be ")
        if message not in messages:
            messages.append(message)
    message, given = " or ".join(messages), items[0]["input"]
    if isinstance(given, (str, int, float, bool)) and _short(given) not in message:
        message += f", got {_short(given)}"
    return f"{name}: {message}" + ("" if message.endswith("?") else ".")


def _short(given: Any) -> str:
    """A value, or its beginning."""
    try:
        text = repr(given)
    except ValueError:  # Python writes no integer of more than some thousand digits
        text = "a number of thousands of digits"
    return text if len(text) <= 80 else f"{text[:79]}…"


def _at(data: Any, path: Keys) -> Any:
    """What the file says at a path of keys."""
    for key in path:
        data = data[key]
    return data
