"""All faults of a TOML file in one line: file, lines, keys, and remedies.

The lines of keys are found here, too, since the standard parser does not give them.
"""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from deadtime.base.checks import real_array
from deadtime.base.errors import ArgumentError
from deadtime.problems.toml.sections import Shape, kinds_of, note_of

# The end of a token is optional, so that nothing backtracks and the time is linear in the text.
# (Possessive groups, `*+`, are faulty before Python 3.11.5.)
_TOKEN = re.compile(
    r"""
    (?P<long>  "{3} (?:[^"\\] | \\. | "(?!""))* (?:"{3,5})?
             | '{3} (?:[^'] | '(?!''))* (?:'{3,5})? )
  | (?P<quiet> "(?:[^"\\\n] | \\[^\n])* "? | '[^'\n]*+ '? | \#[^\n]*+ )
  | (?P<open> [\[{] ) | (?P<close> [\]}] ) | (?P<dot> \. ) | (?P<end> [\n=,] )
    """,
    re.VERBOSE | re.DOTALL,
)
_HEADER = re.compile(r"[ \t]*+(\[\[?+)([^\[\]]++)\]\]?+\s*+(?:#.*)?\Z")
_KEY = re.compile(r"[ \t]*+([A-Za-z0-9_.\-\"' \t]++)=")

MOST_KEYS = 20_000
DEEPEST = 20  # of brackets within brackets, and of keys with dots

Keys = tuple[str | int, ...]


def excess(text: str) -> str:
    """The reason to refuse a text before it is parsed: nesting or size; empty if there is none.

    Examples
    --------
    >>> excess("a.b = [[1.0, 2.0], [3.0, 4.0]]"), excess("a = " + 30 * "[")
    ('', 'is nested too deeply: no key needs more than a few brackets or dots')
    """
    depth = dots = keys = 0
    for token in _TOKEN.finditer(text):
        kind = token.lastgroup
        keys += token[0] == "=" or (kind == "open" and depth == 0)
        depth += (kind == "open") - (kind == "close")
        dots = dots + 1 if kind == "dot" else dots if kind == "quiet" else 0
        if max(depth, dots) > DEEPEST:
            return "is nested too deeply: no key needs more than a few brackets or dots"
    return f"has more than {MOST_KEYS:,} keys and tables" if keys > MOST_KEYS else ""


def key_lines(text: str) -> dict[Keys, int]:
    """Line, counted from 1, of every table and key of a valid TOML text.

    Keys inside inline tables and arrays are not listed; look up their parents.

    Examples
    --------
    >>> key_lines("a = 1\\n[t]\\nb = [\\n 2,\\n]\\n[[p]]\\nc = 3")
    {('a',): 1, ('t',): 2, ('t', 'b'): 3, ('p',): 6, ('p', 0): 6, ('p', 0, 'c'): 7}
    """
    lines: dict[Keys, int] = {}
    table: Keys = ()
    counts: dict[Keys, int] = {}
    depth = 0
    for number, line in enumerate(_TOKEN.sub(_without_long, text).split("\n"), 1):
        if depth == 0 and (header := _HEADER.match(line)):
            table = _split(header[2])
            lines.setdefault(table, number)
            if header[1] == "[[":
                counts[table] = counts.get(table, -1) + 1
                table = (*table, counts[table])
                lines[table] = number
            continue
        if depth == 0 and (key := _KEY.match(line)):
            lines.setdefault((*table, *_split(key[1])), number)
        kinds = [token.lastgroup for token in _TOKEN.finditer(line)]
        depth += kinds.count("open") - kinds.count("close")
    return lines


def _without_long(token: re.Match[str]) -> str:
    """The line ends of a string over several lines; other tokens as they are."""
    return '""' + "\n" * token[0].count("\n") if token["long"] else token[0]


def _split(dotted: str) -> Keys:
    return tuple(part.strip().strip("\"'") for part in dotted.split("."))


def line_of(lines: Mapping[Keys, int], path: Keys) -> int | None:
    """Line of the key, or of the nearest table around it."""
    while path:
        if path in lines:
            return lines[path]
        path = path[:-1]
    return None


def at_line(source: Path, line: int | None) -> str:
    """A file and a line of it, for the beginning of a message."""
    return str(source) if line is None else f"{source}, line {line}"


_TYPES = {"float", "str", "int"}
Models = list[type[BaseModel]]


