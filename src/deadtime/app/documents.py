"""The problem file behind a page: read without trust, written back with its comments."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deadtime.base.errors import ArgumentError, ProblemFileError
from deadtime.problems.file import load_problem, schema
from deadtime.problems.templates import is_named, template
from deadtime.problems.toml import MOST_BYTES, SectionError, TomlText, read_toml
from deadtime.scenarios.sweeps.axes import Draft

_READS_FILES = {"signal": "log", "switching": "fitted"}


@dataclass(frozen=True, eq=False)
class Document:
    """A problem file as it was opened (immutable).

    `name` is the file's without its ending, `draft` the `text` as nested dictionaries and lists;
    relative paths start at the folder of `source`.
    """

    name: str
    text: str
    draft: Draft
    source: Path


def open_named(name: str) -> Document:
    """One of the named problems, or a problem file on this machine.

    Raises
    ------
    ProblemFileError
        If the file cannot be read, or does not say what a problem file may say.
    """
    source = Path(name)
    if is_named(source):
        text = template(name)
        return Document(name, text, tomllib.loads(text), Path(f"{name}.toml"))
    _, read = read_toml(source, schema.ProblemFile, ProblemFileError, "`deadtime init` writes one")
    load_problem(source)  # what does not hold together is refused with its line
    return Document(source.stem, read.text, tomllib.loads(read.text), source)


def open_upload(name: str, content: bytes, folder: Path) -> Document:
    """A problem file that came through a browser: nothing it says is trusted.

    `name` is that on the machine of the person, `folder` an empty one to check it in.

    Raises
    ------
    ProblemFileError
        If it is larger than a problem file can be, is not text or TOML, says something that a
        problem file may not, or names other files, which would be read on this machine.
    """
    stem = file_stem(name)
    if len(content) > MOST_BYTES:
        raise too_large(name, len(content))
    source = folder / f"{stem}.toml"
    source.write_bytes(content)
    try:
        _, read = read_toml(source, schema.ProblemFile, ProblemFileError)
    except ProblemFileError as error:
        raise ProblemFileError(str(error).replace(str(source), source.name)) from None
    finally:
        source.unlink()
    draft = tomllib.loads(read.text)
    for section, kind in _READS_FILES.items():
        if draft.get(section, {}).get("kind") == kind:
            raise ProblemFileError(
                f'{source.name}: [{section}] of kind "{kind}" reads other files, which a page '
                "cannot be given: open it with `deadtime app` and the file's name."
            )
    return Document(stem, read.text, draft, Path(f"{stem}.toml"))


def too_large(name: str, size: int) -> ProblemFileError:
    """The refusal of a file that is larger than a problem file can be."""
    return ProblemFileError(
        f"{file_stem(name)}.toml has {size / 1e6:.1f} MB, a problem file at most "
        f"{MOST_BYTES / 1e6:.0f} MB: choose another file."
    )


def file_stem(name: str) -> str:
    """A file's name without its ending and without characters of a path."""
    return "".join(c for c in Path(name).stem if c.isalnum() or c in " -_")[:60] or "problem"


def complaint(document: Document, error: SectionError) -> ArgumentError:
    """An error about what the document means, with its line."""
    return TomlText(document.source, document.text, ProblemFileError).complaint(error)


def to_toml(document: Document, draft: Mapping[str, Any]) -> str:
    """The document with the values of the draft; comments, order and equal values stay.

    Examples
    --------
    >>> text = 'a = 1  # one\\nb = [1.0, 2.0]\\n'
    >>> document = Document("x", text, tomllib.loads(text), Path("x.toml"))
    >>> print(to_toml(document, {"a": 2, "b": [1.0, 2.0]}), end="")
    a = 2  # one
    b = [1.0, 2.0]
    """
    import tomlkit

    tree = tomlkit.parse(document.text)
    _merge(tree, document.draft, draft)
    return tomlkit.dumps(tree)


def _merge(tree: Any, old: Mapping[str, Any], new: Mapping[str, Any]) -> None:
    for key in [key for key in old if key not in new]:
        del tree[key]
    for key, value in new.items():
        if key in old and old[key] == value:
            continue
        both = isinstance(value, Mapping) and isinstance(old.get(key), Mapping)
        if both and value.get("kind") == old[key].get("kind"):
            _merge(tree[key], old[key], value)
        else:
            tree[key] = _item(value)


def _item(value: Any) -> Any:
    """A TOML item of a value: tables and lists of tables in sections of their own."""
    import tomlkit

    if isinstance(value, Mapping):
        return tomlkit.item(dict(value))
    if isinstance(value, list) and value and isinstance(value[0], Mapping):
        sections = tomlkit.aot()
        for one in value:
            sections.append(tomlkit.item(dict(one)))
        return sections
    return tomlkit.item(value)
