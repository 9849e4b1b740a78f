"""Names of modes in a problem file: replaced by numbers before anything is built."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from deadtime.base.errors import ArgumentError
from deadtime.problems.file.schema import ProblemFile
from deadtime.problems.toml import section as _section
from deadtime.problems.toml.sections import ModeKey, Section, note_of


def with_mode_numbers(file: ProblemFile) -> ProblemFile:
    """The file with the number of a mode wherever a section gives its name in [plant].

    Raises
    ------
    SectionError
        If no mode has such a name.
    """
    changes: dict[str, Any] = {}
    for key in ProblemFile.model_fields:
        value = getattr(file, key)
        if isinstance(value, Section):
            with _section(key):
                changes[key] = _numbered(value, file.plant.modes)
        elif isinstance(value, list):
            changes[key] = []
            for i, one in enumerate(value):
                with _section(key, i):
                    changes[key].append(_numbered(one, file.plant.modes))
    return file.model_copy(update=changes)


def _numbered(section: Section, names: Sequence[str], where: str = "") -> Section:
    """A section with numbers of modes; `where` is its place in the section around it."""
    changes: dict[str, Any] = {}
    for key, field in type(section).model_fields.items():
        value, note = getattr(section, key), note_of(field, ModeKey)
        if note is not None:
            changes[key] = _numbers(where + key, value, names, note.words)
        elif isinstance(value, list) and any(isinstance(one, Section) for one in value):
            changes[key] = [
                _numbered(one, names, f"{where}{key}[{i}].") if isinstance(one, Section) else one
                for i, one in enumerate(value)
            ]
    return section.model_copy(update=changes) if changes else section


def _numbers(key: str, value: Any, names: Sequence[str], words: Sequence[str]) -> Any:
    """A mode, or a list or a table of them, by numbers."""
    if isinstance(value, list):
        return [_numbers(f"{key}[{i}]", one, names, words) for i, one in enumerate(value)]
    if isinstance(value, dict):
        return {name: _numbers(f"{key}.{name}", x, names, words) for name, x in value.items()}
    if not isinstance(value, str) or value in words:
        return value
    if value not in names:
        known = ", ".join(map(repr, (*words, *names)))
        either = f" or one of {known}" if known else ""
        raise ArgumentError(f"{key} must be the number of a mode{either}, got {value!r}.")
    return list(names).index(value)