@dataclass(frozen=True)
class Place:
    """A key of a file (immutable).

    Attributes
    ----------
    path : tuple
        Keys, and numbers of tables in lists of tables.
    field : FieldInfo or None
        The field of the model; None for an unknown key.
    siblings : tuple of str
        The known keys of the same table.
    tables : bool
        Whether the key holds tables.
    listed : bool
        Whether it holds a list of them, and the path is without a number.
    item : tuple of int
        The number of an item, in a list of anything but tables.
    elsewhere : tuple of str
        The other kinds of the same section that have the key.
    """

    path: Keys
    field: FieldInfo | None
    siblings: tuple[str, ...]
    tables: bool
    listed: bool
    item: tuple[int, ...] = ()
    elsewhere: tuple[str, ...] = ()


def place_of(location: tuple[str | int, ...], model: type[BaseModel], known: bool = True) -> Place:
    """The key of a location in pydantic's errors.

    Names of types and of members of unions are dropped, and numbers of items in a list of anything
    but tables. Where the last part is a key that is not `known`, it is kept.
    """
    path: list[str | int] = []
    models: Models = [model]
    others: Models = []
    around: Models = [model]
    field: FieldInfo | None = None
    item: list[int] = []
    for number, part in enumerate(location):
        if isinstance(part, int):
            (path if models else item).append(part)
            continue
        if (known or number < len(location) - 1) and _is_no_key(part, models):
            if chosen := _choose(part, models):
                models, others = chosen, [one for one in models if one not in chosen]
            continue
        fields = [one.model_fields[part] for one in models if part in one.model_fields]
        around, field = models or around, fields[0] if fields else None
        models = [inner for one in fields for inner in _models_in(one.annotation)]
        path.append(part)
    siblings = tuple(dict.fromkeys(name for one in around for name in one.model_fields))
    inside = bool(path) and isinstance(path[-1], int)
    listed = bool(models) and not inside and _is_list(field)
    elsewhere = [one for one in others if path and path[-1] in one.model_fields]
    kinds = tuple(kind for one in elsewhere for kind in kinds_of(one))
    return Place(tuple(path), field, siblings, bool(models), listed, tuple(item), kinds)


def _is_no_key(part: str, models: Models) -> bool:
    """Whether a part names a type or a member of a union."""
    return part in _TYPES or "[" in part or bool(_choose(part, models))


def _choose(part: str, models: Models) -> Models:
    """The models of a union that a part selects by their kind or their name, if it does."""
    named = [model for model in models if model.__name__ == part]
    if len(models) == 1:  # a kind was chosen before: the part is a key
        return named
    return named or [model for model in models if part in kinds_of(model)]


def _is_list(field: FieldInfo | None) -> bool:
    return field is not None and getattr(field.annotation, "__origin__", None) is list


def _models_in(annotation: Any) -> Models:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [m for part in getattr(annotation, "__args__", ()) for m in _models_in(part)]


MOST = 50  # faults in a message
_TABLE = ("model_type", "model_attributes_type", "dict_type")
_ASIDE = re.compile(r", (unable to parse string as|got a number with) .*")
_DICTIONARY = re.compile(r"a valid dictionary( or instance of \w+)?")
_WORDS = {dict: "a table", list: "a list", str: "a text", bool: "true or false"}


class Fault(NamedTuple):
    """A fault of one key: its path, and a sentence."""

    path: Keys
    sentence: str


def complaint(
    source: Path, text: str, error: ValidationError, model: type[BaseModel], data: Any
) -> str:
    """All faults, each with the line of its key."""
    lines = key_lines(text)
    sentences = ""
    listed, more = faults(error, model, data, lines)
    for fault in listed:
        line = line_of(lines, fault.path)
        where = (
            f"{at_line(source, line)}: " if not sentences else f" Line {line}: " if line else " "
        )
        sentences += where + fault.sentence
    return sentences + more


def faults(
    error: ValidationError,
    model: type[BaseModel],
    data: Any,
    lines: Mapping[Keys, int] | None = None,
) -> tuple[list[Fault], str]:
    """A fault for each wrong key, in the order of the file; and a note on more of them."""
    groups: dict[Keys, list[tuple[Any, Place]]] = {}
    for item in error.errors(include_url=False):
        place = place_of(item["loc"], model, known=item["type"] != "extra_forbidden")
        groups.setdefault(place.path, []).append((item, place))
    # Of a union the fault inside the chosen member says more.
    outer = {path[:end] for path in groups for end in range(1, len(path))}

    def order(path: Keys) -> tuple[bool, int]:
        # A misspelt key is also a missing one: name the misspelling first.
        missing = groups[path][0][0]["type"] == "missing"
        return missing, line_of(lines or {}, path) or 10**9

    paths = sorted(groups.keys() - outer, key=order)
    more = f" (and {len(paths) - MOST} more)" if len(paths) > MOST else ""
    return [Fault(path, _sentence(groups[path], data)) for path in paths[:MOST]], more


