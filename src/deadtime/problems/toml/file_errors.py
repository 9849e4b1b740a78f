"""Errors about what a file means, found while it is built, with where in the file they arose."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from deadtime.base.errors import ArgumentError


class SectionError(ArgumentError):
    """Something is wrong in one section of the file; `path` says where."""

    def __init__(self, message: str, path: tuple) -> None:
        super().__init__(message)
        self.path = path


@contextmanager
def section(*path: str | int) -> Iterator[None]:
    """Say of any `ArgumentError` inside that it arose in this table of the file.

    Numbers that cannot be computed with, such as 1e308, are such an error, too.

    Examples
    --------
    >>> with section("run"):
    ...     raise ArgumentError("horizon must be positive.")
    Traceback (most recent call last):
    deadtime.problems.toml.file_errors.SectionError: horizon must be positive.
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
