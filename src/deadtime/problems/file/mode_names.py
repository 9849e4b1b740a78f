"""Names of modes in a problem file: replaced by numbers before anything is built."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

from deadtime.base.errors import ArgumentError
from deadtime.problems.file.schema import ProblemFile
from deadtime.problems.toml import section as _section
from deadtime.problems.toml.sections import ModeKey, Section, note_of

S = TypeVar("S", bound=Section)


def with_mode_numbers(file: ProblemFile) -> ProblemFile:
    """The file with the number of a mode wherever a section gives its name in [plant].

    Raises
    ------
    SectionError
        If no mode, or more than one, has such a name.
    """
    names = file.plant.modes
    for name in names:
        if names.count(name) > 1:
            with _section("plant"):
                raise ArgumentError(f"modes must be different, got {name!r} twice: rename one.")
    return _numbered(file, names, ())


def _numbered(section: S, names: Sequence[str], path: tuple[str | int, ...]) -> S:
    """A section, at `path` in the file, and all sections in it with numbers of modes."""
    changes: dict[str, Any] = {}
    for key, field in type(section).model_fields.items():
        value, note = getattr(section, key), note_of(field, ModeKey)
        if note is not None and key in section.model_fields_set:
            with _section(*path):
                changes[key] = mode_numbers(key, value, names, note.words)
        elif isinstance(value, Section):
            changes[key] = _numbered(value, names, (*path, key))
        elif isinstance(value, list):
            changes[key] = [
                _numbered(one, names, (*path, key, i)) if isinstance(one, Section) else one
                for i, one in enumerate(value)
            ]
    changes = {key: value for key, value in changes.items() if value != getattr(section, key)}
    return section.model_copy(update=changes) if changes else section


def mode_numbers(key: str, value: Any, names: Sequence[str], words: Sequence[str] = ()) -> Any:
    """A mode, or a list or a table of them, by numbers."""
    if isinstance(value, list):
        return [mode_numbers(f"{key}[{i}]", one, names, words) for i, one in enumerate(value)]
    if isinstance(value, dict):
        return {name: mode_numbers(f"{key}.{name}", x, names, words) for name, x in value.items()}
    if not isinstance(value, str):
        return value
    if value in words and value in names:
        raise ArgumentError(
            f"{key} = {value!r} is the name of a mode, too: give the mode another name in [plant]."
        )
    if value in (*words, *names):
        return value if value in words else names.index(value)
    known = ", ".join(map(repr, (*words, *names)))
    either = f" or one of {known}" if known else ""
    raise ArgumentError(f"{key} must be the number of a mode{either}, got {value!r}.")