def key_in_words(path: Keys) -> str:
    """A key in a message: the tables of a list are counted from 1.

    Examples
    --------
    >>> key_in_words(("signal", "regions", 0, "mode")), key_in_words(("plant", "A"))
    ('[[signal.regions]] 1, mode', 'plant.A')
    """
    for end, number in enumerate(path):
        if isinstance(number, int):
            table, key = ".".join(map(str, path[:end])), ".".join(map(str, path[end + 1 :]))
            return f"[[{table}]] {number + 1}" + (f", {key}" if key else "")
    return ".".join(map(str, path))


def _kind_of(name: str) -> str:
    """The key `kind` of a table, in a message."""
    return f"{name}, kind" if name.startswith("[[") else f"{name}.kind"


def _sentence(group: Sequence[tuple[Any, Place]], data: Any) -> str:
    """The fault of a key, and its remedy."""
    (item, place), kind = group[0], group[0][0]["type"]
    name = key_in_words(place.path) or "file"
    if kind == "missing":
        return f"{name} is missing: add it."
    if kind == "extra_forbidden":
        if place.elsewhere:
            kinds = " or ".join(f'"{kind}"' for kind in place.elsewhere[:3])
            return f"{name} belongs to kind = {kinds} only: remove it, or change kind."
        return f"{name} is not known: {_advice(str(place.path[-1]), place.siblings)}"
    if kind == "union_tag_not_found":
        return f"{_kind_of(name)} is missing: add it."
    if kind == "union_tag_invalid":
        context = item["ctx"]
        expected, tag = context["expected_tags"], _short(context["tag"])
        return f"{_kind_of(name)} must be one of {expected}, got {tag}."
    given = _at(data, place.path)
    # The shape on a table is that of its values.
    shape = None if not place.field or kind == "dict_type" else note_of(place.field, Shape)
    if shape is not None and (sentence := _misshapen(name, str(place.path[-1]), given, shape)):
        return sentence
    if place.tables and kind in (*_TABLE, "list_type"):
        return _no_table(name, given, place)
    whole = ".".join(map(str, (name, *place.item)))
    return _in_words_of_pydantic(whole, [item for item, _ in group])


def _advice(key: str, known: Sequence[str]) -> str:
    """The known key that is meant, if one is near, or all of them."""
    # Typing errors seldom hit the first letter.
    near = difflib.get_close_matches(key, [name for name in known if name[:1] == key[:1]], 1)
    return f"did you mean {near[0]}?" if near else f"it can be one of {', '.join(known)}."


def _misshapen(name: str, key: str, given: Any, shape: Shape) -> str:
    """The sentence on an array of the wrong shape, with an example."""
    example = f"such as {key} = {json.dumps(shape.example, ensure_ascii=False)}"
    if not shape.is_array:
        return f"{name} must be {shape.form}, {example}, got {_short(given)}."
    try:
        real_array(name, given, shape.form, shape.axes)
    except ArgumentError as error:
        return f"{str(error).removesuffix('.')}; {example}."
    return ""


def _no_table(name: str, given: Any, place: Place) -> str:
    """The sentence on a value in place of a table, or of a list of tables."""
    kind = _WORDS.get(type(given), "a value")
    header = ".".join(part for part in place.path if isinstance(part, str))
    if place.listed:
        return f"{name} must be a list of tables, each begun by [[{header}]], got {kind}."
    if isinstance(place.path[-1], int):
        return f"{name} must be a table, begun by [[{header}]], got {kind}."
    return f"{name} must be one table, begun by [{header}], got {kind}."


def _in_words_of_pydantic(name: str, items: Sequence[Any]) -> str:
    """Pydantic's message on a value, or on each type that it may have."""
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
    try:
        text = repr(given)
    except ValueError:  # Python writes no integer of more than some thousand digits
        text = "a number of thousands of digits"
    return text if len(text) <= 80 else f"{text[:79]}…"


def _at(data: Any, path: Keys) -> Any:
    for key in path:
        data = data[key]
    return data
