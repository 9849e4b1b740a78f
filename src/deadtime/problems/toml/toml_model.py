"""Read a TOML file into a pydantic model; every error names the file, the line and the key.

Errors that arise while something is built from a file name its section.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel, ValidationError

from deadtime.base.errors import ArgumentError
from deadtime.base.files import read_text
from deadtime.problems.toml.complaints import (
    at_line,
    complaint,
    excess,
    faults,
    key_in_words,
    key_lines,
    line_of,
)


class SectionError(ArgumentError):
    """A fault in one section of the file, at `path`."""

    def __init__(self, message: str, path: tuple) -> None:
        super().__init__(message)
        self.path = path


@contextmanager
def section(*path: str | int) -> Iterator[None]:
    """Attribute any `ArgumentError` inside to this table of the file.

    Overflow, as with numbers such as 1e308, becomes such an error, too.

    Examples
    --------
    >>> with section("run"):
    ...     raise ArgumentError("horizon must be positive.")
    Traceback (most recent call last):
    deadtime.problems.toml.toml_model.SectionError: horizon must be positive.
    """
    try:
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            yield
    except SectionError:
        raise  # of a table within this one, or beside it
    except ArgumentError as error:
        raise SectionError(str(error), path) from None
    except (ArithmeticError, np.linalg.LinAlgError):
        raise SectionError(
            "its numbers are too large, or too far apart, to compute with: use other units.", path
        ) from None


Model = TypeVar("Model", bound=BaseModel)
MOST_BYTES = 1_000_000


@dataclass(frozen=True)
class TomlText:
    """The path and the text of a file, and the class of its errors."""

    source: Path
    text: str
    kind: type[ArgumentError]

    def complaint(self, error: SectionError) -> ArgumentError:
        """The error with its line: that of the key it starts with, or of the section."""
        lines = key_lines(self.text)
        key = re.split(r"[ \[:]", str(error), maxsplit=1)[0]  # messages begin with their key
        table = key_in_words(error.path)
        where = f", {table if table.startswith('[[') else f'[{table}]'}" if table else ""
        line = line_of(lines, (*error.path, *key.split(".")))
        return self.kind(f"{at_line(self.source, line)}{where}: {error}")


def read_toml(
    source: Path, model: type[Model], kind: type[ArgumentError], hint: str = ""
) -> tuple[Model, TomlText]:
    """The checked contents of a TOML file, and its text for later complaints.

    A `kind` of error is raised if it is missing, is not TOML or does not fit the `model`; `hint`
    says how to create such a file.
    """
    text = read_text(source, MOST_BYTES, kind, hint=hint)
    if reason := excess(text):
        raise kind(f"{source} {reason}.")
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise kind(f"{source} is not valid TOML: {error}.") from None
    except ValueError:  # of an integer that Python does not convert
        raise kind(f"{source} holds a number of thousands of digits: shorten it.") from None
    try:
        return model.model_validate(data), TomlText(source, text, kind)
    except ValidationError as error:
        raise kind(complaint(source, text, error, model, data)) from None


def require_valid(model: type[Model], data: Any) -> Model:
    """The checked model of a file's content; else a `SectionError` with the path of keys."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        listed, more = faults(error, model, data)
        sentences = " ".join(fault.sentence for fault in listed)
        raise SectionError(sentences + more, listed[0].path) from None
