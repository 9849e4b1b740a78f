"""Errors about what a file means, found while it is built, with where in the file they arose."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from deadtime.errors import ArgumentError


class SectionError(ArgumentError):
    """Something is wrong in one section of the file; `path` says where."""

    def __init__(self, message: str, path: tuple) -> None:
        super().__init__(message)
        self.path = path


@contextmanager
def section(*path: str | int) -> Iterator[None]:
    """Say of any `ArgumentError` inside that it arose in this table of the file.

    Examples
    --------
    >>> with section("run"):
    ...     raise ArgumentError("horizon must be positive.")
    Traceback (most recent call last):
    deadtime.toml_file.errors.SectionError: horizon must be positive.
    """
    try:
        yield
    except ArgumentError as error:
        raise SectionError(str(error), path) from None
